"""Local and remote control of an e-Series arm, when it is enforced."""

import pytest

from emulator.commands.dashboard import COMMANDS, available_commands
from emulator.commands.requests import DashboardLine, RefusedScript
from emulator.config import ConfigError, check_enforced_remote_control
from tests.rows import each_row
from urproto.dashboard import NOT_IN_REMOTE_CONTROL, not_understood
from urproto.modes import RobotMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

# commands that the dashboard manual of the e-Series (2022) marks as remote control only, and three more
REMOTE_ONLY = {
    "load", "play", "stop", "pause", "power on", "power off", "brake release", "unlock protective stop",
    "close safety popup", "load installation", "restart safety",
    "shutdown", "set operational mode", "clear operational mode",
}  # fmt: skip
EXAMPLES = {words: f"{words} x" if COMMANDS[words].form.takes_argument else words for words in REMOTE_ONLY}


def request_restricted(rig, line):
    answers = []
    rig.controller.post(DashboardLine(line, restricted=True), answers.append)
    rig.until(lambda _: bool(answers))
    return answers[0]


@each_row("words", sorted(REMOTE_ONLY))
def test_commands_over_a_local_connection_are_refused_and_change_nothing(make, words):
    rig = make("ur5e", enforce_remote_control=True)
    assert request_restricted(rig, EXAMPLES[words]) == NOT_IN_REMOTE_CONTROL
    rig.seconds(0.5)
    assert rig.now.robot_mode is RobotMode.POWER_OFF
    assert not rig.controller.shutdown_requested
    assert rig.controller.operational_mode == "NONE"


def test_other_commands_are_answered_in_local_control(make):
    rig = make("ur5e", enforce_remote_control=True)
    for command in available_commands(rig.controller.version):
        if command.form.words not in REMOTE_ONLY:
            line = f"{command.form.words} x" if command.form.takes_argument else command.form.words
            answer = request_restricted(rig, line)
            assert answer != NOT_IN_REMOTE_CONTROL
            assert answer != not_understood(line)


@each_row(
    ("config", "local"),
    [
        ({}, False),
        ({"remote_control": True}, False),
        ({"enforce_remote_control": True}, True),
        ({"enforce_remote_control": True, "remote_control": True}, False),
    ],
)
def test_local_control_by_configuration(make, config, local):
    rig = make("ur5e", **config)
    assert rig.tick().local_control is local
    assert rig.request("is in remote control") == str(config.get("remote_control", False)).lower()


def test_only_the_pendant_switches_remote_control(make):
    rig = make("ur5e", enforce_remote_control=True)
    assert rig.tick().local_control
    rig.controller.remote_control = True
    assert not rig.tick().local_control
    assert rig.request("is in remote control") == "true"


def test_cb3_has_no_local_control(make):
    rig = make("ur3", enforce_remote_control=True)
    assert not rig.tick().local_control
    with pytest.raises(ConfigError, match="without remote control"):
        check_enforced_remote_control(True, load_model("ur3"))
    assert check_enforced_remote_control(True, load_model("ur3e"))
    assert not check_enforced_remote_control(False, load_model("ur3"))


def test_a_refused_script_is_reported_as_c210_and_does_nothing(make):
    rig = make("ur5e")
    rig.controller.post(RefusedScript("power on"))
    rig.tick()
    (message,) = rig.messages_of(ErrorCodeMessage)
    assert (message.code, message.argument) == (210, 0)
    assert "read-only" in message.text
    rig.seconds(0.5)
    assert rig.now.robot_mode is RobotMode.POWER_OFF


def test_remote_only_commands_match_the_manual():
    words = {command.form.words for command in available_commands(PolyscopeVersion(5, 22)) if command.form.remote_only}
    assert words == REMOTE_ONLY
