"""The debugger on a running emulator: programs pause at breakpoints while time and other clients go on."""

import time

import pytest
from dap_client import CELL, DebugClient

from emulator.control.debugging import LiveDebuggee
from emulator.virtual import virtual_robot
from urproto.testing.process import EmulatorProcess

FILE = f"# a comment before the program\n\n{CELL}"


@pytest.fixture(scope="module")
def emulated():
    with EmulatorProcess(["--model", "ur5e", "--running", "--no-pendant"]) as process:
        yield process


@pytest.fixture
def cell(tmp_path):
    file = tmp_path / "cell.script"
    file.write_text(FILE)
    return file


def attach(client, emulated, file, breakpoints=(), functions=()):
    client.request("initialize", adapterID="test")
    client.request("attach", host=emulated.host, program=str(file))
    client.request("setBreakpoints", source={"path": str(file)}, breakpoints=list(breakpoints))
    client.request("setFunctionBreakpoints", breakpoints=[{"name": name} for name in functions])
    client.request("configurationDone")


def state(emulated, name):
    return emulated.control.state([name])[name]


def until_over(emulated):
    deadline = time.monotonic() + 30
    while state(emulated, "runtime_state") != "STOPPED":
        assert time.monotonic() < deadline, emulated.control.log(5)
        time.sleep(0.02)


def test_a_program_that_a_client_sends_stops_and_goes_on(client, emulated, cell):
    attach(client, emulated, cell, [{"line": 8, "condition": "x == 1"}])
    assert emulated.control.send_script(FILE)
    assert client.stopped() == ("breakpoint", [("move", 8), ("main", 18)])
    assert state(emulated, "runtime_state") in ("PAUSING", "PAUSED")
    assert client.variables(client.frame) == {"x": "1", "y": "2"}
    assert client.variables()["count"] == "1"
    assert client.variables(2)["robot_mode"] == "RUNNING"
    before = state(emulated, "timestamp")
    assert client.request("evaluate", expression="x + count", frameId=client.frame)["result"] == "2"
    assert [thread["name"] for thread in client.request("threads")["threads"]] == ["cell", "blink"]
    assert client.go("next") == ("step", [("main", 19)])
    assert state(emulated, "timestamp") > before
    assert client.go("next") == ("step", [("main", 20)])
    assert "time cannot be turned back" in client.answer("stepBack", threadId=client.thread)["message"]
    assert client.request("setVariable", variablesReference=1, name="count", value="7") == {"value": "7"}
    client.send("continue", threadId=client.thread)
    until_over(emulated)
    assert emulated.control.state(["actual_q"])["actual_q"][0] == pytest.approx(0.1, abs=1e-3)
    for _ in range(2):  # what was said while the program ended
        client.request("threads")
    assert "z 0\nz 2\n" in client.said


def test_threads_wait_together_and_the_pendant_may_resume(client, emulated, cell):
    attach(client, emulated, cell, functions=["move"])
    assert emulated.control.send_script(FILE)
    assert client.stopped()[0] == "function breakpoint"
    client.request("setFunctionBreakpoints", breakpoints=[])
    emulated.control.dashboard("play")
    until_over(emulated)


def test_a_program_of_another_text_shows_its_own(client, emulated, cell):
    """Lines of the editor's file mean nothing there; functions do."""
    attach(client, emulated, cell, [{"line": 5}], ["other"])
    assert emulated.control.send_script("def prog():\n  def other():\n    sleep(0.1)\n  end\n  other()\nend\n")
    assert client.stopped() == ("function breakpoint", [("other", 3), ("main", 5)])
    frame = client.request("stackTrace", threadId=client.thread)["stackFrames"][0]
    text = client.request("source", sourceReference=frame["source"]["sourceReference"])["content"]
    assert text.splitlines()[2].strip() == "sleep(0.1)"


def test_a_stop_between_two_calls_is_told_by_the_next_one():
    robot = virtual_robot("ur5e", running=True)
    debuggee = LiveDebuggee(robot.controller, "", 0)
    debuggee.set_breakpoints([], ["wait"], [])
    robot.controller.programs.submit("def prog():\n  def wait():\n    sleep(0.1)\n  end\n  wait()\nend\n")
    robot.step(100)
    with pytest.raises(StopIteration) as told:
        next(debuggee.go("continue", 10))
    assert told.value.value.reason == "function breakpoint"
    assert robot.controller.programs.paused
    for _ in debuggee.go("continue", 100):
        robot.step(1)
    assert not robot.controller.programs.busy


def test_ending_the_session_lets_the_program_go_on(emulated, cell):
    first = DebugClient()
    attach(first, emulated, cell, [{"line": 20}])
    assert emulated.control.send_script(FILE)
    assert first.stopped()[0] == "breakpoint"
    first.close()
    until_over(emulated)


def test_a_running_program_and_a_missing_emulator_are_explained(client, emulated, cell):
    client.request("initialize", adapterID="test")
    refused = client.answer("attach", host=emulated.host, port=9, program=str(cell))
    assert "no control API on" in refused["message"]
    assert emulated.control.send_script("def busy():\n  sleep(30)\nend\n")
    client.request("attach", host=emulated.host)
    deadline = time.monotonic() + 10
    while "cannot be stopped" not in client.said and time.monotonic() < deadline:
        client.request("threads")
    assert "a program is running already" in client.said
    emulated.control.dashboard("stop")
