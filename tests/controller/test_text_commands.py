"""The controller's own text commands on the script ports."""

import pytest

from emulator.commands.text_commands import TEXT_COMMANDS, execute
from urproto.modes import RobotMode, RuntimeState
from urproto.primary.messages import RuntimeExceptionMessage

MOVE = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"


def test_run_from_off_ends_in_running(rig):
    rig.script("set robotmode run")
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING, 1.0)


def test_power_on_and_off(rig):
    rig.script("power on")
    rig.until(lambda s: s.robot_mode is RobotMode.IDLE, 1.0)
    rig.script("power off")
    assert rig.tick().robot_mode is RobotMode.POWER_OFF


def test_stop_program_and_a_new_program_in_one_message(ready):
    ready.script(MOVE)
    ready.seconds(0.3)
    ready.script("stop program")
    ready.script(MOVE.replace("far", "other"))
    ready.until(lambda s: s.program_name == "other" and s.runtime_state is RuntimeState.PLAYING, 0.5)


def test_pause_and_resume_program(ready):
    ready.script(MOVE)
    ready.seconds(0.3)
    ready.script("pause program")
    ready.until(lambda s: s.runtime_state is RuntimeState.PAUSED, 1.0)
    ready.script("resume program")
    ready.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)


@pytest.mark.parametrize("line", ["set speed 0.25", "SET  Speed 0.25", "set speed 0.25 # comment"])
def test_set_speed(rig, line):
    rig.script(line)
    assert rig.tick().target_speed_fraction == 0.25


@pytest.mark.parametrize("line", ["set speed fast", "set sim", "set real", "run program"])
def test_lines_without_effect(ready, line):
    ready.script(MOVE)
    ready.seconds(0.3)
    ready.script(line)
    ready.tick(3)
    assert ready.now.runtime_state is RuntimeState.PLAYING
    assert ready.messages_of(RuntimeExceptionMessage) == []


@pytest.mark.parametrize("line", ["", "power", "power on now", "set", "movej([0,0,0,0,0,0])", "set speed"])
def test_everything_else_is_urscript(rig, line):
    assert not execute(rig.controller, line)


def test_invalid_lines_are_reported_and_have_no_effect(ready):
    ready.script(MOVE)
    ready.seconds(0.3)
    ready.script("blah blah blah")
    ready.tick(3)
    assert ready.now.runtime_state is RuntimeState.PLAYING
    assert len(ready.messages_of(RuntimeExceptionMessage)) == 1


def test_every_text_command_has_help():
    assert all(handler.__doc__ for handler in TEXT_COMMANDS.values())
