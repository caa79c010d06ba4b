"""The log of a pendant: conversion of messages, and updates of one browser."""

import csv
import io
from typing import Any

from client.pendant.events import MAX_SHOWN, EventLog, LogView, as_csv, as_text
from tests.rows import each_row
from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_STARTED,
    ErrorCodeMessage,
    KeyMessage,
    ProgramThreadsMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)


def log_message(log: EventLog, text: str, level: ReportLevel | None = None) -> None:
    log.handle_message(TextMessage(text=text) if level is None else ErrorCodeMessage(code=1, level=level, text=text))


def texts(change: list[Any] | None) -> list[str]:
    assert change is not None
    return [row[-1] for row in change[1]]


@each_row(
    ("message", "severity", "code", "text"),
    [
        (ErrorCodeMessage(code=153, argument=2, level=2), "warning", "C153A2", "deviates from the path: elbow"),
        (ErrorCodeMessage(code=153, argument=2, level=2, text="its own"), "warning", "C153A2", "its own"),
        (ErrorCodeMessage(code=191, argument=3, level=3), "error", "C191A3", "violated: tool speed"),
        (ErrorCodeMessage(code=204, argument=99, level=131), "error", "C204A99", "The path failed its check"),
        (ErrorCodeMessage(code=4711, level=129), "info", "C4711A0", "Error code C4711"),
        (SafetyModeMessage(safety_mode=SafetyMode.PROTECTIVE_STOP), "warning", "", "protective stop"),
        (SafetyModeMessage(safety_mode=SafetyMode.FAULT), "error", "", "fault"),
        (SafetyModeMessage(safety_mode=200), "warning", "", "200"),
        (RuntimeExceptionMessage(line=3, column=7, text="oh"), "error", "", "line 3, column 7: oh"),
        (KeyMessage(title=PROGRAM_STARTED, text="go"), "info", "", "Program go started"),
        (KeyMessage(title="SECONDARY_PROGRAM_EXCEPTION_XXX", text="late"), "error", "", "late"),
    ],
)
def test_messages_have_severity_code_and_text(message: object, severity: str, code: str, text: str):
    log = EventLog()
    log.handle_message(message)
    (event,) = log.events
    assert (event.severity, event.code) == (severity, code)
    assert text in event.text


def test_irrelevant_messages_are_ignored_and_compile_errors_have_no_time():
    log = EventLog()
    log.handle_message(ProgramThreadsMessage(threads=()))
    log.handle_message(object())
    assert log.count == 0
    log.handle_message(RuntimeExceptionMessage(timestamp_us=NO_TIMESTAMP_US, line=1, column=1, text="x"))
    log.handle_message(TextMessage(timestamp_us=2_500_000, text="x"))
    assert [event.uptime_s for event in log.events] == [None, 2.5]


def test_log_is_bounded_and_lists_events_since():
    log = EventLog()
    for number in range(12_000):
        log_message(log, str(number))
    assert (len(log.events), log.count) == (10_000, 12_000)
    assert [event.text for event in log.since(11_998)] == ["11998", "11999"]
    assert len(log.since(0)) == 10_000
    assert log.since(12_000) == []


def test_each_line_is_sent_once():
    log = EventLog()
    view = LogView(log)
    log_message(log, "one")
    assert texts(view.next_update(True)) == ["one"]
    assert view.next_update(False) is None
    log_message(log, "two")
    log_message(log, "three")
    change = view.next_update(False)
    assert change is not None
    assert change[0] is False
    assert texts(change) == ["two", "three"]
    refreshed = view.next_update(True)
    assert refreshed is not None
    assert refreshed[0] is True
    assert texts(refreshed) == ["one", "two", "three"]


def test_flood_is_truncated_to_shown_lines():
    log = EventLog()
    view = LogView(log)
    view.next_update(True)
    for number in range(5_000):
        log_message(log, str(number))
    change = view.next_update(False)
    assert change is not None
    assert (change[0], len(change[1]), texts(change)[-1]) == (True, MAX_SHOWN, "4999")


def test_filters_apply_to_old_and_new_events():
    log = EventLog()
    view = LogView(log)
    log_message(log, "Gripper closed")
    log_message(log, "gripper lost", ReportLevel.FAULT)
    log_message(log, "hot", ReportLevel.WARNING)
    view.words = "GRIPPER"
    assert texts(view.next_update(False)) == ["Gripper closed", "gripper lost"]
    view.severities.discard("info")
    assert texts(view.next_update(False)) == ["gripper lost"]
    view.words = "c1a0 hot"
    assert texts(view.next_update(False)) == ["hot"]
    log_message(log, "cold", ReportLevel.WARNING)
    log_message(log, "hot again", ReportLevel.WARNING)
    assert texts(view.next_update(False)) == ["hot again"]
    assert [event.text for event in view.matching()] == ["hot", "hot again"]


def test_pause_and_clear_affect_only_the_view():
    log = EventLog()
    view = LogView(log)
    log_message(log, "before")
    view.next_update(True)
    view.paused = True
    log_message(log, "meanwhile")
    assert view.next_update(False) is None
    assert view.pending == 1
    view.paused = False
    assert texts(view.next_update(False)) == ["meanwhile"]
    view.clear()
    assert texts(view.next_update(False)) == []
    log_message(log, "after")
    assert texts(view.next_update(False)) == ["after"]
    assert [event.text for event in view.matching()] == ["before", "meanwhile", "after"]


def test_downloads_contain_one_line_per_event():
    log = EventLog()
    log_message(log, 'quoted "text", with\na line', ReportLevel.WARNING)
    (row,) = csv.DictReader(io.StringIO(as_csv(log.events)))
    assert (row["severity"], row["code"], row["text"]) == ("warning", "C1A0", 'quoted "text", with\na line')
    assert row["time"].endswith("+00:00")
    (line,) = as_text(log.events).splitlines()
    assert 'warning controller C1A0     quoted "text", with a line' in line
