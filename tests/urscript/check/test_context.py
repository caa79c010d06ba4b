"""What surrounds a program: the project file, templates, host files, program trees."""

from typing import cast

import pytest

from emulator.builtins import LIBRARIES
from emulator.scripttest.assertions import TestRun, assertions
from tests.rows import each_row
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.check import signatures
from urscript.check.names import urcaps
from urscript.polyscope.editing import ROOT, ProgramEditor
from urscript.polyscope.files import new_program
from urscript.polyscope.installation_file import InstallationFile

NODE = "grip(20)\nspeed = limit\n"  # the text of a Script node, which uses what others define

# project file, further files, and what is found in NODE
PROJECTS = [
    ("", {}, [(1, "URS002"), (2, "URS002")]),
    ('provides = ["grip(width)", "limit"]', {}, []),
    ('provides = ["grip(width, force=20)", "limit"]', {}, []),
    ('provides = ["grip()", "limit"]', {}, [(1, "URS101")]),
    ('include = ["lib/*.txt"]', {"lib/a.txt": "def grip(w):\nend\nlimit = 1\n"}, []),
    ('include = ["lib.txt"]', {"lib.txt": "def lib():\n limit = 1\n def grip(w):\n end\nend\n"}, []),
    ('preamble = "pre.txt"', {"pre.txt": "limit = 1\ndef grip(w):\n return w\nend\n"}, []),
    ('ignore = ["URS0"]', {}, []),
    ('select = ["URS1"]', {}, []),
    ('select = ["URS0"]\nignore = ["URS002"]', {}, []),
]


@each_row(("project", "files", "found"), PROJECTS)
@each_row("name", ["urscript.toml", "pyproject.toml"])
def test_a_project_file_says_what_surrounds_its_programs(findings, name, project, files, found):
    text = f"[tool.urscript]\n{project}\n" if name == "pyproject.toml" else project
    rows = findings({name: text, "cell/node.script": NODE, **files}, "cell/node.script")
    assert [(line, code) for _, line, _, code in rows] == found


def test_a_preamble_may_leave_its_def_open(findings):
    files = {
        "urscript.toml": 'preamble = "head.txt"',
        "head.txt": "def cell():\n  def grip(w):\n    return w\n  end\n  x = elsewhere\n",
        "rest.script": "  grip(20)\n  nothing()\nend\n",
        "open/urscript.toml": 'open = ["head.*"]',
        "open/head.script": "def cell():\n  def grip(w):\n    x = = 1\n    return later(w)\n  end\n",
    }
    assert findings(files, "rest.script", "open/head.script") == [
        ("rest.script", 2, 3, "URS002"),
        ("open/head.script", 3, 9, "URS001"),
    ]


def test_names_of_urcaps_depend_on_their_version(check, findings):
    text = {"a.script": "rq_open_and_wait()\nrq_move_mm(1)\n"}
    check(text)
    assert 'urcaps = ["robotiq-grippers"]' in check.out
    assert findings({"urscript.toml": 'urcaps = ["robotiq-grippers"]'}, "a.script") == [("a.script", 2, 1, "URS002")]
    assert findings({"urscript.toml": 'urcaps = ["robotiq-grippers 1.7"]'}, "a.script") == []
    assert {"onrobot", "rg-onrobot", "external-control", "machinelogic"} <= set(urcaps())


@each_row(
    ("text", "message"),
    [
        ("inclde = []", "unknown key 'inclde'"),
        ('include = "a"', "include must be a list of texts"),
        ("preamble = 1", "preamble must be a text"),
        ('select = ["E501"]', "unknown rule 'E501'"),
        ('versions = ["five"]', "'five' is not a PolyScope version"),
        ('urcaps = ["robotiq"]', "unknown URCap 'robotiq'"),
        ('urcaps = ["onrobot 9"]', "unknown version of onrobot '9'"),
        ('provides = ["grip(1)"]', "a parameter that is not a name"),
        ('include = ["missing.script"]', "no file 'missing.script'"),
        ('preamble = "missing.script"', "missing.script: No such file"),
        ("x = ", "urscript.toml: "),
    ],
)
def test_a_mistake_in_a_project_file_is_one_line(check, text, message):
    assert check({"urscript.toml": text, "a.script": "sync()\n"}, "a.script") == 2
    assert message in check.err
    assert check.err.count("\n") == 1
    assert "urscript.toml" in check.err
    assert check({}, "--isolated", "a.script") == 0


