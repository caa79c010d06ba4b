"""Program files and their dashboard commands; the given file has to run until it is stopped."""

import pytest

from client import dashboard
from urproto.dashboard import ProgramState
from urproto.errors import RobotRefused

pytestmark = pytest.mark.moves


@pytest.fixture
def loaded(running):
    """A dashboard of a running robot that has loaded the program."""
    if running.program is None:
        pytest.skip("no program to play: set one with --robot-program")
    with running.dashboard() as asked:
        asked.ask(dashboard.load(running.program))
        yield asked
        asked.ask(dashboard.STOP)


def name_of(robot):
    return robot.program.rpartition("/")[2]


def test_loading(loaded, running):
    assert loaded.ask(dashboard.LOADED_PROGRAM).endswith(name_of(running))
    assert loaded.ask(dashboard.PROGRAM_STATE) == (ProgramState.STOPPED, name_of(running))
    assert loaded.ask(dashboard.IS_RUNNING) is False
    assert loaded.ask(dashboard.IS_PROGRAM_SAVED)[0] is True


def test_the_answer_to_load_is_the_path(loaded, running):
    assert loaded.ask(dashboard.load(running.program)).endswith(name_of(running))


def test_play_pause_play_stop(loaded):
    def state():
        return loaded.ask(dashboard.PROGRAM_STATE)[0], loaded.ask(dashboard.IS_RUNNING)

    loaded.ask(dashboard.PLAY)
    assert state() == (ProgramState.PLAYING, True)
    loaded.ask(dashboard.PAUSE)
    assert state()[0] is ProgramState.PAUSED
    loaded.ask(dashboard.PLAY)
    assert state() == (ProgramState.PLAYING, True)
    loaded.ask(dashboard.STOP)
    assert state() == (ProgramState.STOPPED, False)


def test_missing_files(running):
    with running.dashboard() as asked:
        with pytest.raises(RobotRefused, match="below the controller's programs folder"):
            asked.ask(dashboard.load("no such program.urp"))
        with pytest.raises(RobotRefused):
            asked.ask(dashboard.load_installation("no such installation.installation"))


def test_pause_when_nothing_runs(running):
    with running.dashboard() as asked, pytest.raises(RobotRefused, match="no running program"):
        asked.ask(dashboard.PAUSE)


def test_stop_when_nothing_runs(running):
    with running.dashboard() as asked:
        asked.ask(dashboard.STOP)
