"""A pendant's mover: it moves the arm only while requested, one motion at a time."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable

import pytest

from client import AsyncRobot, MotionError, MotionStoppedError
from client.pendant.jogging import Velocity
from client.pendant.mover import STALE_S, BusyError, Mover
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.errors import RobotRefused
from urproto.modes import ControlMode, RobotMode, RuntimeState
from urproto.robots import load_model

HOST = "127.0.0.1"
START = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
TIMEOUT_S = 20.0
BASE_LEFT = Velocity("joints", (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
UP = Velocity("tool", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
WAITING = "def waiting():\n  while True:\n    sleep(0.1)\n  end\nend"


class Bench:
    """An emulator and a mover for it, with simulated holders of buttons."""

    def __init__(self, robot: Emulator) -> None:
        self.robot = robot
        options = {"robot_ports": robot.ports, "silence_s": 5.0, "frequency_hz": Mover.RATE_HZ}
        self.mover = Mover(lambda: AsyncRobot(HOST, **options))
        self.errors = list[str]()
        self.mover.on_error.append(self.errors.append)

    @property
    def q(self) -> tuple[float, ...]:
        return tuple(self.robot.controller.snapshot.actual_q)

    @property
    def at_rest(self) -> bool:
        return not any(self.robot.controller.snapshot.target_qd)

    @property
    def freedriving(self) -> bool:
        return self.robot.controller.motion.control_mode is ControlMode.TEACH

    @property
    def moving(self) -> bool:
        return not self.at_rest

    async def wait_until(self, condition: Callable[[], object]) -> None:
        """Check a condition in every control period until it holds."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def check(_: object) -> None:
            if condition() and not done.done():
                done.set_result(None)

        unsubscribe = self.robot.controller.subscribe(check)
        try:
            async with timeout(TIMEOUT_S):
                await done
        finally:
            unsubscribe()

    async def hold_until(self, velocity: Velocity, holder: object, condition: Callable[[], object]) -> None:
        """Hold a button until a condition holds, then stop reporting it without releasing it."""

        async def keep_holding() -> None:
            while True:
                self.mover.hold(velocity, holder)
                await asyncio.sleep(0.05)

        holding = asyncio.create_task(keep_holding())
        try:
            await self.wait_until(condition)
        finally:
            holding.cancel()

    async def wait_idle(self) -> None:
        """Wait until no motion is in progress."""
        async with timeout(TIMEOUT_S):
            while self.mover.activity:
                await asyncio.sleep(0.01)


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    controller = ControllerConfig(model=load_model("ur5e"), initial_q=START, running=True)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True)) as robot:
        bench = Bench(robot)
        yield bench
        await bench.mover.close()


async def test_arm_moves_while_button_is_held(bench: Bench) -> None:
    await bench.hold_until(BASE_LEFT, "me", lambda: bench.q[0] > START[0] + 0.1)
    assert bench.mover.activity == "Jogging"
    bench.mover.release("me")
    await bench.wait_until(lambda: bench.at_rest)
    await bench.wait_idle()
    assert bench.q[0] < START[0] + 0.6
    assert bench.q[1:] == pytest.approx(START[1:], abs=1e-3)
    assert bench.errors == []


async def test_arm_stops_without_messages_of_button(bench: Bench) -> None:
    await bench.hold_until(UP, "me", lambda: bench.moving)
    released_s = bench.robot.controller.time_s
    await bench.wait_until(lambda: bench.at_rest)
    assert bench.robot.controller.time_s - released_s < 5 * STALE_S
    await bench.wait_idle()
    assert bench.errors == []


async def test_jog_resumes_after_late_setpoint_while_button_is_held(bench: Bench) -> None:
    hangs = list[bool]()

    def hang_once() -> bool:
        if not hangs and bench.q[0] > START[0] + 0.1:
            hangs.append(True)
            time.sleep(0.25)  # the robot waits for setpoints for 0.2 s, and the mover for a button for 0.4 s
        return bench.q[0] > START[0] + 0.4

    await bench.hold_until(BASE_LEFT, "me", hang_once)
    assert hangs
    bench.mover.release("me")
    await bench.wait_idle()
    assert bench.errors == []