def test_what_no_program_of_a_project_uses_is_reported(findings):
    files = {
        "urscript.toml": 'include = ["used.txt",\n  "unused.txt"]',
        "used.txt": "def grip():\nend\n",
        "unused.txt": "def release():\nend\n",
        "a.script": "grip()\n",
    }
    assert findings(files, ".") == [("urscript.toml", 2, 1, "URS205")]
    assert findings(files, "a.script") == []


@each_row(
    ("comment", "found"),
    [
        ("", [1, 3]),
        ("# urscript: ignore[URS002]", [3]),
        ("# because  urscript: ignore[URS1, URS0]", [3]),
        ("# urscript: ignore[URS1]", [1, 3]),
        ("# urscript: ignore-file[URS002]", []),
    ],
)
def test_comments_leave_findings_out(findings, comment, found):
    rows = findings({"a.script": f"x = y {comment}\nsync()\nz = y\n"})
    assert [line for _, line, _, _ in rows] == found


def test_templates_are_checked_with_their_placeholders(findings):
    text = (
        "def {{name}}():\n  {{BEGIN}}\n  q = p[{pose}]\n  servoj(q, t={t}, {{MORE}})\n"
        '  textmsg("{{kept}}")\n  {{CALL}}({x})\n  x = y\n  movel(p{x}, v=0.{v}, r=1{r})\n  my_{{a}}_{{b}}()\nend\n'
    )
    assert findings({"urscript.toml": 'templates = ["*.in"]', "a.script.in": text}, "a.script.in") == [
        ("a.script.in", 7, 7, "URS002")
    ]


PYTHON = """"Not a program: def f(): lost end"
A = \"\"\"
def f():
  movej(lost1)
end
\"\"\"
B = ("def g():\\n"
     "  textmsg(lost2)\\n"
     "end\\n")
C = f\"\"\"def {NAME}():
  x = {VALUE:.3f} + lost3
  y = {{lost4}}
end\"\"\"
D = "def h():\\n  " + make() + "\\n  movel(lost5)\\nend\\n"
E = "def %s():\\n  sleep(%.3f)\\n  movel(lost6)\\nend" % (name, 1)
F = "def {}():\\n  sleep({x})\\n  movel(lost7)\\nend".format(a, x=2)
G = 'é' + r\"\"\"def raw():
  x = lost8
end
\"\"\"
part = HEAD + "def k():\\n lost()\\nend"
open_ = "def k():\\n def inner():\\n  lost()\\n end"
"""
CPP = """// "def no(): lost() end"
const char* A = R"x(
def f():
  movej(lost1)
end
)x";
auto b = "def g():\\n"  // first
         "  textmsg(lost2)\\n"
         "end\\n";
snprintf(c, n, "def h():\\n sleep(%.2lf)\\n movel(lost3)\\nend\\n", t);
char quote = '"'; const char* d = "lost";
"""


@pytest.mark.parametrize(("name", "text", "numbers"), [("a.py", PYTHON, "123567"), ("a.cpp", CPP, "123")])
def test_programs_in_literals_are_found_where_the_host_file_has_them(findings, name, text, numbers):
    rows = [text.split("\n")[line - 1][column - 1 :] for _, line, column, _ in findings({name: text})]
    assert [row[:5] for row in rows] == [f"lost{number}" for number in numbers]


