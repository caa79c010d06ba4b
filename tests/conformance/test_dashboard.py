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
    with robot.dashboard() as client:
        assert client.request(dashboard.POLYSCOPE_VERSION) == robot.version
        assert client.request(has(dashboard.SERIAL_NUMBER)).isdigit()
        model = client.request(has(dashboard.ROBOT_MODEL))
        assert model.startswith("UR")
        assert not model.endswith("e")


def test_the_short_version_agrees(robot, has):
    with robot.dashboard() as client:
        short = client.request(has(dashboard.VERSION))
    assert (short.major, short.minor, short.bugfix) == (robot.version.major, robot.version.minor, robot.version.bugfix)


def test_modes_agree_with_rtde(robot):
    with robot.dashboard() as client, robot.rtde(["robot_mode", "safety_mode"]) as rtde:
        state = rtde.latest()
        assert client.request(dashboard.ROBOT_MODE) == state["robot_mode"]
        assert client.request(dashboard.SAFETY_MODE) == state["safety_mode"]


def test_safety_status_without_a_stop(robot, has):
    with robot.dashboard() as client:
        if client.request(dashboard.SAFETY_MODE) is SafetyMode.NORMAL:
            assert client.request(has(dashboard.SAFETY_STATUS)) is SafetyStatus.NORMAL


def test_program_queries_agree(robot):
    with robot.dashboard() as client:
        _, name = client.request(dashboard.PROGRAM_STATE)
        loaded = client.request(dashboard.LOADED_PROGRAM)
        if not client.request(dashboard.IS_RUNNING):
            assert (loaded or "").endswith(name or "")


def test_commands_are_case_insensitive(robot):
    with robot.dashboard() as client:
        assert client.request(dashboard.command("ROBOTMODE")).startswith("Robotmode: ")
        assert client.request(dashboard.command("programstate")).split(" ")[0] in ("STOPPED", "PLAYING", "PAUSED")


def test_unknown_commands(robot):
    with robot.dashboard() as client:
        assert client.request(dashboard.command("dance the tango")).lower().startswith("could not understand")


def test_commands_of_the_other_series_are_not_understood(robot):
    other = dashboard.IS_IN_REMOTE_CONTROL if robot.version.series is Series.CB3 else dashboard.USER_ROLE
    with robot.dashboard() as client:
        assert client.request(dashboard.command(other.line)).lower().startswith("could not understand")
        with pytest.raises(RobotRefused, match="does not know it"):
            client.request(other)


def test_two_concurrent_clients(robot):
    with robot.dashboard() as first, robot.dashboard() as second:
        assert first.request(dashboard.ROBOT_MODE) is second.request(dashboard.ROBOT_MODE)


def test_quit_ends_the_connection(robot):
    with robot.dashboard() as client:
        client.request(dashboard.QUIT)
        with pytest.raises(ConnectionLostError):
            client.request(dashboard.ROBOT_MODE)


@pytest.mark.moves
def test_popups_and_log(robot):
    with robot.dashboard() as client:
        client.request(dashboard.popup("conformance test, closes at once"))
        client.request(dashboard.CLOSE_POPUP)
        client.request(dashboard.CLOSE_SAFETY_POPUP)
        client.request(dashboard.add_to_log("conformance test"))
        with pytest.raises(RobotRefused):
            client.request(dashboard.add_to_log(""))


@pytest.mark.moves
def test_user_roles(robot, has):
    has(dashboard.USER_ROLE)
    with robot.dashboard() as client:
        before = client.request(dashboard.USER_ROLE)
        for role in (UserRole.OPERATOR, UserRole.LOCKED, before):
            client.request(dashboard.set_user_role(role))
            assert client.request(dashboard.USER_ROLE) is role


@pytest.mark.moves
def test_operational_modes(robot, has):
    has(dashboard.OPERATIONAL_MODE)
    with robot.dashboard() as client:
        for mode in (OperationalMode.MANUAL, OperationalMode.AUTOMATIC):
            client.request(dashboard.set_operational_mode(mode))
            assert client.request(dashboard.OPERATIONAL_MODE) is mode
        client.request(dashboard.CLEAR_OPERATIONAL_MODE)
        assert client.request(dashboard.OPERATIONAL_MODE) is not OperationalMode.MANUAL


@pytest.mark.moves
def test_power_cycle(robot):
    with robot.dashboard() as client, robot.rtde(["timestamp", "robot_mode"]) as rtde:

        def becomes(mode: RobotMode) -> None:
            wait_until(rtde, lambda state: state["robot_mode"] == mode, BOOT_S)
            assert client.request(dashboard.ROBOT_MODE) is mode

        client.request(dashboard.POWER_OFF)
        becomes(RobotMode.POWER_OFF)
        client.request(dashboard.POWER_ON)
        becomes(RobotMode.IDLE)
        client.request(dashboard.BRAKE_RELEASE)
        becomes(RobotMode.RUNNING)
