"""Programs are damaged key by key: every request is answered, nothing is logged, findings are where the mistake is."""

import json
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.budget import examples
from urscript.tokens import KEYWORDS, tokenize
from urscript.work import run_to_end

PROGRAM = """# a cell
def cell():
  global parts = 0
  def take(at, speed=0.25):
    local above = pose_trans(at, p[0, 0, -0.1, 0, 0, 0])
    movej(get_inverse_kin(above), a=1.4, v=speed)
    if not get_standard_digital_in(0):
      popup("no part\nat all", title="cell", error=True)
    elif parts > 3:
      return False
    else:
      parts = parts + 1
    end
    return True
  end
  thread blink():
    while True:
      set_standard_digital_out(1, parts > 1)
      sleep(0.5)
    end
  end
  h = run blink()
  list = [1, -2, [3, 4]]
  while parts < 10:
    take(p[0.1, 0.2 * parts, 0.3, 0, 3.14, 0], speed=0.5)
    list[0] = list[0] + 1  # count
  end
  kill h
end
"""
PIECES = [
    *("(", ")", "[", "]", '"', "\n", ":", ".", ",", "=", " ", "end", "def f(", "if ", "while True:", "x", "p[", "# "),
    *("\U0001f600", "\r", "run ", "global ", "return ", "$ 1", "0x1F", "&&", "{", "take(", "else:", "\ud800", "\t"),
]
AT_A_PLACE = ("hover", "definition", "completion", "signatureHelp", "prepareRename", "references")
OF_A_TEXT = ("documentSymbol", "foldingRange", "semanticTokens/full", "formatting")
URI = "file:///nowhere/cell.script"


class RawEditor:
    """The protocol without a library."""

    def __init__(self):
        command = [sys.executable, "-m", "urscript", "lsp", "--model", "ur5e"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.found = None, []
        self._number = self._version = 0
        self.request("initialize", {"capabilities": {}})

    def send(self, message):
        data = json.dumps({"jsonrpc": "2.0", **message}).encode()
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(data), data))
        self.process.stdin.flush()

    def request(self, method, params):
        self._number += 1
        self.send({"id": self._number, "method": method, "params": params})
        while (message := self._read()).get("id") != self._number:
            pass
        return message

    def _read(self):
        length = 0
        while line := self.process.stdout.readline().strip():
            name, _, value = line.partition(b":")
            length = int(value) if name == b"Content-Length" else length
        message = json.loads(self.process.stdout.read(length))
        if message.get("method") == "textDocument/publishDiagnostics":
            self.found = message["params"]["version"], message["params"]["diagnostics"]
        return message

    def change(self, text):
        self._version += 1
        document = {"uri": URI, "version": self._version}
        changes = {"textDocument": document, "contentChanges": [{"text": text}]}
        self.send({"method": "textDocument/didChange", "params": changes})

    def findings(self):
        """The findings of the newest text: line, severity, message."""
        while self.found[0] != self._version:
            self._read()
        return [(one["range"]["start"]["line"] + 1, one["severity"], one["message"]) for one in self.found[1]]

    def close(self):
        self.request("shutdown", None)
        self.send({"method": "exit"})
        _, logged = self.process.communicate(timeout=60)
        assert self.process.returncode == 0
        return logged.decode()


@pytest.fixture
def editor():
    made = RawEditor()
    opened = {"uri": URI, "languageId": "urscript", "version": 0, "text": PROGRAM}
    made.send({"method": "textDocument/didOpen", "params": {"textDocument": opened}})
    yield made
    made.process.kill()
    made.process.communicate()


def damage(text, chosen):
    at = chosen.randrange(len(text) + 1)
    match chosen.randrange(3):
        case 0:
            return text[:at] + chosen.choice(PIECES) + text[at:]
        case 1:
            return text[:at] + text[at + chosen.randrange(1, 9) :]
        case _:
            there = chosen.randrange(len(text) + 1)
            return text[:at] + text[there : there + 12] + text[at:]


def test_a_request_that_is_none_has_an_answer(editor):
    answer = editor.request("textDocument/hover", {"textDocument": 1})
    assert answer["error"]["message"] == "Invalid Params"
    assert "Invalid Params" in editor.close()


@pytest.mark.parametrize("count", [200, pytest.param(2000, marks=pytest.mark.long)])
def test_every_request_is_answered(editor, count):
    chosen = random.Random(7)
    text, wrong = PROGRAM, []
    for number in range(examples(count)):
        text = damage(PROGRAM if number % 8 == 0 else text, chosen)
        editor.change(text)
        place = {"line": chosen.randrange(32), "character": chosen.randrange(60)}
        method = chosen.choice(AT_A_PLACE if number % 2 else OF_A_TEXT)
        more = {
            "references": {"context": {"includeDeclaration": True}},
            "formatting": {"options": {"tabSize": 2, "insertSpaces": True}},
        }
        params = {"textDocument": {"uri": URI}, "position": place, **more.get(method, {})}
        answer = editor.request(f"textDocument/{method}", params)
        if "error" in answer:
            wrong.append((method, answer["error"]["message"], text))
    assert not wrong
    assert editor.close() == ""


