"""``urscript format``: the layout of every kind of line, that it changes nothing else, and what it leaves alone."""

import io
import sys
from argparse import ArgumentParser
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.budget import examples
from tests.rows import each_row
from urscript.editor import format_command
from urscript.editor.formatter import formatted
from urscript.tokens import tokenize
from urscript.work import run_to_end

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = [path for path in sorted(ROOT.rglob("*.script")) if "tests" not in path.relative_to(ROOT).parts]

CASES = {
    "blocks": (
        "def f( a , b=1 ) :\nif a:\nx=1\nelif b :\nx=2\nelse:\nx=3 end\nwhile   True:\nbreak\nend\nend",
        "def f(a, b=1):\n  if a:\n    x = 1\n  elif b:\n    x = 2\n  else:\n    x = 3 end\n"
        "  while True:\n    break\n  end\nend\n",
    ),
    "statements on a line": ("a=1 b = 2   f( )g( )", "a = 1 b = 2 f() g()\n"),
    "signs": (
        "x=-1\ny = x -1\nz=a*- b\nw=[-1,+ 2]\nreturn -x",
        "x = -1\ny = x - 1\nz = a * -b\nw = [-1, +2]\nreturn -x\n",
    ),
    "not": ("x = ! a and not(b)", "x = !a and not (b)\n"),
    "calls": ("f (1,a = 2) [ 0 ]\nrun t ( )\nx . y( )", "f(1, a=2)[0]\nrun t()\nx.y()\n"),
    "poses": ("p [1,2]\nq=p[ 1,2,3,4,5,6 ]", "p[1, 2]\nq = p[1, 2, 3, 4, 5, 6]\n"),
    "numbers stay apart": ("x = 1 .5\ny = 1 e5", "x = 1 .5\ny = 1 e5\n"),
    "brackets": (
        "movej([\n1,\n2\n],\na=1)\nx = [\n[1,\n2],\n]",
        "movej([\n  1,\n  2\n],\n  a=1)\nx = [\n  [1,\n    2],\n]\n",
    ),
    "continued": ("if a:\nx = 1 +\n2\n+ 3\nend", "if a:\n  x = 1 +\n    2\n    + 3\nend\n"),
    "comments": (
        "# a\nif x:# b\n    #c\ny=1     # aligned\n# d\nelse:\n# e\nend# f",
        "# a\nif x:  # b\n  #c\n  y = 1     # aligned\n# d\nelse:\n  # e\nend  # f\n",
    ),
    "blank lines": ("\n\nx=1\n\n\n\ny=2\n\n\n", "x = 1\n\ny = 2\n"),
    "strings": ('x="a  b\n   c"  +"d"', 'x = "a  b\n   c" + "d"\n'),
    "labels": ('$  1  "a"   "noBreak"\n x=1', '$ 1 "a" "noBreak"\nx = 1\n'),
    "line ends": ("if x:\r\ny=1 \r\nend\r\n", "if x:\r\n  y = 1\r\nend\r\n"),
    "nothing": ("\n  \n", ""),
}  # fmt: skip

WORDS = [
    *(
        "def f():",
        "def g(a, b=1):",
        "thread t():",
        "end",
        "if x:",
        "elif y:",
        "else:",
        "while x<3:",
        "return",
        "x",
        "=",
    ),
    *(
        "(",
        ")",
        "[",
        "]",
        ",",
        ".",
        "-",
        "+",
        "!",
        "not",
        "and",
        "==",
        "1",
        "1.",
        ".5",
        "e5",
        "p",
        '"a\n  b"',
        '"',
        "$",
    ),
    *("# c", "run", "halt", ":", "{", "ü", "\ufeff", "\r", "\f"),
]
SPACES = ["", " ", "\n", "  \n\n\n ", "\t", "\r\n", " # c\n", "\n# own\n"]


@each_row("name", CASES)
def test_layout(name: str) -> None:
    text, expected = CASES[name]
    assert formatted(text) == expected
    assert formatted(expected) == expected


def meanings(text: str) -> list[tuple[str, str, bool]]:
    return [(token.kind, token.text, token.after_newline) for token in run_to_end(tokenize(text))]


def comments(text: str) -> list[str]:
    return [line[line.index("#") :].strip() for line in text.split("\n") if "#" in line]


@each_row("path", SCRIPTS, ids=lambda path: path.name)
def test_files_of_this_repository(path: Path) -> None:
    text = path.read_text()
    once = formatted(text)
    assert formatted(once) == once
    assert meanings(once) == meanings(text)
    assert comments(once) == comments(text)


@settings(max_examples=examples(300))
@example([("\r", ""), ("\ufeff", "")])
@given(st.lists(st.tuples(st.sampled_from(WORDS), st.sampled_from(SPACES)), max_size=40))
def test_any_text_keeps_its_tokens_and_comments(parts: list[tuple[str, str]]) -> None:
    """Also one that is not a program."""
    text = "".join(word + space for word, space in parts)
    once = formatted(text)
    assert formatted(once) == once
    assert meanings(once.removeprefix("\ufeff")) == meanings(text.removeprefix("\ufeff"))
    assert once.count("#") == text.count("#")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """run("--check", text) -> exit status, the file's text afterwards, and both outputs."""

    def command(*options: str, text: str = "", name: str = "a.script") -> tuple[int, str, str, str]:
        monkeypatch.chdir(tmp_path)
        (tmp_path / name).write_text(text)
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        parser = ArgumentParser()
        format_command.add_arguments(parser)
        status = format_command.run(parser.parse_args(options))
        return (status, (tmp_path / name).read_text(), *capsys.readouterr())

    return command


UGLY, PRETTY = "x=1\n", "x = 1\n"
POLYSCOPE = 'def a():\n$ 1 "Robot Program"\nx=1\nend\n'


@each_row(
    ("options", "text", "status", "after", "said"),
    [
        (["a.script"], UGLY, 0, PRETTY, "a.script: formatted"),
        (["."], UGLY, 0, PRETTY, "a.script: formatted"),
        (["a.script"], PRETTY, 0, PRETTY, ""),
        (["--check", "a.script"], UGLY, 1, UGLY, "would be formatted"),
        (["--diff", "a.script"], UGLY, 1, UGLY, "+x = 1"),
        (["--check", "a.script"], PRETTY, 0, PRETTY, ""),
        (["a.script"], "x = = 1\n", 1, "x = = 1\n", "not formatted: line 1, column 5: syntax error"),
        (["a.script"], POLYSCOPE, 0, POLYSCOPE, "PolyScope wrote it"),
        (["--force", "a.script"], POLYSCOPE, 0, 'def a():\n  $ 1 "Robot Program"\n  x = 1\nend\n', "formatted"),
        (["-"], UGLY, 0, UGLY, "x = 1"),
        (["-"], "x = (\n", 1, "x = (\n", "x = ("),
        (["none.script"], UGLY, 2, UGLY, "none.script: No such file"),
    ],
)
def test_command(run, options, text, status, after, said) -> None:
    found, left, out, err = run(*options, text=text)
    assert (found, left) == (status, after)
    assert said in out + err


def test_a_file_that_its_project_leaves_open(run, tmp_path) -> None:
    (tmp_path / "urscript.toml").write_text('open = ["a.script"]\n')
    assert run("a.script", text="def a():\nx=1\n")[:2] == (0, "def a():\n  x = 1\n")
