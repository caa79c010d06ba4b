"""The language server, by an editor's side that is not ours: what it shows, and that no text breaks it."""

import re
import sys

import pytest
import pytest_lsp
from lsprotocol import types
from pytest_lsp import ClientServerConfig, LanguageClient

pytestmark = pytest.mark.asyncio(loop_scope="module")

TEXT = """def cell():
  global speed = 0.5
  # Adds a step.
  def next(x, step=1):
    y = x + step
    return y
  end
  thread blink():
    while True:
      sync()
    end
  end
  h = run blink()
  movej([0, -90, 0, -90, 0, 0], a=1)
  s = "\U0001f600ü" z = next(speed, step=2)
  nexd(1)
  if z > 1 && True:
    textmsg(z)
  end
end
"""
INCLUDED = "def grip(width):\n  global held = width\nend\n"
USING = "def other():\n  grip(1)\n  textmsg(held)\nend\n"


@pytest_lsp.fixture(
    config=ClientServerConfig(server_command=[sys.executable, "-m", "urscript", "lsp", "--polyscope", "5.22"]),
    scope="module",
)
async def client(lsp_client: LanguageClient):
    await lsp_client.initialize_session(
        types.InitializeParams(capabilities=pytest_lsp.client_capabilities("visual-studio-code"))
    )
    yield
    await lsp_client.shutdown_session()


