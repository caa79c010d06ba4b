"""The blocking shell: the same driver for plain scripts."""

import inspect
from collections.abc import Iterator

import pytest
from driver_rig import CALM_S, HOME, HOST, emulator_thread

from client.driver import BlockingURDriver, URDriver, points
from client.errors import RobotUnreachableError
from emulator.app import Emulator
from urproto.errors import LocalProtocolError
from urproto.external_control import TrajectoryResult

FREE = {"reverse_port": 0, "sender_port": 0, "trajectory_port": 0, "command_port": 0}


@pytest.fixture
def robot() -> Iterator[Emulator]:
    """An emulator in a thread of its own."""
    with emulator_thread("ur5e") as running:
        yield running


def test_a_script_moves_the_arm(robot):
    with BlockingURDriver(HOST, robot_ports=robot.ports, outputs=("actual_q",), silence_s=5.0, **FREE) as driver:
        driver.start_program()
        target = (HOME[0] + 0.1, *HOME[1:])
        assert driver.execute([points.movej(target, v=2, a=5)]) is TrajectoryResult.SUCCESS
        assert driver.next_state()["actual_q"] == pytest.approx(target, abs=1e-6)
        for _ in range(50):
            driver.servoj(driver.next_state()["actual_q"], CALM_S)
        with pytest.raises(LocalProtocolError):
            driver.servoj([0.0])
        driver.idle()
        assert driver.program_running
        assert not driver.protective_stopped
    with pytest.raises(RuntimeError, match="with statement"):
        driver.servoj(HOME)


def test_no_robot_leaves_no_thread_behind():
    ports = {"rtde": 1, "primary": 1, "dashboard": 1}
    with pytest.raises(RobotUnreachableError), BlockingURDriver(HOST, robot_ports=ports, **FREE):
        pytest.fail("entered")


def public(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if not name.startswith("_")}


def test_every_method_has_its_blocking_form():
    assert public(URDriver) <= public(BlockingURDriver)
    for name in public(URDriver) & public(BlockingURDriver):
        assert not inspect.iscoroutinefunction(getattr(BlockingURDriver, name)), name
        assert getattr(BlockingURDriver, name).__doc__ == getattr(URDriver, name).__doc__
