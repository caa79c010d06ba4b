"""The facade for plain scripts: the same as the asynchronous one, from a thread of the caller."""

import asyncio
import inspect
import threading
from collections.abc import Iterator

import pytest
from driver_rig import HOME, HOST, driver_options, emulator_thread

from client import AsyncRobot, MotionStoppedError, ProtectiveStopError, Robot, RobotUnreachableError, points
from client.blocking import parts_of
from emulator.app import Emulator

FAST = {"speed_rad_s": 2.0, "acceleration_rad_s2": 5.0}


@pytest.fixture
def emulated() -> Iterator[Emulator]:
    """An emulator in a thread of its own."""
    with emulator_thread("ur5e") as running:
        yield running


@pytest.fixture
def robot(emulated: Emulator) -> Iterator[Robot]:
    with Robot(HOST, **driver_options(emulated)) as robot:
        yield robot


def off(turn):
    return [HOME[0] + turn, *HOME[1:]]


def test_a_lab_script(robot):
    robot.make_ready()
    robot.move_j(off(0.1), **FAST)
    assert robot.q == pytest.approx(off(0.1), abs=1e-6)
    x, y, z, *turn = robot.tcp_pose
    robot.sequence([points.movel([x, y, z + 0.02, *turn], blend_radius_m=0.01), points.movel([x, y, z, *turn])])
    assert robot.tcp_pose == pytest.approx([x, y, z, *turn], abs=1e-4)
    robot.set_digital_out(2, True)
    assert robot.digital_out(2)
    assert not robot.digital_in(2)
    with robot.servo_j() as follow:
        for _ in range(20):
            state = follow(off(0.1))
    assert state.q_rad == pytest.approx(off(0.1), abs=1e-3)
    with robot.freedrive():
        assert not robot.moving
    assert robot.wait_for(lambda state: state.at_rest, 5).at_rest


def test_stop_from_another_thread(robot):
    failures = []

    def move():
        try:
            robot.move_j(off(1.5), speed_rad_s=0.5)
        except MotionStoppedError as error:
            failures.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    robot.wait_for(lambda state: state.q_rad[0] > HOME[0] + 0.05, 10)
    robot.stop()
    thread.join(10)
    assert [failure.operation for failure in failures] == ["move_j"]
    assert robot.state.at_rest
    assert robot.q[0] < HOME[0] + 1.0


def test_a_keyboard_interrupt_stops_the_arm(robot, monkeypatch):
    """As Ctrl-C does it: the wait for the result is left by an exception, the call is cancelled."""

    class Interrupted:
        def __init__(self, future):
            self.future = future

        def result(self):
            robot.wait_for(lambda state: not state.at_rest, 10)
            raise KeyboardInterrupt

        def cancel(self):
            self.future.cancel()

    robot.make_ready()
    submit, moves = asyncio.run_coroutine_threadsafe, []

    def interrupt_the_first(work, loop):
        moves.append(work)
        future = submit(work, loop)
        return Interrupted(future) if len(moves) == 1 else future

    monkeypatch.setattr("client.blocking.asyncio.run_coroutine_threadsafe", interrupt_the_first)
    with pytest.raises(KeyboardInterrupt):
        robot.move_j(off(1.5), speed_rad_s=0.5)
    robot.wait_for(lambda state: state.at_rest, 10)
    assert robot.q[0] < HOME[0] + 1.0


def test_errors_come_through_with_their_cause(robot):
    def freedrive():
        with robot.freedrive():
            robot.programs.send("sec hit():\n  protective_stop()\nend")
            robot.wait_for(lambda state: state.safety_mode == 3, 10)

    with pytest.raises(ProtectiveStopError, match="freedrive"):
        freedrive()
    robot.recover()
    robot.move_j(off(0.1), **FAST)


def test_an_error_inside_a_context_is_the_callers(robot):
    def mistake():
        with robot.servo_j() as follow:
            follow(HOME)
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        mistake()
    robot.move_j(off(0.1), **FAST)


def test_a_condition_that_calls_the_robot_does_not_hang(robot):
    with pytest.raises(RuntimeError, match="wait for itself"):
        robot.wait_for(lambda state: robot.is_steady(), 5)


def test_no_robot_leaves_no_thread_behind():
    ports = {"rtde": 1, "primary": 1, "dashboard": 1}
    with pytest.raises(RobotUnreachableError), Robot(HOST, robot_ports=ports):
        pytest.fail("entered")


def public(kind: type) -> dict[str, object]:
    return {name: value for name, value in inspect.getmembers(kind) if not name.startswith("_")}


def test_both_forms_offer_the_same():
    both = public(AsyncRobot)
    assert both.keys() == public(Robot).keys() - {"call", "inner"} - parts_of(AsyncRobot).keys()
    for name, member in both.items():
        assert inspect.getdoc(public(Robot)[name]) == inspect.getdoc(member), name
        assert not inspect.iscoroutinefunction(public(Robot)[name]), name
