"""A protective stop: how it is reported, what is refused meanwhile, and how the robot recovers."""

import pytest
from waiting import pass_time, wait_until

from client import ScriptFailedError, dashboard
from client.primary import BRAKE_RELEASE, STOP_PROGRAM
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatusBits

pytestmark = pytest.mark.moves

FIELDS = ["timestamp", "robot_mode", "safety_mode", "safety_status_bits"]
UNLOCK_AFTER_S = 5.0  # dashboard manual
STOP = "protective_stop()\nsleep(1)"
STOP_WHILE_MOVING = """def conformance():
  thread stopping():
    sleep(0.3)
    protective_stop()
  end
  run stopping()
  movej({there}, a=0.5, v=0.1)
end"""


def test_protective_stop_and_recovery(running):
    with running.rtde(FIELDS) as rtde, running.dashboard() as client, running.primary() as primary:
        begin = rtde.latest()["timestamp"]
        with pytest.raises(ScriptFailedError, match="PROTECTIVE_STOP"):
            primary.run(primary.core.execute(STOP))
        state = wait_until(rtde, lambda state: state["safety_mode"] == SafetyMode.PROTECTIVE_STOP)
        bits = SafetyStatusBits(state["safety_status_bits"])
        assert SafetyStatusBits.PROTECTIVE_STOPPED in bits
        assert SafetyStatusBits.NORMAL not in bits
        assert state["robot_mode"] == RobotMode.RUNNING  # the arm holds itself with its motors
        assert client.request(dashboard.SAFETY_MODE) is SafetyMode.PROTECTIVE_STOP

        with pytest.raises(RobotRefused, match="wait until 5 s after the stop"):
            client.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        with pytest.raises(RobotRefused, match="clear the stop first"):
            primary.run(primary.core.execute("textmsg(1)"))

        wait_until(rtde, lambda state: state["timestamp"] > begin + UNLOCK_AFTER_S + 1.5, UNLOCK_AFTER_S + 3)
        client.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        state = wait_until(rtde, lambda state: state["safety_mode"] == SafetyMode.NORMAL)
        assert state["safety_status_bits"] & SafetyStatusBits.NORMAL
        client.request(dashboard.CLOSE_SAFETY_POPUP)
        primary.run(primary.core.command(STOP_PROGRAM))
        primary.run(primary.core.command(BRAKE_RELEASE))
        assert primary.run(primary.core.execute("textmsg(1)")).texts == ("1",)


def test_unlocking_when_nothing_is_locked(running):
    with running.dashboard() as client:
        client.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        assert client.request(dashboard.SAFETY_MODE) is SafetyMode.NORMAL


def test_a_stop_ends_a_move_immediately(running):
    """The arm is at rest within a second, long before the move would end."""
    with running.rtde([*FIELDS, "actual_q", "actual_qd"]) as rtde, running.primary() as primary:
        start = list(rtde.latest()["actual_q"])
        there = [*start[:5], start[5] + 0.1]
        text = STOP_WHILE_MOVING.format(there=there)
        with pytest.raises(ScriptFailedError, match="PROTECTIVE_STOP"):
            primary.run(primary.core.execute(text))
        state = wait_until(rtde, lambda state: state["safety_mode"] == SafetyMode.PROTECTIVE_STOP)
        state = wait_until(rtde, lambda state: max(map(abs, state["actual_qd"])) < 0.01, 1.0)
        assert abs(state["actual_q"][5] - start[5]) < 0.09
        pass_time(rtde, UNLOCK_AFTER_S + 1)
        with running.dashboard() as client:
            client.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        wait_until(rtde, lambda state: state["safety_mode"] == SafetyMode.NORMAL)
        primary.run(primary.core.command(STOP_PROGRAM))
        primary.run(primary.core.execute(f"movej({start}, a=0.5, v=0.1)", timeout_s=20))