def test_a_folder_has_scripts_and_program_trees(check, findings):
    version, arm = PolyscopeVersion(5, 22), load_model("ur5e")
    root = new_program("tree", version, arm, external_control=False)
    editor = ProgramEditor(root, "tree", InstallationFile(), version, arm)
    editor.insert("wait", into=ROOT, values={"type": "Sleep", "time": 0.5})
    editor.insert("script", into=ROOT, values={"type": "Line", "line": "grip()"})
    tree = editor.document()
    files = {
        "cell/a.script": "grip()\n",
        "cell/deep/b.urscript": "sync()\n",
        "cell/tree.urp": tree,
        "cell/note.txt": "(",
    }
    assert findings(files, "cell", "--polyscope=5.22") == [
        ("cell/a.script", 1, 1, "URS002"),
        ("cell/tree.urp", 4, 5, "URS002"),
    ]
    script = 'def tree():\n  $ 2 "Robot Program"\n  $ 3 "Wait"\n  sleep(0.5)\n  $ 4 "Script"\n  grip()\nend\n'
    of_scripts = [("cell/a.script", 1, 1, "URS002"), ("cell/tree.script", 6, 3, "URS002")]
    assert findings({"cell/tree.script": script}, "cell") == of_scripts  # not of tree.urp as well
    stale = {"cell/tree.script": script.replace("0.5", "0.7")}
    assert findings(stale, "cell") == [*of_scripts, ("cell/tree.urp", 3, 1, "URS108")]
    editor.insert("script", into=ROOT, values={"type": "File", "file": "/programs/a.script"})
    found = findings({"cell/tree.urp": editor.document()}, "cell")
    assert not [file for file, *_ in found if file == "cell/a.script"]  # a.script is a part of tree
    editor.insert("set", into=ROOT, values={"type": "DigitalOutput", "output": "digital_out[0]", "level": "1"})
    broken = editor.document().replace(b"digital_out[0]", b"nowhere")
    assert [code for *_, code in findings({"broken.urp": broken})] == ["URS004"]
    assert check({"no.urp": "nothing"}) == 2
    assert check.err.startswith("urscript: no.urp: ")


@pytest.mark.parametrize(
    "text",
    [
        "def f():\n  t = time()\n  textmsg(t.sec - t.nanosec)\nend\n",
        "def f():\n  {% if NEW %} # from 5.23\n    sync()\n  {% endif %}\nend\n",
    ],
    ids=["a member named sec", "a placeholder with a comment"],
)
def test_forms_of_public_programs(findings, text):
    project = 'templates = ["*"]\nprovides = ["time()"]\n'
    assert findings({"urscript.toml": project, "a.script": text}, "a.script") == []


OWN_TESTS = {
    "cell.script": 'def cell():\n  name = "a"\n  def grip(n):\n    return lift(n)\n  end\n  grip(1)\nend\n',
    "lib/lift.script": "def lift(n):\n  return n\nend\n",
    "lib/io.mock.script": "def mock_get_standard_digital_in(n):\n  return n == known\nend\nknown = 1\n",
    "test_cell.yaml": "program: [cell.script, lib/lift.script]\nmocks: lib/io.mock.script\n",
    "test_cell.script": """def mock_lift(n):
  return lift(n) + wrong
end
def before_each():
  name = "b"
end
def test_grip():
  cell()
  lift(1) lift(missing)
  assert_equal(grip(2), 2, message="grips")
  assert_true(get_standard_digital_in(known), about="no such")
end
""",
}
RIVALS_TESTS = {
    "urtester.config.json": '{"sources": {"global": {"scripts": {"include": ["src/*.script"]}}},'
    ' "mocks": {"include": ["mocks/*"]}}',
    "src/tool.script": "def grip(n):\n  return n\nend\n",
    "src/tests/tool.test.script": "local closed = False\ndef beforeEach():\n  closed = True\nend\n"
    'def test_grip():\n  assertEqual(name = "a", result = grip(0), expected = closed)\n  setIgnoreErrorCode(1)\nend\n',
    "mocks/io.mock.script": "def mock_sleep(t):\n  sync()\nend\n",
}


@each_row(
    ("files", "file", "expected"),
    [
        (OWN_TESTS, "test_cell.script", [(2, 20, "URS002"), (9, 16, "URS002"), (11, 3, "URS101")]),
        (RIVALS_TESTS, "src/tests/tool.test.script", []),
        ({"test_alone.script": "def test_x():\n  assert_true(gone())\n"}, "test_alone.script", [(3, 1, "URS001")]),
        ({"other.script": "assert_true(True)\n"}, "other.script", [(1, 1, "URS002")]),
    ],
)
def test_tests_are_checked_together_with_their_program(findings, files, file, expected):
    assert findings(files, file) == [(file, *found) for found in expected]


def test_the_signatures_are_those_of_the_emulator():
    """They are written by docs/generate.py; every part that the compiler reads comes back."""
    known = signatures.libraries(in_tests=True).builtins
    for name, builtin in LibrarySet([*LIBRARIES, assertions(cast(TestRun, None))]).builtins.items():
        assert [*signatures.table([builtin])] == [*signatures.table([known[name]])]
        assert [(p.kind, p.optional, p.required) for p in builtin.parameters] == [
            (p.kind, p.optional, p.required) for p in known[name].parameters
        ]
