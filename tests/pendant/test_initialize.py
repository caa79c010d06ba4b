"""Initialize without a browser: how far the arm is, why it stands, what leads on."""

from types import SimpleNamespace
from typing import Any

import pytest

from client.pendant.screens.initialize import may_switch_on, stage
from client.pendant.screens.initialize_safety import advice, cause, reset_text, way_out
from client.pendant.stops import Stops
from urproto.modes import ReportLevel, RobotMode, SafetyMode
from urproto.primary.messages import ErrorCodeMessage


def station(robot: RobotMode = RobotMode.RUNNING, safety: SafetyMode = SafetyMode.NORMAL, **also: Any) -> Any:
    core = SimpleNamespace(errors=also.pop("errors", []))
    return SimpleNamespace(
        connected=also.pop("connected", True), robot_mode=robot, safety_mode=safety, stops=Stops(), core=core
    )


def stopped(at_s: float, now_s: float, *reports: ErrorCodeMessage) -> Any:
    robot = station(safety=SafetyMode.PROTECTIVE_STOP)
    robot.stops.see({"timestamp": at_s, "safety_mode": SafetyMode.PROTECTIVE_STOP})
    for report in reports:
        robot.stops.hear(report)
    robot.stops.see({"timestamp": now_s, "safety_mode": SafetyMode.PROTECTIVE_STOP})
    return robot


def test_the_stages_go_one_way() -> None:
    way = (RobotMode.POWER_OFF, RobotMode.BOOTING, RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)
    assert [stage(mode) for mode in way] == [0, 1, 1, 2, 3]
    assert stage(RobotMode.NO_CONTROLLER) == -1


@pytest.mark.parametrize(
    ("robot", "may"),
    [
        (station(RobotMode.POWER_OFF), True),
        (station(RobotMode.POWER_OFF, SafetyMode.PROTECTIVE_STOP), True),
        (station(RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP), False),
        (station(RobotMode.POWER_OFF, SafetyMode.FAULT), False),
        (station(RobotMode.DISCONNECTED), False),
        (station(RobotMode.POWER_OFF, connected=False), False),
    ],
)
def test_what_keeps_the_arm_off(robot, may) -> None:
    assert may_switch_on(robot) is may


def test_a_protective_stop_tells_its_cause_and_counts_down() -> None:
    report = ErrorCodeMessage(timestamp_us=100_100_000, code=153, argument=2, level=ReportLevel.WARNING)
    robot = stopped(100.0, 101.4, report)
    assert cause(robot).startswith("C153A2: ")
    assert (way_out(robot), reset_text(robot)) == ("unlock", "Unlock in 4 s")
    assert reset_text(stopped(100.0, 105.0)) == "Unlock protective stop"


def test_a_violation_tells_the_last_grave_report() -> None:
    errors = [
        ErrorCodeMessage(code=191, argument=3, level=ReportLevel.VIOLATION, text="too fast"),
        ErrorCodeMessage(code=101, level=ReportLevel.INFO),
    ]
    robot = station(RobotMode.POWER_OFF, SafetyMode.VIOLATION, errors=errors)
    assert cause(robot) == "C191A3: too fast"
    assert (way_out(robot), reset_text(robot)) == ("restart", "Restart safety")


def test_nothing_stopped_nothing_told() -> None:
    robot = station(errors=[ErrorCodeMessage(code=191, level=ReportLevel.VIOLATION)])
    assert (cause(robot), way_out(robot)) == ("", "")


@pytest.mark.parametrize(
    "mode", [mode for mode in SafetyMode if "STOP" in mode.name or mode.name in ("FAULT", "VIOLATION")]
)
def test_every_stop_has_an_advice(mode) -> None:
    assert advice(mode)
