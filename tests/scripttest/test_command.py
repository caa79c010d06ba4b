"""``urscript test``: finding, running and reporting tests that are written in URScript."""

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from emulator import script_cli as cli
from tests.rows import each_row
from urscript.scripttest.program import Source

ROOT = Path(__file__).resolve().parents[2]
Go = Callable[..., tuple[int, str]]

LIBRARY = """def near(a, b):
  if norm(a - b) < 0.1:
    return True
  end
  return False
end
"""


@pytest.fixture
def go(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Go:
    """go({name: text}, *options) -> exit status and output, in the folder of these files."""
    monkeypatch.chdir(tmp_path)

    def run(files: dict[str, str], *options: str) -> tuple[int, str]:
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        status = cli.main(["test", *options])
        return status, capsys.readouterr().out

    return run


def one(body: str, **more: str) -> dict[str, str]:
    return {
        "test_a.script": f"def test_it():\n{body}\nend\n",
        **{f"test_a.{kind}": text for kind, text in more.items()},
    }


ASSERTIONS = [
    ("assert_true(1 < 2)", ""),
    ("assert_true(1)", "1 is not True"),
    ('assert_true(False, "why")', "why: False is not True"),
    ("assert_equal([1, 2.0], [1.0, 2])", ""),
    ("assert_equal(1, True)", "1 is not True"),
    ('assert_equal("a", "b")', '"a" is not "b"'),
    ("assert_near([1, 2], [1.01, 2], 0.02)", ""),
    ("assert_near([1, 2], [1.01, 2], 0.005)", "element 0: they differ by 0.01"),
    ("assert_near([1], [1, 2])", "1 elements instead of 2"),
    ('assert_near("a", 1)', "only numbers"),
    ("assert_near(p[0,0,0,0,0,3.14], p[0.001,0,0,0,0,-3.14], 0.002, 0.01)", ""),
    ("assert_near(p[0,0,0,0,0,0.1], p[0,0,0,0,0,0], 0.1, 0.05)", "0 m and 0.1 rad apart"),
    ('textmsg("now ", 3)\nassert_logged("now ?")', ""),
    ('popup("stop", title="T")\nassert_logged("popup T: st*")', ""),
    ('textmsg("x")\nassert_logged("y")', '"y" is not in the log'),
    ('assert_sent("x", "10.0.0.9:1")', 'there is no peer "10.0.0.9:1"'),
    ('set_test_input("digital3", 1)\nsync()\nassert_true(get_standard_digital_in(3))', ""),
    ('set_test_input("float2", 2.5)\nsync()\nassert_equal(read_input_float_register(2), 2.5)', ""),
    ('set_test_input("digital9", 1)', "there is no digital9"),
    ('assertEqual(name = "n", result = 1, expected = 2)', "n: 1 is not 2"),
    ("setTestExecutionTimeout(100)\nsleep(1)", "not finished within 0.108 s"),
    ('setIgnoreErrorCode("C50")\nset_standard_digital_out(1, True)\nassert_true(get_standard_digital_out(1))', ""),
    ("x = [1]\nx = x[3]", "test_a.script:3:6: Index out of bounds"),
    ("halt", ""),
]


@each_row(("body", "problem"), ASSERTIONS, ids=[body.partition("\n")[0] for body, _ in ASSERTIONS])
def test_assertions(body: str, problem: str, go: Go) -> None:
    status, out = go(one(body))
    assert status == int(bool(problem)), out
    assert problem in out


def test_a_failure_names_the_place_in_its_file(go: Go) -> None:
    files = {"near.script": LIBRARY, "test_near.script": "def test_it():\n  assert_true(near(1, 1.5))\nend\n"}
    status, out = go(files)
    assert status == 1
    assert (
        "test_near.script:2:3: assertion failed: False is not True\n  2 |   assert_true(near(1, 1.5))\n    |   ^" in out
    )
    assert (
        go(files | {"near.script": LIBRARY.replace("a - b", "a - bb")})[1].count("near.script:2:15: variable 'bb'") == 1
    )


SETTINGS = [
    ("assert_near(get_actual_joint_positions()[1], -1.2)", "joints: [0, -1.2, 1, -1, -1, 0]", ""),
    (
        "sleep(0.3)\nassert_equal([get_standard_digital_in(3), read_input_integer_register(24)], [True, 7])",
        'input: {digital3: "1@0.2"}\nregister: ["int24=7"]',
        "",
    ),
    ('assert_equal(request_integer_from_primary_client("?"), 5)', "answer: 5", ""),
    ("assert_equal(str_len(get_controller_id()), 1)", "model: ur5e\npolyscope: '5.12'", "is not defined"),
    ("sleep(100)", "timeout: 2", "not finished within 2 s"),
    ("sleep(100)", "timeout: 2\nfails: not finished", ""),
    ("sleep(1)", "fails: not finished", "it did not fail with 'not finished'"),
    ('textmsg("bye")\nhalt', "logs: by?", ""),
    ("halt", "logs: by?", "'by?' is not in the log"),
    ("movej([0, -1, 1, 0, 0, 0])", "fault: 'joint_fault,joint=2,after=0.1'\nfails: 'the arm was stopped: fault'", ""),
    ("sleep(1)", "tests: {test_it: {timeout: 0.5}}", "not finished within 0.5 s"),
    ("sleep(1)", "tests: {test_other: {}}", "there is no test test_other"),
    ("sleep(1)", "colour: red", "unrecognized arguments: --colour red"),
    ("sleep(1)", "program: gone.script", "there is no file gone.script"),
    ("sleep(1)", "peers: {sockets: {a: {}}}", "is not an address"),
    ("sleep(1)", "peers: gone.yaml", "gone.yaml"),
]


@each_row(("body", "settings", "problem"), SETTINGS, ids=[text for _, text, _ in SETTINGS])
def test_settings(body: str, settings: str, problem: str, go: Go) -> None:
    status, out = go(one(body, yaml=settings))
    assert status == int(bool(problem)), out
    assert problem in out


def test_mocks_replace_calls_everywhere_but_in_themselves(go: Go) -> None:
    files = {
        "cell.script": 'def step(q):\n  movej(q)  # movej(q)\n  return str_cat("movej(", add(1, 2))\nend\n'
        "def  add(a, b):\n  return a + b\nend\n",
        "test_cell.script": """calls = 0
            def mock_movej(q): calls = calls + 1 end
            def mock_add(a, b): return add(a, b) * 10 end
            def after_each(): textmsg("calls ", calls) end
            def test_step():
              assert_equal(step([0, 0, 0, 0, 0, 0]), "movej(30")
              assert_equal(calls, 1)
            end
            """,
        "test_cell.yaml": "logs: calls 1",
    }
    assert go(files)[0] == 0


def test_files_of_another_runner(go: Go) -> None:
    """The syntax and the layout of Hirebotics' urscript-tester."""
    files = {
        "urtester.config.json": '{"controller": {"autoLaunch": {"version": "5.3.1"}}, "sources": {"global": {"scripts":'
        '{"include": ["./src/**/*.script"], "exclude": ["./src/**/__tests__/*.script"]}}},'
        '"mocks": {"include": ["__mocks__/*.mock.script"]}}',
        "src/tool/grip.script": "def grip(n):\n  set_tool_digital_out(n, True)\n  return get_tool_digital_in(n)\nend",
        "src/tool/__tests__/grip.test.script": """local closed = False
            def beforeEach():
              closed = True
            end
            def test_gripIsClosed():
              local result = grip(0)
              assertEqual(
                name = "closed",
                result = result,
                expected = closed
              )
            end
            def test_gripFails():
              closed = False
              assertEqual("open", grip(1), True)
            end
            """,
        "__mocks__/io.mock.script": "def mock_get_tool_digital_in(n):\n  return closed\nend",
    }
    status, out = go(files, "src")
    assert status == 1
    assert "::test_gripIsClosed PASSED" in out
    assert "::test_gripFails FAILED" in out
    assert "open: False is not True" in out


@each_row(
    ("text", "is_program", "definitions"),
    [
        ("def cell():\nend\n", True, [("cell", 1)]),
        ("# a comment\n\ndef cell():\n  def f(a):\n  end\nend\n", True, [("cell", 3)]),
        ("def f(a):\nend\n", False, [("f", 1)]),
        ("thread t():\nend\n", False, [("t", 1)]),
        ("x = 1\ndef f():\nend\n", False, [("f", 2)]),
        ("def f():\nend\n\ndef g():\nend\n", False, [("f", 1), ("g", 4)]),
    ],
)
def test_a_single_def_without_parameters_is_a_program(
    text: str, is_program: bool, definitions: list[tuple[str, int]], tmp_path: Path
) -> None:
    (tmp_path / "a.script").write_text(text)
    source = Source(tmp_path / "a.script")
    assert (source.is_program, [(one.name, one.line) for one in source.definitions]) == (is_program, definitions)
    assert source.variables() == []


CELL = """def cell():
  count = 0
  def odd(n):
    return n % 2 == 1
  end
  while count < 3:
    if odd(count): textmsg("odd") end
    count = count + 1
  end
  if count > 5:
    textmsg("many")
  elif count == 3:
    sleep(1)
  else:
    textmsg("few")
  end
  thread never():
    sleep(1)
  end
end
"""


def test_coverage_and_profile(go: Go, tmp_path: Path) -> None:
    files = {
        "cell.script": CELL,
        "test_cell.script": "def test_cell():\n  cell()\n  assert_equal(count, 3)\nend\n"
        "def test_odd():\n  assert_true(odd(3))\nend\n",
    }
    status, out = go(files, "--lcov", "a.info", "--profile", "a.json")
    assert status == 0
    assert "cell.script  7/10 (70%)  5/7 (71%)  11, 15, 18" in out
    info = (tmp_path / "a.info").read_text().splitlines()
    assert [line for line in info if line.startswith(("DA:4,", "DA:7,", "DA:11", "BRDA:6", "BRDA:7", "BRDA:10"))] == [
        *("BRDA:6,0,0,3", "BRDA:6,0,1,1"),
        *("BRDA:7,1,0,1", "BRDA:7,1,1,2"),
        *("BRDA:10,2,0,0", "BRDA:10,2,1,1", "BRDA:10,2,2,0"),
        *("DA:4,4", "DA:7,3", "DA:11,0"),
    ]
    profile = json.loads((tmp_path / "a.json").read_text())
    frames = [frame["name"] for frame in profile["shared"]["frames"]]
    [slow] = [one for one in profile["profiles"] if "test_cell " in one["name"]]
    spent = {tuple(frames[n] for n in stack): s for stack, s in zip(slow["samples"], slow["weights"], strict=True)}
    assert spent["test_cell:2", "cell:13"] == pytest.approx(1.0, abs=0.02)
    assert sum(slow["weights"]) == pytest.approx(slow["endValue"])


def test_tests_in_processes_are_reported_in_order_and_as_junit(go: Go, tmp_path: Path) -> None:
    bodies = {"test_b": 'textmsg("was here")\nassert_true(False)', "test_a": "sleep(1)", "test_c": "sleep(0.1)"}
    text = "".join(f"def {name}():\n{body}\nend\n" for name, body in bodies.items())
    status, out = go({"one_test.script": text, "sec_test.script": "sec s():\nend"}, "-n", "2", "--junit", "r.xml")
    assert status == 1
    assert [line.split()[:2] for line in out.splitlines()[:4]] == [
        ["sec_test.script", "ERROR"],
        ["one_test.script::test_b", "FAILED"],
        ["one_test.script::test_a", "PASSED"],
        ["one_test.script::test_c", "PASSED"],
    ]
    suite = ElementTree.parse(tmp_path / "r.xml").getroot()[0]
    assert [suite.get(name) for name in ("tests", "failures", "errors")] == ["4", "1", "1"]
    failed = suite.find("testcase[@name='test_b']")
    assert failed is not None
    assert "False is not True" in failed.find("failure").get("message")
    assert "was here" in failed.findtext("system-out")


def test_usage(go: Go, capsys: pytest.CaptureFixture[str]) -> None:
    assert go({}) == (1, "no tests found (0.0 s of robot time)\n")
    assert cli.main(["test", "gone"]) == 2
    assert "there is no file or folder gone" in capsys.readouterr().err
    status, out = go(one("sleep(1)"), "-k", "other")
    assert (status, out) == (1, "no tests found (0.0 s of robot time)\n")


def test_the_example_cells(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    status = cli.main(["test", "examples/cells"])
    out = capsys.readouterr().out
    assert status == 0, out
    assert "14 passed" in out
