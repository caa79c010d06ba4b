"""Protective stops."""

import pytest

from client.pendant.dialogues import Stops
from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import ErrorCodeMessage


def state(timestamp: float, mode: SafetyMode = SafetyMode.PROTECTIVE_STOP) -> dict[str, object]:
    return {"timestamp": timestamp, "safety_mode": int(mode)}


def report(code: int, at_s: float, level: ReportLevel = ReportLevel.WARNING) -> ErrorCodeMessage:
    return ErrorCodeMessage(timestamp_us=round(at_s * 1e6), code=code, level=level)


def test_unlock_is_possible_after_five_seconds_of_robot_time():
    stops = Stops()
    stops.update(state(100.0, SafetyMode.NORMAL))
    assert (stops.current, stops.unlock_in_s) == (None, 0.0)
    stops.update(state(100.1))
    assert stops.unlock_in_s == pytest.approx(5.0)
    stops.update(state(103.1))
    assert stops.unlock_in_s == pytest.approx(2.0)
    stops.update(state(109.0))
    assert stops.unlock_in_s == 0.0
    stops.update(state(109.1, SafetyMode.NORMAL))
    assert stops.current is None


@pytest.mark.parametrize("first", ["report", "state"])
def test_simultaneous_report_is_the_cause(first: str):
    stops = Stops()
    stops.handle_message(report(100, 3.0, ReportLevel.INFO))
    stops.handle_message(report(171, 40.0))
    if first == "state":
        stops.update(state(100.1))
    stops.handle_message(report(153, 100.09))
    stops.update(state(100.1))
    stops.handle_message(report(204, 100.2))
    assert stops.current is not None
    assert stops.current.cause == report(153, 100.09)


def test_old_and_informational_reports_are_no_cause():
    stops = Stops()
    stops.handle_message(report(153, 90.0))
    stops.handle_message(report(100, 100.1, ReportLevel.INFO))
    stops.update(state(100.1))
    assert stops.current is not None
    assert stops.current.cause is None


def test_hidden_stop_stays_hidden_until_next_one():
    stops = Stops()
    stops.update(state(1.0))
    stops.hide()
    stops.update(state(2.0))
    assert stops.shown is None
    assert stops.unlock_in_s == pytest.approx(4.0)
    stops.update(state(3.0, SafetyMode.NORMAL))
    stops.update(state(4.0))
    assert stops.shown is not None


def test_controller_restart_starts_new_stop():
    stops = Stops()
    stops.update(state(1000.0))
    stops.update(state(2.0))
    assert stops.unlock_in_s == pytest.approx(5.0)
