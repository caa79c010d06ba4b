"""Dashboard manuals of both series: answers and effects of each command."""

import pytest
from waiting import wait_until

from client import ConnectionLostError, dashboard
from urproto.dashboard import OperationalMode, UserRole
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import Series

BOOT_S = 60.0


def test_version_serial_number_and_model(robot, has):
    with robot.dashboard() as asked:
        assert asked.ask(dashboard.POLYSCOPE_VERSION) == robot.version
        assert asked.ask(has(dashboard.SERIAL_NUMBER)).isdigit()
        model = asked.ask(has(dashboard.ROBOT_MODEL))
        assert model.startswith("UR")
        assert not model.endswith("e")


def test_the_short_version_agrees(robot, has):
    with robot.dashboard() as asked:
        short = asked.ask(has(dashboard.VERSION))
    assert (short.major, short.minor, short.bugfix) == (robot.version.major, robot.version.minor, robot.version.bugfix)


def test_modes_agree_with_rtde(robot):
    with robot.dashboard() as asked, robot.rtde(["robot_mode", "safety_mode"]) as rtde:
        state = rtde.latest()
        assert asked.ask(dashboard.ROBOT_MODE) == state["robot_mode"]
        assert asked.ask(dashboard.SAFETY_MODE) == state["safety_mode"]


def test_safety_status_without_a_stop(robot, has):
    with robot.dashboard() as asked:
        if asked.ask(dashboard.SAFETY_MODE) is SafetyMode.NORMAL:
            assert asked.ask(has(dashboard.SAFETY_STATUS)) is SafetyStatus.NORMAL


def test_program_queries_agree(robot):
    with robot.dashboard() as asked:
        _, name = asked.ask(dashboard.PROGRAM_STATE)
        loaded = asked.ask(dashboard.LOADED_PROGRAM)
        if not asked.ask(dashboard.IS_RUNNING):
            assert (loaded or "").endswith(name or "")


def test_commands_are_case_insensitive(robot):
    with robot.dashboard() as asked:
        assert asked.ask(dashboard.command("ROBOTMODE")).startswith("Robotmode: ")
        assert asked.ask(dashboard.command("programstate")).split(" ")[0] in ("STOPPED", "PLAYING", "PAUSED")


def test_unknown_commands(robot):
    with robot.dashboard() as asked:
        assert asked.ask(dashboard.command("dance the tango")).lower().startswith("could not understand")


def test_commands_of_the_other_series_are_not_understood(robot):
    other = dashboard.IS_IN_REMOTE_CONTROL if robot.version.series is Series.CB3 else dashboard.USER_ROLE
    with robot.dashboard() as asked:
        assert asked.ask(dashboard.command(other.line)).lower().startswith("could not understand")
        with pytest.raises(RobotRefused, match="does not know it"):
            asked.ask(other)


def test_two_concurrent_clients(robot):
    with robot.dashboard() as first, robot.dashboard() as second:
        assert first.ask(dashboard.ROBOT_MODE) is second.ask(dashboard.ROBOT_MODE)


def test_quit_ends_the_connection(robot):
    with robot.dashboard() as asked:
        asked.ask(dashboard.QUIT)
        with pytest.raises(ConnectionLostError):
            asked.ask(dashboard.ROBOT_MODE)


@pytest.mark.moves
def test_popups_and_log(robot):
    with robot.dashboard() as asked:
        asked.ask(dashboard.popup("conformance test, closes at once"))
        asked.ask(dashboard.CLOSE_POPUP)
        asked.ask(dashboard.CLOSE_SAFETY_POPUP)
        asked.ask(dashboard.add_to_log("conformance test"))
        with pytest.raises(RobotRefused):
            asked.ask(dashboard.add_to_log(""))


@pytest.mark.moves
def test_user_roles(robot, has):
    has(dashboard.USER_ROLE)
    with robot.dashboard() as asked:
        before = asked.ask(dashboard.USER_ROLE)
        for role in (UserRole.OPERATOR, UserRole.LOCKED, before):
            asked.ask(dashboard.set_user_role(role))
            assert asked.ask(dashboard.USER_ROLE) is role


@pytest.mark.moves
def test_operational_modes(robot, has):
    has(dashboard.OPERATIONAL_MODE)
    with robot.dashboard() as asked:
        for mode in (OperationalMode.MANUAL, OperationalMode.AUTOMATIC):
            asked.ask(dashboard.set_operational_mode(mode))
            assert asked.ask(dashboard.OPERATIONAL_MODE) is mode
        asked.ask(dashboard.CLEAR_OPERATIONAL_MODE)
        assert asked.ask(dashboard.OPERATIONAL_MODE) is not OperationalMode.MANUAL


@pytest.mark.moves
def test_power_cycle(robot):
    with robot.dashboard() as asked, robot.rtde(["timestamp", "robot_mode"]) as rtde:

        def becomes(mode: RobotMode) -> None:
            wait_until(rtde, lambda state: state["robot_mode"] == mode, BOOT_S)
            assert asked.ask(dashboard.ROBOT_MODE) is mode

        asked.ask(dashboard.POWER_OFF)
        becomes(RobotMode.POWER_OFF)
        asked.ask(dashboard.POWER_ON)
        becomes(RobotMode.IDLE)
        asked.ask(dashboard.BRAKE_RELEASE)
        becomes(RobotMode.RUNNING)
