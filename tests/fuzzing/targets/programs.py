"""Files that a robot runs: scripts, program trees, installations and their variables."""

import gzip
from collections.abc import Iterator
from contextlib import suppress
from typing import Final

from tree_rig import assign, expression, line, main, sleep, tag

from emulator.config import ConfigError, read_safety
from emulator.programs.compiling import LIBRARY_SET, CompiledTexts
from emulator.programs.loading import ProgramLoadError, load_steps
from targets.registry import VERSIONS, Finding, file, folder, target
from urproto.robots import load_model
from urscript.compiler import compile_script, find_problems
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.polyscope.document import DocumentError
from urscript.polyscope.installation_file import InstallationFile, read_installation, read_variables
from urscript.splitter import ScriptSplitter
from urscript.work import run_to_end


@target(
    b'\5def f():\n  x = 1 # end\n  if x:\n    y = "end"\n  end\nend\nmovej([0,0,0,0,0,0])\n'
    b"\xef\xbb\xbfset_digital_out(1,True)\n",
    b'\1sec a():\n  textmsg("a\nb")\nend\nthread t():\n while True:\n  sync()\n end\nend',
    b"\1#\n\n \t\r\n# a\nx = 1\r\n",
)
def splitter(data: bytes) -> None:
    size, data = 1 + data[0] if data else 1, data[1:]
    whole, pieces = ScriptSplitter(256), ScriptSplitter(256)
    if len(data) <= 256:  # text that is too long is cut at the data received by then
        found = whole.feed(data) + whole.flush()
        split = [unit for at in range(0, len(data), size) for unit in pieces.feed(data[at : at + size])]
        split += pieces.flush()
        if found != split:
            raise Finding(f"whole: {found}; in pieces of {size} bytes: {split}")
    for at in range(0, len(data), size):
        pieces.feed(data[at : at + size])
    pieces.flush()


@target(
    b"\0def f():\n  global a = [1, 2.5e3, p[0,0,0,0,0,1]]\n  local b = a[0] + norm(a)\n  while b < 3 and not False:\n"
    b"    b = b + 1 # c\n    if b > 2:\n      break\n    elif b == 2:\n      continue\n    else:\n"
    b"      halt\n    end\n  end\n"
    b"  return b\nend\n",
    b"\1def f(a, b=[1, 0x1f]):\n  thread t():\n    enter_critical\n    sync()\n    exit_critical\n  end\n"
    b"  h = run t()\n"
    b'  join h\n  kill h\n  s = struct(x=1, y="a")\n  s.x = -s.x % 3 ^ 2\n  m = [[1,2],[3,4]] * [1,2]\n  $ 1 "l"\n'
    b"  movej(get_inverse_kin(p[.1,.2,.3,0,0,0]), a=1.4, v=1.05)\n  f(b=[1], a=2)\nend\n",
    b"\2sec s():\n  set_digital_out(0, True)\nend\n",
    b"\1movel(p[0,0,0,0,0,0]",
    b"\1" + b"(" * 300,
    b"\1x = " + b"-" * 300 + b"1",
)
def scripts(data: bytes) -> None:
    """A program compiles if and only if no error is found in it."""
    if not data:
        return
    version, data = VERSIONS[data[0] % len(VERSIONS)], data[1:]
    text = ScriptFile("any.script", data)
    text.problems(LIBRARY_SET, version)
    problems = find_problems(text.text, LIBRARY_SET, version)
    errors = [problem for problem in problems if isinstance(problem, CompileError)]
    try:
        compile_script(text.text, LIBRARY_SET, version)
    except CompileError as error:
        if not errors:
            raise Finding(f"it does not compile, but nothing is found wrong: {error}") from error
    else:
        if errors:
            raise Finding(f"it compiles, but this is found wrong: {errors[0]}")


def _trees() -> Iterator[bytes]:
    waypoint = tag("Waypoint", tag("motionParameters"), tag("position", joints="0,0,0,0,0,0"), name="a", type="Fixed")
    variable = tag("Assignment", tag("variable", name="v"), expression("1+2"), valueSource="Expression")
    for content in (
        main(line('textmsg("a")'), sleep(0.1), assign("x", "1 + 2")),
        main(tag("Move", tag("children", waypoint), motionType="MoveJ", speed="1.0", acceleration="1.4"), variable),
        main(
            tag("Loop", tag("children", sleep(0.1)), type="Count", count="3"),
            tag("SuppressedNode", tag("suppressedNode", tag("Comment", comment="c"))),
            tag("Halt"),
            tag("Reference", reference="../Halt[1]"),
        ),
    ):
        yield tag("URProgram", tag("children", content), name="p", installation="default").encode()
    yield gzip.compress(tag("URProgram", tag("children", main()), name="p").encode(), mtime=0)


@target(_trees)
def program_tree(data: bytes) -> None:
    path = file("p.urp", data)
    for version in VERSIONS[:2]:
        with suppress(ProgramLoadError):
            run_to_end(load_steps(path, folder(), InstallationFile("default"), version, CompiledTexts()))


_SAFETY: Final = (
    "[SafetyLimits Normal Values]\nmaxTcpSpeed = 1.5\nminJointPos = [-6.28, -6.28, -6.28, -6.28, -6.28, -6.28]\n"
    "[Inputs]\nemergencyStopInputA = 255\n[Planes 0]\n"
)


@target(
    lambda: [
        tag(
            "Installation",
            tag("SafetySettings", _SAFETY),
            tag("tcpOffset", x="0.1", y="0"),
            tag("analogInputRange", "1,1,1,1"),
            tag("features", tag("GeomFeature", name="f")),
            name="default",
        ).encode()
    ]
)
def installation(data: bytes) -> None:
    with suppress(DocumentError):
        read_installation(data, "default")
    with suppress(ConfigError):
        read_safety(file("any.installation", data), load_model("ur5e"))


@target(b"a=1\n#c\nb = p[0,0,0,0,0,0]\nc=\\u00e4\\n\n", b'<variables><variable name="a" value="1"/></variables>')
def variables(data: bytes) -> None:
    with suppress(DocumentError):
        read_variables(data)
