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
    with running.dashboard() as client:
        client.request(dashboard.load(running.program))
        yield client
        client.request(dashboard.STOP)


def name_of(robot):
    return robot.program.rpartition("/")[2]


def test_loading(loaded, running):
    assert loaded.request(dashboard.LOADED_PROGRAM).endswith(name_of(running))
    assert loaded.request(dashboard.PROGRAM_STATE) == (ProgramState.STOPPED, name_of(running))
    assert loaded.request(dashboard.IS_RUNNING) is False
    assert loaded.request(dashboard.IS_PROGRAM_SAVED)[0] is True


def test_the_answer_to_load_is_the_path(loaded, running):
    assert loaded.request(dashboard.load(running.program)).endswith(name_of(running))


def test_play_pause_play_stop(loaded):
    def state():
        return loaded.request(dashboard.PROGRAM_STATE)[0], loaded.request(dashboard.IS_RUNNING)

    loaded.request(dashboard.PLAY)
    assert state() == (ProgramState.PLAYING, True)
    loaded.request(dashboard.PAUSE)
    assert state()[0] is ProgramState.PAUSED
    loaded.request(dashboard.PLAY)
    assert state() == (ProgramState.PLAYING, True)
    loaded.request(dashboard.STOP)
    assert state() == (ProgramState.STOPPED, False)


def test_missing_files(running):
    with running.dashboard() as client:
        with pytest.raises(RobotRefused, match="below the controller's programs folder"):
            client.request(dashboard.load("no such program.urp"))
        with pytest.raises(RobotRefused):
            client.request(dashboard.load_installation("no such installation.installation"))


def test_pause_when_nothing_runs(running):
    with running.dashboard() as client, pytest.raises(RobotRefused, match="no running program"):
        client.request(dashboard.PAUSE)


def test_stop_when_nothing_runs(running):
    with running.dashboard() as client:
        client.request(dashboard.STOP)