async def test_only_one_holder_may_jog(bench: Bench) -> None:
    await bench.hold_until(BASE_LEFT, "me", lambda: bench.moving)
    with pytest.raises(BusyError, match="Another browser is jogging the arm"):
        bench.mover.hold(UP, "somebody else")
    bench.mover.release("somebody else")
    bench.mover.hold(BASE_LEFT, "me")
    assert bench.mover.activity == "Jogging"
    with pytest.raises(BusyError, match=r"already moved from this pendant \(Jogging\)"):
        await bench.mover.move_j(START)
    bench.mover.release("me")
    await bench.wait_idle()


async def test_jog_switches_between_joint_and_tool_motion(bench: Bench) -> None:
    await bench.hold_until(BASE_LEFT, "me", lambda: bench.moving)
    await bench.hold_until(UP, "me", lambda: bench.robot.controller.snapshot.actual_TCP_speed[2] > 0.05)
    bench.mover.release("me")
    await bench.wait_idle()
    assert bench.errors == []


async def test_move_j_is_exclusive_and_can_be_stopped(bench: Bench) -> None:
    moving = asyncio.create_task(bench.mover.move_j((1.5, *START[1:]), "Moving to X"))
    await bench.wait_until(lambda: bench.moving)
    assert bench.mover.activity == "Moving to X"
    with pytest.raises(BusyError, match="Moving to X"):
        bench.mover.hold(UP, "me")
    with pytest.raises(BusyError, match="Moving to X"):
        await bench.mover.move_j(START)
    await bench.mover.stop()
    with pytest.raises(MotionStoppedError):
        await moving
    assert bench.at_rest
    assert bench.q[0] < 1.4
    await bench.mover.move_j(START, speed_rad_s=2.0, acceleration_rad_s2=5.0)
    assert bench.q == pytest.approx(START, abs=1e-3)


async def test_stop_cancels_move_that_has_not_started(bench: Bench) -> None:
    moving = asyncio.create_task(bench.mover.move_j((1.5, *START[1:])))
    while not bench.mover.activity:
        await asyncio.sleep(0)
    await bench.mover.stop()
    with pytest.raises(MotionStoppedError):
        await moving
    assert bench.q == pytest.approx(START, abs=1e-3)


async def test_other_clients_program_is_not_replaced(bench: Bench) -> None:
    async with AsyncRobot(HOST, robot_ports=bench.robot.ports) as other:
        await other.driver.link.send_script(WAITING)
        await bench.wait_until(lambda: bench.robot.controller.programs.state is RuntimeState.PLAYING)
        with pytest.raises(RobotRefused, match="a program is running"):
            await bench.mover.move_j(START)
        bench.mover.hold(UP, "me")
        await bench.wait_idle()
        bench.mover.hold(UP, "me")  # as a browser reports ten times a second
        assert bench.mover.activity == ""
        assert len(bench.errors) == 1
        assert bench.robot.controller.programs.state is RuntimeState.PLAYING


async def test_freedrive_lasts_until_ended(bench: Bench) -> None:
    freedriving = asyncio.create_task(bench.mover.start_freedrive())
    await bench.wait_until(lambda: bench.freedriving)
    assert bench.mover.freedrive
    bench.mover.end_freedrive()
    await freedriving
    assert not bench.mover.freedrive
    assert not bench.freedriving


async def test_protective_stop_ends_freedrive_with_advice(bench: Bench) -> None:
    freedriving = asyncio.create_task(bench.mover.start_freedrive())
    await bench.wait_until(lambda: bench.freedriving)
    bench.robot.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    with pytest.raises(MotionError, match=r"protective stop.*see Initialize"):
        await freedriving
    assert not bench.mover.freedrive


async def test_release_control_stops_program(bench: Bench) -> None:
    await bench.mover.move_j((START[0] + 0.05, *START[1:]))
    assert bench.mover.has_slider
    await bench.mover.release_control()
    await bench.wait_until(lambda: bench.robot.controller.programs.state is RuntimeState.STOPPED)
    assert not bench.mover.has_slider


async def test_motion_requires_released_brakes(bench: Bench) -> None:
    bench.robot.controller.power_event(PowerEvent.POWER_OFF)
    await bench.wait_until(lambda: bench.robot.controller.snapshot.robot_mode is not RobotMode.RUNNING)
    with pytest.raises(RobotRefused, match="release the brakes"):
        await bench.mover.move_j(START)
