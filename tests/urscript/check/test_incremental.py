"""A text is edited at random: what is kept of its earlier states never changes what is found in it."""

import random
import re
from pathlib import Path

import pytest

from tests.budget import examples
from tests.rows import each_row
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion
from urscript.blocks import Blocks
from urscript.check.checking import findings
from urscript.check.project import Project
from urscript.check.sources import sources_in
from urscript.errors import CompileError
from urscript.parser import normalize, parse
from urscript.tokens import tokenize
from urscript.work import run_to_end

ROOT = Path(__file__).parents[3]
VERSIONS = [PolyscopeVersion.parse("5.13"), PolyscopeVersion.parse("5.22")]
DEPENDENT = """def cell():
  global home = p[0.3, 0.2, 0.1, 0, 0, 0]
  global near = home
  global far = p[0.3, 0.2, 1, 0, 0, 0]
  global fast = 200
  count = 0
  def ready():
    return other(count) > 0
  end
  def other(n, step=1):
    def inside(list):
      return list[0] + n
    end
    if n > 3:
      return ready()
    end
    return inside([n, step])
  end
  def wait():
    while True:
      if other(1, step=2) > 1:
        break
      end
      popup("waiting")
    end
  end
  def move(v=[1, 2], w=home):
    local text = "speed "
    if count > 1:
      part = 1
    end
    textmsg(text + part)
    movel(near, r=0.5)
    movel(far, r=0.6)
    movel(home, v=fast, r=0.4)
    count = "many"
    global grip = True
    struct(a=1)
  end
  thread watch():
    while count < 3:
      other(2)
    end
  end
  h = run watch()
  move([1], 2)
  list = [1, 2]
  list.append(3)
  wait()
  join h
end
"""
PROGRAMS = {
    "dependent": DEPENDENT,
    "library": DEPENDENT.split("\n", 1)[1].rsplit("end\n", 1)[0],  # as the text of a Script node
    "programs": "def a():\n  sync()\nend\n\nsec b():\n  textmsg(1)\nend\nx = 1\n" + DEPENDENT,
    **{file.parent.name: file.read_text() for file in sorted(ROOT.glob("examples/cells/*/cell.script"))},
}
PIECES = [
    *("(", ")", "[", "]", '"', "\n", ":", ".", ",", "=", " ", "  ", "end", "\nend\n", "x", "p[", "# ", "\n# end\n"),
    *("def f(", "\ndef f(a, b=1):\n", "thread t():\n", "if ", "if a:\n", "while True:\n", "else:", "return "),
    *(
        "global ",
        "local ",
        "run ",
        "$ 1",
        "0x1F",
        "&&",
        "{",
        "1",
        '"text"',
        "\r\n",
        "\ufeff",
        "sync()\n",
        "for i in x:",
    ),
]
NAME = re.compile(r"[A-Za-z_]\w*")


class Whole(Blocks):
    """Reads every text as a whole."""

    def _within(self, text):
        return []


def edited(text, chosen):
    """The text after one edit, small ones more often than large ones."""
    at = chosen.randrange(len(text) + 1)
    lines = text.split("\n")
    row, other = chosen.randrange(len(lines)), chosen.randrange(len(lines))
    match chosen.randrange(9):
        case 0 | 1:
            return text[:at] + chosen.choice(PIECES) + text[at:]
        case 2:
            return text[:at] + text[at + chosen.randrange(1, 9) :]
        case 3 | 4:  # a name becomes another one of the text
            names = list(NAME.finditer(text)) or [re.match("", text)]
            old, new = chosen.choice(names), chosen.choice(names)
            return text[: old.start()] + new[0] + text[old.end() :]
        case 5:
            return "\n".join(lines[:row] + lines[row + chosen.randrange(1, 4) :])
        case 6:
            return "\n".join([*lines[:row], lines[other], *lines[row:]])
        case 7:  # a block moves
            count = chosen.randrange(1, 9)
            moved, rest = lines[row : row + count], lines[:row] + lines[row + count :]
            return "\n".join([*rest[:other], *moved, *rest[other:]])
        case _:
            return text[:at].rstrip() + "\n" + " " * chosen.randrange(8) + text[at:].lstrip()


def found(text, blocks):
    sources = {version: sources_in("x.script", to_bytes(text), Project(), version) for version in VERSIONS}
    return findings(sources, Project(), blocks=blocks)


def tokens(text, read):
    try:
        return read(text)
    except CompileError as error:
        return str(error)


def parsed(*arguments, **options):
    return run_to_end(parse(*arguments, **options))


def syntax(read, text, **options):
    """The errors of a text and what its tree says about names, in comparable form."""
    errors = []
    try:
        program = read(normalize(text), errors, **options)
    except CompileError as error:
        return error.args, error.cause, [(str(one), one.cause) for one in errors]
    functions = {name: (f.line + f.lines_before, f.scope, f.body) for name, f in program.functions.items()}
    names = list(program.globals), program.damaged, functions, program.scope
    return [(str(error), error.wire, error.cause) for error in errors], names


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("count", [25, pytest.param(400, marks=pytest.mark.long)])
def test_what_is_kept_changes_nothing(program, count):
    chosen = random.Random(f"{program} {count}")
    kept, text, states = Blocks(), PROGRAMS[program], [PROGRAMS[program]]
    for number in range(examples(count)):
        if number % 12 == 11:
            text = chosen.choice(states[-12:])  # undone
        for _ in range(20):
            if (changed := edited(text, chosen)) and len(changed) < 2 * len(PROGRAMS[program]) + 50:
                break
        text = changed if number % 8 else PROGRAMS[program]
        states.append(text)
        kept.next_text()
        assert tokens(text, kept.tokens) == tokens(text, lambda text: run_to_end(tokenize(text))), text
        for statements in (False, True):
            now = syntax(kept.parse, text, statements=statements)
            assert now == syntax(parsed, text, statements=statements), text
        assert found(text, kept) == found(text, Whole()), text


@each_row(
    ("old", "new"),
    [
        ("0.2, 1, 0", "0.2, True, 0"),
        ("p[0.3, 0.2, 0.1, 0, 0, 0]", "p[0.3, 0.2, 0.1, 0, 0, 180]"),
        ("fast = 200", "fast = 2"),
        ("count = 0", "count = True"),
        ("def other(n, step=1):", "def other(n):"),
        ("def other(n", "thread other(n"),
        ("    if n > 3:", "    sync()\n    if n > 3:"),
        ("h = run watch()", "count = [1]"),
        ("move([1], 2)", "move([1], 2)\n  part = 2\n  x = rpc_factory(1)"),
    ],
)
def test_what_a_change_means_elsewhere(old, new):
    kept, changed = Blocks(), DEPENDENT.replace(old, new, 1)
    assert changed != DEPENDENT
    before = found(DEPENDENT, kept)
    for text in (changed, DEPENDENT, changed.replace("\n", "\n\n", 1)):
        kept.next_text()
        assert found(text, kept) == found(text, Whole())
    assert found(changed, kept) != before
