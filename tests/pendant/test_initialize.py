"""Initialize without a browser: cause of a stop, text of the recovery button, state of the safeguard."""

from types import SimpleNamespace
from typing import Any

from client.pendant.dialogues import Stops
from client.pendant.screens.initialize import recovery_text, safeguard_text, stop_cause
from client.pendant.situation import RobotStatus, situation
from tests.rows import each_row
from urproto.modes import ReportLevel, RobotMode, SafetyMode, SafetyStatusBits
from urproto.primary.messages import ErrorCodeMessage


def station(robot: RobotMode = RobotMode.RUNNING, safety: SafetyMode = SafetyMode.NORMAL, **also: Any) -> Any:
    core = SimpleNamespace(errors=also.pop("errors", []))
    connected, is_open = also.pop("connected", True), also.pop("safeguard_open", None)
    return SimpleNamespace(
        connected=connected,
        safety_mode=safety,
        situation=situation(RobotStatus(connected, robot, safety, safeguard_open=is_open)),
        safeguard_open=is_open,
        values={"safety_status_bits": also.pop("bits", 0)},
        stops=Stops(),
        core=core,
    )


def stopped_station(at_s: float, now_s: float, *reports: ErrorCodeMessage) -> Any:
    robot = station(safety=SafetyMode.PROTECTIVE_STOP)
    robot.stops.update({"timestamp": at_s, "safety_mode": SafetyMode.PROTECTIVE_STOP})
    for report in reports:
        robot.stops.handle_message(report)
    robot.stops.update({"timestamp": now_s, "safety_mode": SafetyMode.PROTECTIVE_STOP})
    return robot


def test_protective_stop_shows_cause_and_countdown() -> None:
    report = ErrorCodeMessage(timestamp_us=100_100_000, code=153, argument=2, level=ReportLevel.WARNING)
    robot = stopped_station(100.0, 101.4, report)
    assert stop_cause(robot).startswith("C153A2: ")
    assert recovery_text(robot) == "Unlock in 4 s"
    assert recovery_text(stopped_station(100.0, 105.0)) == "Unlock protective stop"


def test_violation_shows_last_serious_report() -> None:
    errors = [
        ErrorCodeMessage(code=191, argument=3, level=ReportLevel.VIOLATION, text="too fast"),
        ErrorCodeMessage(code=101, level=ReportLevel.INFO),
    ]
    robot = station(RobotMode.POWER_OFF, SafetyMode.VIOLATION, errors=errors)
    assert stop_cause(robot) == "C191A3: too fast"
    assert recovery_text(robot) == "Restart safety"


def test_no_cause_without_stop() -> None:
    robot = station(errors=[ErrorCodeMessage(code=191, level=ReportLevel.VIOLATION)])
    assert (stop_cause(robot), recovery_text(robot)) == ("", "")


STOP = SafetyStatusBits.SAFEGUARD_STOPPED


@each_row(
    ("safety", "bits", "is_open", "text"),
    [
        (SafetyMode.NORMAL, 0, False, "Closed"),
        (SafetyMode.SAFEGUARD_STOP, STOP, True, "Open"),
        (SafetyMode.SAFEGUARD_STOP, STOP, False, "Closed, not reset"),
        (SafetyMode.PROTECTIVE_STOP, SafetyStatusBits.PROTECTIVE_STOPPED, True, "Open"),
        (SafetyMode.SAFEGUARD_STOP, STOP, None, "Open or not reset"),  # of a real robot
        (SafetyMode.NORMAL, 0, None, "Closed"),
    ],
)
def test_safeguard_text_matches_known_state(safety, bits, is_open, text) -> None:
    assert safeguard_text(station(safety=safety, bits=bits, safeguard_open=is_open)) == text


def test_safeguard_of_disconnected_robot_is_unknown() -> None:
    assert safeguard_text(station(connected=False, bits=STOP)) == "–"
