"""How findings are reported, for which versions, and with which exit status."""

import io
import json
import subprocess
import time
from types import SimpleNamespace

import pytest

from tests.rows import each_row
from urproto.compat import module_command
from urscript.check.rules import RULES

WRONG = "def a():\n\tx = norn(1)\n  norm(1, 2)\nend\n"


def test_text_shows_each_finding_with_its_line(check):
    assert check({"a.script": WRONG}) == 1
    assert check.out.splitlines() == [
        "a.script:2:6: function 'norn' is not defined; did you mean 'norm'? [URS002]",
        "  2 | \tx = norn(1)",
        "    | \t    ^",
        "a.script:3:3: warning: Type error: norm takes exactly 1 arguments (2 given) [URS101]",
        "  3 |   norm(1, 2)",
        "    |   ^",
    ]


@each_row(
    ("text", "words", "status", "last"),
    [
        ("sync()\n", [], 0, "no problems found for PolyScope 3.15.8"),
        ("norm(1, 2)\n", [], 0, "no errors, 1 warning for PolyScope 3.15.8"),
        ("norm(1, 2)\n", ["--strict"], 1, "no errors, 1 warning for PolyScope 3.15.8"),
        ("sync()\n", ["--model=ur5e"], 0, "for PolyScope 5.22.0"),
        ("sync()\n", ["--polyscope=5.21.3"], 0, "for PolyScope 5.21.3"),
        ("sync()\n", ["--model=ur5", "--polyscope=5.11"], 2, "UR5 (CB3) requires PolyScope 3.0 to 3.15, not 5.11"),
        ("sync()\n", ["--polyscope=4.2"], 2, "4.2"),
        ("sync()\n", ["--polyscope=5.12,five"], 2, "'five' is not a PolyScope version"),
        ("sync()\n", ["--model=ur99"], 2, "ur99"),
        ("sync()\n", ["missing.script"], 2, "missing.script: No such file"),
        pytest.param("x" * ((4 << 20) + 1), [], 2, "more than 4,194,304 bytes", id="too large"),
    ],
)
def test_exit_status(check, text, words, status, last):
    assert check({"a.script": text}, "a.script", *words) == status
    assert last in (check.err if status == 2 else check.out).splitlines()[-1]


def test_several_versions_are_one_table(check, findings):
    files = {"a.script": "x = make_list(3, 0)\ny = z\n", "urscript.toml": 'versions = ["5.12", "5.25"]'}
    assert check(files, "a.script", "--polyscope=3.15,5.12,5.25") == 1
    assert check.out.splitlines()[-4:] == [
        "",
        "finding              3.15.0  5.12.0  5.25.0",
        "a.script:1:5 URS003  x       x       -",
        "a.script:2:5 URS002  x       x       x",
    ]
    check(files, "a.script", "--format=json")
    assert [found["versions"] for found in json.loads(check.out)] == [["5.12.0"], ["5.12.0", "5.25.0"]]
    assert check({"urscript.toml": 'models = ["ur3", "ur3e"]', "b.script": "sync()\n"}, "b.script") == 0
    assert "for PolyScope 3.15.8, 5.22.0" in check.out


def test_json_has_every_field(check):
    check({"a.script": WRONG}, "a.script", "--format=json")
    assert json.loads(check.out)[1] == {
        "file": "a.script",
        "line": 3,
        "column": 3,
        "code": "URS101",
        "rule": "argument-count",
        "severity": "warning",
        "message": "Type error: norm takes exactly 1 arguments (2 given)",
        "versions": ["3.15.8"],
    }


def test_github_annotations_are_escaped(check):
    check({"a,b:c%.script": WRONG}, "a,b:c%.script", "--format=github")
    error, warning = check.out.splitlines()
    assert error == (
        "::error file=a%2Cb%3Ac%25.script,line=2,col=6,title=URS002 unknown-name::"
        "function 'norn' is not defined; did you mean 'norm'?"
    )
    assert warning.startswith("::warning ")


