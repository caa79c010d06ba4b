"""Programs sent as text: results, errors with their line, small slow moves about the present pose."""

import pytest
from waiting import wait_until

from client import ScriptFailedError
from client.primary import STOP_PROGRAM
from urproto.modes import RuntimeState

pytestmark = pytest.mark.moves

TURN_RAD = 0.05  # of the last joint only
SPEED_RAD_S = 0.2
ARRIVED_RAD = 1e-3  # a robot at rest is closer to its target
POSE_TOLERANCE = 1e-3  # m and rad: an arm's calibration is the same on both sides


@pytest.fixture
def primary(running):
    with running.primary() as client:
        yield client
        client.run(client.core.command(STOP_PROGRAM))


def test_text_messages_of_a_program(primary):
    result = primary.run(primary.core.execute('textmsg("half of 3 is ", 3 / 2)', "conformance"))
    assert result.name == "conformance"
    assert result.texts == ("half of 3 is 1.5",)


def test_a_program_with_functions_and_loops(primary):
    text = """
def conformance():
  def add(a, b):
    return a + b
  end
  sum = 0
  i = 1
  while i <= 10:
    sum = add(sum, i)
    i = i + 1
  end
  textmsg(sum)
end
"""
    assert primary.run(primary.core.execute(text)).texts == ("55",)


@pytest.mark.parametrize("text", ["a = 1\nb = nonesuch(a)", "def conformance():\n  b = nonesuch(1)\nend"])
def test_an_unknown_name(primary, text):
    with pytest.raises(ScriptFailedError, match="nonesuch") as failed:
        primary.run(primary.core.execute(text))
    assert failed.value.line == 2


def test_a_program_that_does_not_parse(primary):
    with pytest.raises(ScriptFailedError) as failed:
        primary.run(primary.core.execute("a = 1\nb = (a\nc = 3"))
    assert failed.value.line in (2, 3)


def test_after_an_error_the_next_program_runs(primary):
    with pytest.raises(ScriptFailedError):
        primary.run(primary.core.execute("nonesuch()"))
    assert primary.run(primary.core.execute("textmsg(2)")).texts == ("2",)


def test_stopping_a_program(running, primary):
    with running.rtde(["timestamp", "runtime_state"]) as rtde:
        name = primary.run(primary.core.run_script("def endless():\n  while True:\n    sync()\n  end\nend"))
        assert name == "endless"
        wait_until(rtde, lambda state: state["runtime_state"] == RuntimeState.PLAYING)
        primary.run(primary.core.command(STOP_PROGRAM))
        wait_until(rtde, lambda state: state["runtime_state"] == RuntimeState.STOPPED)


def test_a_program_exceeding_its_timeout(primary):
    with pytest.raises(ScriptFailedError, match=r"still running after 0\.5 s"):
        primary.run(primary.core.execute("while True:\n  sync()\nend", timeout_s=0.5))


def test_a_secondary_program_does_not_disturb_the_main_one(running, primary):
    with running.rtde(["timestamp", "runtime_state", "output_int_register_28"]) as rtde:
        primary.run(primary.core.run_script("def endless():\n  while True:\n    sync()\n  end\nend"))
        for value in (6, 0):
            primary.run(primary.core.send_script(f"sec beside():\n  write_output_integer_register(28, {value})\nend"))
            state = wait_until(rtde, lambda state: state["output_int_register_28"] == value)  # noqa: B023
            assert state["runtime_state"] == RuntimeState.PLAYING


@pytest.mark.parametrize("turn", [TURN_RAD, -TURN_RAD])
def test_a_joint_move_there_and_back(running, primary, turn):
    with running.rtde(["timestamp", "actual_q", "target_qd"]) as rtde:
        start = list(rtde.latest()["actual_q"])
        there = [*start[:5], start[5] + turn]
        primary.run(primary.core.execute(f"movej({there}, a=1.0, v={SPEED_RAD_S})", timeout_s=20))
        speeds = []
        now = newest(running)
        while rtde.core.state["timestamp"] < now:
            speeds.append(rtde.receive()["target_qd"][5])
        assert rtde.latest()["actual_q"] == pytest.approx(there, abs=ARRIVED_RAD)
        assert max(map(abs, speeds)) == pytest.approx(SPEED_RAD_S, rel=0.05)
        primary.run(primary.core.execute(f"movej({start}, a=1.0, v={SPEED_RAD_S})", timeout_s=20))
        assert rtde.latest()["actual_q"] == pytest.approx(start, abs=ARRIVED_RAD)


def newest(robot):
    with robot.rtde(["timestamp"]) as rtde:
        return rtde.receive()["timestamp"]


def test_servoj_follows_a_ramp(running, primary):
    with running.rtde(["timestamp", "actual_q"]) as rtde:
        start = list(rtde.latest()["actual_q"])
        text = f"""
q = {start}
goal = {start[5] + TURN_RAD}
while q[5] < goal:
  q[5] = q[5] + 0.1 * get_steptime()
  servoj(q, t=get_steptime(), lookahead_time=0.1, gain=300)
end
i = 0
while i < 0.5 / get_steptime():
  servoj(q, t=get_steptime(), lookahead_time=0.1, gain=300)
  i = i + 1
end
stopj(2)
"""
        primary.run(primary.core.execute(text, timeout_s=20))
        assert rtde.latest()["actual_q"][5] == pytest.approx(start[5] + TURN_RAD, abs=2 * ARRIVED_RAD)
        primary.run(primary.core.execute(f"movej({start}, a=1.0, v={SPEED_RAD_S})", timeout_s=20))


def test_forward_kinematics_agrees_with_the_pose_of_the_state(running, primary):
    result = primary.run(primary.core.execute("textmsg(get_actual_tcp_pose())\ntextmsg(get_forward_kin())"))
    with running.rtde(["actual_TCP_pose"]) as rtde:
        pose = rtde.latest()["actual_TCP_pose"]
    for text in result.texts:
        assert [float(number) for number in text.strip("p[]").split(",")] == pytest.approx(pose, abs=POSE_TOLERANCE)
