"""The dashboard's answers against manuals, captures and clients, row by row: tests/golden/dashboard.tsv."""

import gzip
import inspect
import re
from dataclasses import replace
from pathlib import Path

import pytest

from emulator.commands import dashboard
from emulator.commands.requests import DashboardLine
from emulator.lifecycle.runstate import StopCause
from emulator.lifecycle.safety import SafetyEvent
from tests.rows import each_row
from urproto.dashboard import COMMANDS, NOT_IN_REMOTE_CONTROL, not_understood
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series

TABLE = Path(__file__).parents[1] / "golden" / "dashboard.tsv"
ROWS = [line.split("\t") for line in TABLE.read_text().splitlines() if not line.startswith("#")]
ORIGINS = {"arm", "e", "cb", "urcl", "3.15.8", "5.11.9", "ur_rtde", "local", "op"}  # as the header of the file explains
SERIES = {"cb3": [Series.CB3], "e": [Series.E], "both": [Series.CB3, Series.E]}
MODELS = {Series.CB3: "ur3", Series.E: "ur3e"}
FIRST = {Series.CB3: PolyscopeVersion(3, 0), Series.E: PolyscopeVersion(5, 0)}
MOVE = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"
INSTALLATION = (
    b'<Installation><TCPSettings activePose="TCP" toolPayload="0.5"><availablePoses>'
    b'<tcp name="TCP" offset="0, 0, 0.2, 0, 0, 0"/></availablePoses></TCPSettings></Installation>'
)
CASES = [(series, *row[1:4]) for row in ROWS for series in SERIES[row[0]]]

CONFIG = {
    "off": {}, "idle": {}, "manual": {}, "remote": {"remote_control": True}, "local": {"enforce_remote_control": True},
}  # fmt: skip
STEPS = {
    "idle": ["power on"],
    "manual": ["set operational mode manual"],
    "popup": ["popup look"],
    "loaded": ["load far.script"],
    "playing": ["load far.script", "play"],
    "paused": ["load far.script", "play", "pause"],
}
EVENTS = {
    "reduced": SafetyEvent.REDUCED,
    "safeguard stop": SafetyEvent.SAFEGUARD_OPEN,
    "robot emergency stop": SafetyEvent.ROBOT_EMERGENCY_STOP,
    "system emergency stop": SafetyEvent.SYSTEM_EMERGENCY_STOP,
    "violation": SafetyEvent.VIOLATION,
    "fault": SafetyEvent.FAULT,
}


def arm_in(make, situation, model, version, programs):
    """A robot in that situation; it is running unless the situation says otherwise."""
    config = CONFIG.get(situation, {"running": True})
    rig = make(model, str(version), programs_dir=programs, **config)
    for line in STEPS.get(situation, []):
        rig.request(line)
    if situation in EVENTS:
        rig.controller.safety_event(EVENTS[situation])
    if situation.endswith("protective stop"):
        rig.controller.protective_stop(StopCause(209, 0, ""))
    rig.seconds(5.1 if situation.startswith("old") else 0.4)
    return rig


def entry(line):
    words = [words for words in dashboard.COMMANDS if f"{line} ".lower().startswith(f"{words} ")]
    return dashboard.COMMANDS[max(words, key=len)] if words else None


@pytest.fixture
def programs(tmp_path):
    (tmp_path / "far.script").write_text(MOVE)
    (tmp_path / "sub").mkdir()
    (tmp_path / "broken.txt").write_text("?")
    (tmp_path / "cell.installation").write_bytes(gzip.compress(INSTALLATION))
    (tmp_path / "bad.installation").write_bytes(b"?")
    return tmp_path


@each_row(("series", "situation", "line", "reply"), CASES)
def test_every_row_in_the_first_and_in_the_newest_version(make, programs, series, situation, line, reply):
    command = entry(line)
    first = FIRST[series]
    if command is not None:
        first = max(first, command.form.available.cb3 if series is Series.CB3 else command.form.available.e)
    setup = [entry(step) for step in STEPS.get(situation, [])]
    first = max(
        [first, *(step.form.available.e for step in setup if step and series is Series.E and step.form.available.e)]
    )
    for version in (first, DEFAULT_VERSION[series]):
        rig = arm_in(make, situation, MODELS[series], version, programs)
        answers = []
        rig.controller.post(DashboardLine(line, restricted=rig.now.local_control), answers.append)
        rig.until(lambda _, answers=answers: bool(answers))
        assert re.fullmatch(reply, answers[0]), (str(version), answers[0])


def test_every_command_of_each_series_has_a_row():
    having = {(series, command.form.words) for series, _, line, _ in CASES if (command := entry(line))}
    commands = {
        (series, command.form.words)
        for series in Series
        for command in dashboard.available_commands(DEFAULT_VERSION[series])
    }
    assert having == commands


def test_every_command_that_needs_remote_control_has_its_refusal():
    refused = {
        entry(line).form.words
        for _, situation, line, reply in CASES
        if situation == "local" and re.fullmatch(reply, NOT_IN_REMOTE_CONTROL)
    }
    assert refused == {command.form.words for command in dashboard.COMMANDS.values() if command.form.remote_only}


def test_every_row_has_an_origin():
    assert {origin for row in ROWS for origin in row[4].split()} == ORIGINS
    assert all(row[4] for row in ROWS)


def test_every_protocol_command_is_carried_out_with_its_confirmation():
    assert dashboard.COMMANDS.keys() == COMMANDS.keys()
    for words, row in dashboard.COMMANDS.items():
        assert row.form is COMMANDS[words]
        assert row.form.takes_argument == (len(inspect.signature(row.function).parameters) > 1), words


def before(version):
    """An older version of the same series, None if there is none."""
    oldest = FIRST[version.series]
    minor = replace(version, minor=version.minor - 1, bugfix=0) if version.bugfix == 0 else oldest
    return max(oldest, minor) if version > oldest else None


@each_row("row", COMMANDS.values(), ids=lambda row: row.words)
def test_older_controllers_do_not_understand_newer_commands(make, row):
    for series, first in ((Series.CB3, row.available.cb3), (Series.E, row.available.e)):
        version = DEFAULT_VERSION[series] if first is None else before(first)
        if version is not None:
            line = f"{row.words} x" if row.takes_argument else row.words
            answer = make(MODELS[series], str(version)).request(line)
            # before 3.2 there was no program with the name "installation ..." either
            assert answer in (not_understood(line), "File not found: installation x"), str(version)


def test_every_confirmation_in_the_table_is_a_real_answer(make, programs):
    """Replies that the client takes for success are prefixes of the success rows of the golden table."""
    confirmed = {
        row.words
        for _, _, line, reply in CASES
        if (command := entry(line)) and (row := command.form).confirmations
        if reply.replace("\\", "").startswith(row.confirmations)
    }
    assert confirmed == {row.words for row in COMMANDS.values() if row.confirmations}