def test_sarif_has_what_its_schema_requires(check):
    """The required properties of each object in OASIS' schema of SARIF 2.1.0, and the values that it restricts."""
    check({"a b/é.script": WRONG.encode() + b"# \xff\n"}, "a b/é.script", "--format=sarif")
    log = json.loads(check.out)
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    assert run["columnKind"] in ("utf16CodeUnits", "unicodeCodePoints")
    driver = run["tool"]["driver"]
    assert driver["name"]
    assert [rule["id"] for rule in driver["rules"]] == list(RULES)
    for result in run["results"]:
        assert result["message"]["text"]
        assert result["level"] in ("none", "note", "warning", "error")
        assert driver["rules"][result["ruleIndex"]]["id"] == result["ruleId"]
        place = result["locations"][0]["physicalLocation"]
        assert place["artifactLocation"]["uri"] == "a%20b/%C3%A9.script"  # a URI reference of RFC 3986
        assert place["region"]["startLine"] >= 1
        assert place["region"]["startColumn"] >= 1
    assert [(r["ruleId"], r["level"]) for r in run["results"]] == [("URS002", "error"), ("URS101", "warning")]


def test_standard_input(check, monkeypatch):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(WRONG.encode())))
    assert check({}, "-") == 1
    assert check.out.startswith("<stdin>:2:6: ")


def test_the_command_does_not_load_the_emulator(tmp_path):
    path = tmp_path / "a.script"
    path.write_text(WRONG)
    program = "import sys; from urscript.__main__ import main; sys.argv[1:] = ['check', 'a.script']\n"
    program += "try: main()\nfinally: assert not [name for name in sys.modules if name.startswith('emulator')]\n"
    ran = subprocess.run([*module_command("urscript")[:1], "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (1, "")


ROW = "def f():\n"
HOSTILE = {
    "statements.script": "x=1\n" * 8000,
    "functions.script": ROW + "".join(f"def g{n}():\nx{n}=1\nend\n" for n in range(1500)) + "end\n",
    "calls.script": ROW
    + "".join(f"def g{n}():\ng{n + 1}()\nend\n" for n in range(900))
    + "def g900():\nsync()\nend\nwhile True:\ng0()\nend\nend\n",
    "branches.script": ROW + "def g(a):\n" + "".join(f"if a:\nx{n}=y\nend\n" for n in range(1500)) + "end\nend\n",
    "loops.script": ROW + "while True:\n" * 20 + "x=1\n" * 2000 + "end\n" * 21,
    "moves.script": ROW + "movel(p[0,0,0,0,0,0],r=1)\n" * 1200 + "end\n",
    "ends.script": "end\n" * 4000,
    "braces.script": "{" * 20_000,
    "holes.script": "{a} " * 8000,
    "unclosed.py": 'a = "' + "\\" * 20_001,
    "sum.py": "a = " + '"def f():" + ' * 800 + '"end"\n',
    "ends.py": 'a = """def f():\n' + "end # end\n" * 5000 + "x" + '"""\n',
    "strings.cpp": 'f("def f():\\n' + 'end");f("' * 20_000,
    "comments.cpp": "/*" * 40_000,
    "ignore.script": "# urscript: ignore[" * 2000 + "\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_take_time_in_proportion_to_their_size(check, name):
    """Four times the size takes less than eight times as long (16, were it quadratic); what is fast anyway may vary."""
    whole = HOSTILE[name]
    took: list[float] = []
    for text in (whole[: len(whole) // 4], whole) * 3:  # other programs may slow down one of them
        began = time.process_time()
        check({name: text, "urscript.toml": 'templates = ["braces.*", "holes.*"]'}, name)
        took.append(time.process_time() - began)
        if len(took) % 2 == 0 and took[-1] < max(8.0 * took[-2], 0.5):
            return
    pytest.fail(f"the whole takes too long, each time after a quarter of it: {took} s")


def test_a_long_chain_of_calls_is_no_error(check):
    assert check({"calls.script": HOSTILE["calls.script"]}) == 0, check.out[-300:]
