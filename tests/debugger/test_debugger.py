"""The debugger, by its protocol: stops, steps in both directions, values, and wrong requests."""

import os
import re
import signal
import time

import pytest
from dap_client import CELL, DebugClient

from emulator.branches import can_branch

pytestmark = pytest.mark.skipif(not can_branch(), reason="the system cannot copy processes")


@pytest.fixture
def cell(tmp_path):
    file = tmp_path / "cell.script"
    file.write_text(CELL)
    return file


def test_breakpoints_steps_and_values(client, cell):
    client.launch(
        cell,
        [
            {"line": 4, "condition": "x == 1"},
            {"line": 17, "logMessage": "now {z * 10}"},
            {"line": 18, "hitCondition": "3"},
        ],
    )
    assert client.stopped() == ("breakpoint", [("move", 4), ("main", 16)])
    assert client.said.startswith("now 0\n")
    assert client.variables(client.frame) == {"x": "1"}
    assert client.variables() == {"count": "1", "z": "0"}
    assert client.request("evaluate", expression="x * 10 + count", frameId=client.frame)["result"] == "11"
    robot = client.variables(2)
    assert robot["robot_mode"] == "RUNNING"
    assert [thread["name"] for thread in client.request("threads")["threads"]] == ["cell", "blink"]
    assert client.go("next")[1] == [("move", 5), ("main", 16)]
    assert client.go("stepOut")[1] == [("main", 17)]
    assert "z 0\n" in client.said
    assert client.go("next")[1] == [("main", 18)]
    assert client.go("next")[1] == [("main", 15)]
    assert client.go("stepIn")[1] == [("main", 16)]
    assert client.go("stepIn")[1] == [("move", 4), ("main", 16)]
    assert client.request("setVariable", variablesReference=1, name="count", value="count + 1") == {"value": "3"}
    assert client.go() == ("breakpoint", [("main", 18)])
    assert client.variables()["count"] == "3"
    client.request("setBreakpoints", source={"path": str(cell)}, breakpoints=[])
    assert client.go() == ("terminated", None)
    assert not client.answer("continue")["success"]


@pytest.mark.parametrize(
    "filler", ["", pytest.param("    x = x + 0\n" * 1500, marks=pytest.mark.long)], ids=["short", "long"]
)
def test_local_variables_can_be_set(client, tmp_path, filler):
    """Also those of a function so long that it keeps them in a mapping, and of a caller."""
    file = tmp_path / "locals.script"
    file.write_text(
        "def locals():\n  def inner(x):\n    y = [x, 2]\n    s = 0.5\n    sync()\n"
        f"{filler}    return x + s + y[0]\n  end\n  def outer(n):\n    z = inner(n)\n    return n + z\n  end\n"
        "  textmsg(outer(1))\nend\n"
    )
    client.launch(file, [{"line": 5}])
    client.stopped()
    frames = client.request("stackTrace", threadId=client.thread)["stackFrames"]
    inner, outer = frames[0]["id"], frames[1]["id"]
    assert client.variables(inner) == {"x": "1", "y": "[1, 2]", "s": "0.5"}
    for frame, name, text, after in ((inner, "x", "x + 9", "10"), (inner, "s", "2", "2.0"), (outer, "n", "100", "100")):
        answer = client.request("setVariable", variablesReference=frame, name=name, value=text)
        assert answer == {"value": after} == {"value": client.variables(frame)[name]}
    for name, text in (("x", "0.5"), ("y", "1"), ("none", "1")):
        assert not client.answer("setVariable", variablesReference=inner, name=name, value=text)["success"]
    assert client.go() == ("terminated", None)
    assert "113\n" in client.said.replace("113.0", "113")


def test_functions_and_the_entry(client, cell):
    client.launch(cell, functions=["move"], stopOnEntry=True)
    assert client.stopped() == ("entry", [("main", 2)])
    assert client.go() == ("function breakpoint", [("move", 4), ("main", 16)])
    assert client.go() == ("function breakpoint", [("move", 4), ("main", 16)])
    assert client.variables()["count"] == "1"