class Editor:
    """One open document. A place is a piece of its text, in which ``|`` stands for the cursor."""

    def __init__(self, client, path, text, uri=None):
        self.client, self.text, self.version = client, text, 1
        self.uri = uri or path.as_uri()
        self.id = types.TextDocumentIdentifier(self.uri)
        item = types.TextDocumentItem(self.uri, "urscript", 1, text)
        client.diagnostics.pop(self.uri, None)
        client.text_document_did_open(types.DidOpenTextDocumentParams(item))

    def type(self, text):
        self.text, self.version = text, self.version + 1
        change = types.TextDocumentContentChangeWholeDocument(text)
        document = types.VersionedTextDocumentIdentifier(self.version, self.uri)
        self.client.diagnostics.pop(self.uri, None)
        self.client.text_document_did_change(types.DidChangeTextDocumentParams(document, [change]))

    async def findings(self):
        while self.uri not in self.client.diagnostics:
            await self.client.wait_for_notification(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
        return [(self.piece(one.range), one.code, one.message) for one in self.client.diagnostics[self.uri]]

    def at(self, place):
        before = self.text[: self.text.index(place.replace("|", "")) + place.index("|")]
        row = before.rsplit("\n", 1)[-1]
        return types.Position(before.count("\n"), len(row.encode("utf-16-le")) // 2)

    def piece(self, place):
        """The text of a range, as `line:text`."""
        row = self.text.split("\n")[place.start.line].encode("utf-16-le")
        end = place.end.character if place.end.line == place.start.line else len(row)
        return f"{place.start.line + 1}:{row[2 * place.start.character : 2 * end].decode('utf-16-le')}"

    async def pieces(self, found):
        return [self.piece(one.range) for one in await found or ()]

    async def ask(self, name, kind, place, *more):
        return await getattr(self.client, f"text_document_{name}_async")(kind(*more, self.id, self.at(place)))


@pytest.fixture
def cell(client, tmp_path):
    editor = Editor(client, tmp_path / "cell.script", TEXT)
    yield editor
    client.text_document_did_close(types.DidCloseTextDocumentParams(editor.id))


async def test_findings_follow_the_text(cell):
    first = [("14:[", "URS104"), ("16:nexd", "URS002")]
    assert [(piece, code) for piece, code, _ in await cell.findings()] == [*first, ("17:&", "URS001")]
    cell.type(TEXT.replace("&&", "and"))
    assert [(piece, code) for piece, code, _ in await cell.findings()] == first
    cell.type(TEXT.replace("&&", "and").replace("nexd(1)", "").replace("-90", "-1.5"))
    assert await cell.findings() == []


@pytest.mark.parametrize(
    ("place", "shown"),
    [
        ("mo|vej", r"movej\(q, a=1\.4.*joint angles \[rad\].*CB3 since 3\.0"),
        ("next|(speed", r"def next\(x, step=1\).*Adds a step\."),
        ("|y = x", "local variable of next: a number"),
        ("next(sp|eed", "a global variable: a number"),
        ("x + ste|p", "a parameter of next"),
        ("a|=1", r"movej\(q"),
        ("nex|d(1)", None),
        ("Adds| a", None),
    ],
)
async def test_hover(cell, place, shown):
    found = await cell.ask("hover", types.HoverParams, place)
    assert found is None if shown is None else re.search(shown, found.contents.value, re.DOTALL)


@pytest.mark.parametrize(
    ("place", "defined", "used"),
    [
        ("nex|t(speed", ["4:next"], ["4:next", "15:next"]),
        ("blin|k()\n  movej", ["8:blink"], ["8:blink", "13:blink"]),
        ("spe|ed = ", ["2:speed"], ["2:speed", "15:speed"]),
        ("ste|p=2", ["4:step"], ["4:step", "5:step", "15:step"]),
        ("z| > 1", ["15:z"], ["15:z", "17:z", "18:z"]),
        ("mov|ej", [], ["14:movej"]),
    ],
)
async def test_definition_and_references(cell, place, defined, used):
    """The columns behind an astral character count units of UTF-16."""
    assert await cell.pieces(cell.ask("definition", types.DefinitionParams, place)) == defined
    context = types.ReferenceContext(include_declaration=True)
    assert await cell.pieces(cell.ask("references", types.ReferenceParams, place, context)) == used


async def test_rename(cell):
    edit = await cell.client.text_document_rename_async(types.RenameParams(cell.id, cell.at("ste|p=2"), "delta"))
    assert [cell.piece(one.range) for one in edit.changes[cell.uri]] == ["4:step", "5:step", "15:step"]
    for name in ("end", "2x", "y", "a b"):
        with pytest.raises(Exception, match=r"cannot be a name|in use"):
            await cell.client.text_document_rename_async(types.RenameParams(cell.id, cell.at("ste|p=2"), name))
    assert await cell.ask("prepare_rename", types.PrepareRenameParams, "mov|ej") is None


async def test_names_of_other_files_of_the_project(client, tmp_path):
    (tmp_path / "urscript.toml").write_text('include = ["lib.script"]\n')
    (tmp_path / "lib.script").write_text(INCLUDED)
    (tmp_path / "other.script").write_text(USING)
    editor = Editor(client, tmp_path / "a.script", "def a():\n  grip(2)\n  held = 3\nend\n")
    assert await editor.findings() == []
    (place,) = await editor.ask("definition", types.DefinitionParams, "gri|p")
    assert (place.uri, place.range.start.line) == ((tmp_path / "lib.script").as_uri(), 0)
    assert "grip(width)" in (await editor.ask("hover", types.HoverParams, "gri|p")).contents.value
    edit = await client.text_document_rename_async(types.RenameParams(editor.id, editor.at("gri|p"), "take"))
    assert sorted(uri.rpartition("/")[2] for uri in edit.changes) == ["a.script", "lib.script", "other.script"]
    edit = await client.text_document_rename_async(types.RenameParams(editor.id, editor.at("hel|d"), "kept"))
    assert [uri.rpartition("/")[2] for uri in edit.changes] == ["a.script"]  # its own global of that name


async def test_outline_folding_colours(cell):
    (program,) = await cell.client.text_document_document_symbol_async(types.DocumentSymbolParams(cell.id))
    assert program.name == "cell"
    assert [child.name for child in program.children] == ["next", "blink", "speed", "h", "s", "z"]
    folds = await cell.client.text_document_folding_range_async(types.FoldingRangeParams(cell.id))
    assert [(fold.start_line, fold.end_line) for fold in folds] == [(0, 19), (3, 6), (7, 11), (8, 10), (16, 18)]
    data = (await cell.client.text_document_semantic_tokens_full_async(types.SemanticTokensParams(cell.id))).data
    assert len(data) % 5 == 0
    assert list(data[:10]) == [0, 4, 4, 0, 1, 1, 9, 5, 1, 1]


@pytest.mark.parametrize(
    ("place", "some", "none"),
    [
        ("  nexd|(1)", {"next", "movej", "speed", "while", "z"}, {"y", "list", "conveyor"}),
        ("return y|", {"x", "step", "y", "speed"}, {"make_listing"}),
        ("run bl|ink", {"blink"}, {"next"}),
        ("step=2|)", {"x=", "step="}, {"y"}),
        ("], |a=1", {"q=", "v=", "speed"}, {"x="}),
        ("# Add|s", set(), {"movej"}),
        ("ü|", set(), {"movej"}),
    ],
)
async def test_completion(cell, place, some, none):
    found = {item.label for item in await cell.ask("completion", types.CompletionParams, place) or ()}
    if "2|" not in place:  # nothing is completed within a number
        assert some <= found
    assert not none & found


async def test_signature_help(cell):
    help_ = await cell.ask("signature_help", types.SignatureHelpParams, "speed, |step")
    assert (help_.signatures[0].label, help_.active_parameter) == ("next(x, step=1)", 1)
    help_ = await cell.ask("signature_help", types.SignatureHelpParams, "0], |a=1")
    assert help_.signatures[0].parameters[help_.active_parameter].label == "a=1.4"
    assert await cell.ask("signature_help", types.SignatureHelpParams, "return |y") is None


@pytest.mark.parametrize(
    ("line", "title", "after"),
    [
        ("movej([0, -90, 0, 1.5, 0, 0])", "Convert", "movej([0, d2r(-90), 0, d2r(1.5), 0, 0])"),
        ("movel(p[1, 2, 0, 0, 180, 0])", "Convert", "movel(p[1, 2, 0, 0, d2r(180), 0])"),
        ("movej(get_target_joint_positions(), v=200)", "Convert", "movej(get_target_joint_positions(), v=d2r(200))"),
        ("x = sine(1)", "Write 'sin'", "x = sin(1)"),
        ("x = true", "Write 'True'", "x = True"),
        ("x = True && False", "Write 'and'", "x = True and False"),
        ("norm(1, 2)", "Ignore", "norm(1, 2)  # urscript: ignore[URS101]"),
        ("norm(1, 2) # urscript: ignore[URS2]", "Ignore", "norm(1, 2) # urscript: ignore[URS2, URS101]"),
    ],
)
async def test_quick_fixes(client, tmp_path, line, title, after):
    editor = Editor(client, tmp_path / "fix.script", f"def f():\n  {line}\nend\n")
    assert await editor.findings()
    where = types.Range(types.Position(1, 0), types.Position(1, 99))
    params = types.CodeActionParams(editor.id, where, types.CodeActionContext([]))
    found = [one for one in await client.text_document_code_action_async(params) if one.title.startswith(title)]
    row = f"  {line}"
    for edit in sorted(found[0].edit.changes[editor.uri], key=lambda edit: -edit.range.start.character):
        row = row[: edit.range.start.character] + edit.new_text + row[edit.range.end.character :]
    assert row == f"  {after}"
    editor.type(f"def f():\n{row}\nend\n")
    assert not await editor.findings()


async def test_formatting(cell):
    settings = types.FormattingOptions(2, True)
    params = types.DocumentFormattingParams(cell.id, settings)
    assert await cell.client.text_document_formatting_async(params) is None  # it does not parse
    cell.type("x=1\r\n")
    (edit,) = await cell.client.text_document_formatting_async(params)
    assert edit.new_text == "x = 1\r\n"


async def test_findings_of_a_long_text_move_along(client, tmp_path):
    functions = "".join(f"  def f{n}(a):\n    x = a + {n}\n    return x\n  end\n  f{n}(1)\n" for n in range(400))
    text = f"def long():\n{functions}  wrong()\nend\n"
    editor = Editor(client, tmp_path / "long.script", text)
    assert [piece for piece, *_ in await editor.findings()] == ["2002:wrong"]
    editor.type(text.replace("x = a + 7\n", "\n    x = a + b7\n"))
    assert [piece for piece, *_ in await editor.findings()] == ["39:b7", "2003:wrong"]
    editor.type(text)
    assert [piece for piece, *_ in await editor.findings()] == ["2002:wrong"]


HOSTILE = [
    *(
        "",
        "\n",
        '"',
        "def",
        "def f(",
        "end end end",
        "\x00",
        "((((" * 500,
        "[" * 3000,
        "if " * 300,
        "a." * 500,
        "x = 1 " * 999,
    ),
    *("# " + "x" * 60000, "x" * 60000, '"' + "y" * 60000, "\ufeff\r\r\n\u2028\x0c", "def f():\r x = 1\r end", "{{x}}"),
    *("run ", "$ 1", "x = -", "f(a=", "p[1,", "\ud800", "thread t(a):", "def f(a, a=1, b):\nend", "else elif:"),
]


async def walk(editor):
    """Every request, at the beginning, in the middle and at the end; no answer may be an error."""
    rows = re.split("\r\n|\r|\n", editor.text)
    places = [(0, 0), (len(rows) // 2, len(rows[len(rows) // 2])), (len(rows) - 1, len(rows[-1])), (9**9, 9**9)]
    for line, column in places:
        place = types.Position(min(line, 2**31 - 1), min(column, 2**31 - 1))
        for name, kind in (
            ("hover", types.HoverParams),
            ("definition", types.DefinitionParams),
            ("completion", types.CompletionParams),
            ("signature_help", types.SignatureHelpParams),
            ("prepare_rename", types.PrepareRenameParams),
        ):
            await getattr(editor.client, f"text_document_{name}_async")(kind(editor.id, place))
        whole = types.Range(types.Position(0, 0), place)
        await editor.client.text_document_code_action_async(
            types.CodeActionParams(editor.id, whole, types.CodeActionContext([]))
        )
        context = types.ReferenceContext(include_declaration=True)
        await editor.client.text_document_references_async(types.ReferenceParams(context, editor.id, place))
    for name, kind in (
        ("document_symbol", types.DocumentSymbolParams),
        ("folding_range", types.FoldingRangeParams),
        ("semantic_tokens_full", types.SemanticTokensParams),
    ):
        await getattr(editor.client, f"text_document_{name}_async")(kind(editor.id))
    await editor.client.text_document_formatting_async(
        types.DocumentFormattingParams(editor.id, types.FormattingOptions(2, True))
    )


async def test_hostile_texts(client, tmp_path, capfd):
    editor = Editor(client, tmp_path / "hostile.script", "")
    for text in HOSTILE:
        editor.type(text)
        await walk(editor)
    editor.type("x = y\n")
    while not await editor.findings():
        client.diagnostics.clear()
    assert "failed" not in capfd.readouterr().err