EXAMPLES = Path(__file__).parents[3] / "examples"
FILES = sorted([*EXAMPLES.glob("*.script"), *EXAMPLES.glob("cells/*/cell.script")])
OTHER_LANGUAGES = {
    **{"==": ["="], "and": ["&&"], "or": ["||"], "True": ["true"], "False": ["false"], "elif": ["else if"]},
    "end": ["endif", "}", "end if"],
}
BRACKETS = dict(zip("()[]", "[]()", strict=True))


def dropped(word, chosen):
    at = chosen.randrange(len(word))
    return word[:at] + word[at + 1 :]


def swapped(word, chosen):
    at = chosen.randrange(len(word) - 1)
    return word[:at] + word[at + 1] + word[at] + word[at + 2 :]


TOKEN_MISTAKES = [  # where a token can be replaced, and by what
    (lambda token: token.kind == "name" and len(token.text) > 2, dropped),
    (lambda token: token.kind == "name" and len(token.text) > 2, swapped),
    (lambda token: token.kind in ("name", "number"), lambda word, chosen: ""),
    (lambda token: token.kind in KEYWORDS, dropped),
    (lambda token: token.kind in KEYWORDS, swapped),
    (lambda token: token.kind in OTHER_LANGUAGES, lambda word, chosen: chosen.choice(OTHER_LANGUAGES[word])),
    (lambda token: token.kind in ("(", ")", "[", "]", ",", ":", "=", "."), lambda word, chosen: ""),
    (lambda token: token.kind in ("(", ")", "[", "]", ",", ":", "=", "."), lambda word, chosen: 2 * word),
    (lambda token: token.kind in BRACKETS, lambda word, chosen: BRACKETS[word]),
    (lambda token: token.kind == "string", lambda word, chosen: chosen.choice([word[1:], word[:-1]])),
    (lambda token: token.kind == "number" and "." in token.text, lambda word, chosen: word.replace(".", ",")),
]
LINE_MISTAKES = [  # which lines, and what they become
    (r" *end$", lambda line, chosen: []),
    (r" *\S", lambda line, chosen: [f"{re.match(' *', line)[0]}end", line]),
    (r" *(if|while|def|elif|thread) .", lambda line, chosen: [line[: chosen.randrange(len(line) // 2, len(line))]]),
    (r".*# ?\w", lambda line, chosen: [line.replace("#", "", 1)]),
]


def mistaken(lines, chosen):
    """The lines of a text with a mistake, and the number of its line."""
    number = chosen.randrange(len(TOKEN_MISTAKES) + len(LINE_MISTAKES))
    if number < len(LINE_MISTAKES):
        pattern, change = LINE_MISTAKES[number]
        at = chosen.choice([at for at, line in enumerate(lines) if re.match(pattern, line)])
        return [*lines[:at], *change(lines[at], chosen), *lines[at + 1 :]], at + 1
    fits, change = TOKEN_MISTAKES[number - len(LINE_MISTAKES)]
    tokens = [token for token in run_to_end(tokenize("\n".join(lines))) if fits(token)] or [None]
    if (token := chosen.choice(tokens)) is None:
        return lines, 0
    row, start = lines[token.line - 1], token.column - 1
    row = row[:start] + change(token.text, chosen) + row[start + len(token.text) :]
    return [*lines[: token.line - 1], row, *lines[token.line :]], token.line


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 5))])
def test_mistakes_are_found_where_they_are(editor, seed):
    """They are typed letter by letter. At least 90 % of the first findings are within two lines of the mistake."""
    chosen, count = random.Random(seed), 500 if seed else 100
    texts = [file.read_text().split("\n") for file in FILES]
    known = []
    for lines in texts:
        editor.change("\n".join(lines))
        known.append({message for _, _, message in editor.findings()})
    found = near = 0
    for number in range(examples(count)):
        which = number % len(texts)
        lines, place = mistaken(texts[which], chosen)
        at = min(place, len(lines)) - 1
        for end in sorted(chosen.randrange(len(lines[at]) + 1) for _ in range(3)):
            editor.change("\n".join([*lines[:at], lines[at][:end], *lines[at + 1 :]]))
        editor.change("\n".join(lines))
        where = {"textDocument": {"uri": URI}, "position": {"line": at, "character": len(lines[at])}}
        assert "error" not in editor.request("textDocument/completion", where)
        new = [one for one in editor.findings() if one[2] not in known[which]]
        if new and place:
            found += 1
            first, *_ = min(new, key=lambda one: (one[1], one[0]))  # errors before warnings
            near += abs(first - place) <= 2
    assert found > 0.8 * count
    assert near >= 0.9 * found, f"{near} of {found}"
    assert editor.close() == ""