def test_going_back_returns_to_the_same_moments(client, cell):
    """All that the robot and the program show at each statement is the same, forwards and backwards."""
    client.launch(cell, stopOnEntry=True)
    client.stopped()
    seen = {}

    def moment():
        return (client.place(), client.variables(), client.variables(2))

    for number in range(16):
        seen[number] = moment()
        client.go("stepIn")
    assert len({str(one) for one in seen.values()}) > 14
    for number in range(15, 8, -1):
        assert client.go("stepBack")[0] == "step"
        if client.place()[0] == seen[number][0][0]:  # it does not go back into functions
            assert moment() == seen[number]
    client.request("setBreakpoints", source={"path": str(cell)}, breakpoints=[{"line": 17}])
    assert [client.go()[0] for _ in range(4)] == ["breakpoint"] * 4
    last = moment()
    earlier = []
    while client.go("reverseContinue")[0] == "breakpoint":
        earlier.append(client.variables()["count"])
    assert earlier == ["2", "1", "0"]
    assert client.place() == [("main", 2)]
    for _ in range(4):
        client.go()
    assert moment() == last
    assert client.go() == ("terminated", None)
    assert client.go("stepBack")[0] == "step"
    assert client.variables()["count"] == "4"


def test_pause_and_what_stops_a_program(client, tmp_path):
    file = tmp_path / "cell.script"
    file.write_text('def cell():\n  n = 0\n  while n >= 0:\n    n = n + 1\n    sync()\n  end\n  write = n + "a"\nend\n')
    client.launch(file)
    client.request("threads")
    client.send("pause", threadId=1)
    reason, place = client.stopped()
    assert reason == "pause"
    assert place[0][1] in (2, 3, 4, 5)
    if place[0][1] == 2:
        client.go("next")  # the pause came before the first statement, which would undo what follows
    client.request("setVariable", variablesReference=1, name="n", value="-9")
    reason, _ = client.go()
    assert reason == "exception"
    assert "line 7" in client.events[-1][1]["text"]
    assert client.go("stepBack") == ("step", [("main", 7)])


def test_a_protective_stop(client, tmp_path):
    file = tmp_path / "reach.script"
    file.write_text("def reach():\n  speedj([0, 0, 0, 0, 0, 3], 10, 10)\nend\n")
    client.launch(file)
    assert client.stopped()[0] == "exception"
    assert "PROTECTIVE_STOP" in client.events[-1][1]["text"]
    assert client.variables(2)["safety_mode"] == "PROTECTIVE_STOP"
    client.request("setExceptionBreakpoints", filters=[])


def test_wrong_requests(client):
    client.request("initialize")
    for command, arguments, message in (
        ("launch", {"program": "none.script"}, "none.script"),
        ("launch", {}, "program"),
        ("launch", {"program": "cell.script", "model": "ur4"}, "ur4"),
        ("launch", {"program": "cell.script", "options": {"wrong": 1}}, "wrong"),
        ("attach", {"port": 9}, "no control API on 127.0.0.1 port 9"),
        ("fly", {}, "no request 'fly'"),
        ("continue", {}, "no program has been launched"),
        ("setBreakpoints", {"breakpoints": [{"line": 1, "hitCondition": "x"}]}, "'x' is not a number of hits"),
        ("stackTrace", {"threadId": 1}, "no program has been launched"),
    ):
        response = client.answer(command, **arguments)
        assert not response["success"], command
        assert message in response["message"]


def test_wrong_expressions(client, cell):
    client.launch(cell, stopOnEntry=True)
    client.stopped()
    for text in (
        "nothing",
        "1 +",
        "().__class__",
        "[x for x in [1]]",
        "(lambda: 1)()",
        "__import__('os')",
        "10 ** 10 ** 10",
    ):
        response = client.answer("evaluate", expression=text, frameId=client.frame)
        assert not response["success"], text
    response = client.answer("setVariable", variablesReference=1, name="none", value="1")
    assert "not a global variable" in response["message"]
    response = client.answer("setVariable", variablesReference=2, name="robot_mode", value="1")
    assert "cannot be set" in response["message"]
    response = client.answer("variables", variablesReference=77)
    assert "ask for its stack again" in response["message"]


def test_messages_that_are_none_end_the_session(client):
    client.write(b"[1, 2")
    assert "the editor sent no message" in client.until("output")["output"]
    assert client.process.wait(30) == 0


def test_nothing_is_left_when_the_debugger_is_killed(cell):
    client = DebugClient()
    client.launch(cell, stopOnEntry=True)
    client.stopped()
    family = _descendants(client.process.pid)
    assert len(family) >= 2
    client.process.send_signal(signal.SIGKILL)
    client.process.communicate()
    deadline = time.monotonic() + 30
    while any(os.path.exists(f"/proc/{pid}") for pid in family) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in family if os.path.exists(f"/proc/{pid}")]


def _descendants(pid):
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as stat:
                    parent = int(re.sub(r"\(.*\)", "", stat.read()).split()[2])
            except (OSError, ValueError):
                continue
            if parent == pid:
                found += [int(entry), *_descendants(int(entry))]
    return found
