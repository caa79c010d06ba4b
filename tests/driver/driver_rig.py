"""Helpers of the driver's tests."""

import asyncio
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from client import AsyncRobot
from client.driver import URDriver
from emulator.app import Emulator
from emulator.clock import RealClock
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.modes import RuntimeState
from urproto.robotiq import GripperModel
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

HOST = "127.0.0.1"
SCALED = "scaled_joint_trajectory_controller"
HOME = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
PATIENCE_S = 60.0  # of our time: a busy machine's
CALM_S = 0.2  # the longest real-time timeout: a busy test machine is not the subject


_STANDSTILL_S = 0.05  # a process that has not come to its next control period for longer was not let


class PatientClock(RealClock):
    """Makes up for no period that comes late: while this process stands still, so does the robot.

    Else the robot, woken together with its driver, would first pass the time in which the driver said nothing.
    """

    def __init__(self, period_s: float, speed: float) -> None:
        self._passed_s = 0.0
        self._ticked_s = time.monotonic()
        super().__init__(period_s, speed)

    def start(self, tick: Callable[[], object]) -> None:
        def note_and_tick() -> None:
            self._passed_s, self._ticked_s = self.monotonic(), time.monotonic()
            tick()

        self._ticked_s = time.monotonic()
        super().start(note_and_tick)

    def monotonic(self) -> float:
        """Seconds in which this process was not kept from running: for a driver in it, whose clock this is."""
        return self._passed_s + min(time.monotonic() - self._ticked_s, _STANDSTILL_S)

    def _fell_behind(self, behind_ns: int, now_ns: int) -> None:
        self._deadline_ns = now_ns


def emulator(
    model: str = "ur5e",
    version: str | None = None,
    programs_dir: Path | None = None,
    speed: float = 1.0,
    *,
    dynamic: bool = False,
    gripper: GripperModel | None = None,
) -> Emulator:
    """One with its brakes released, not entered yet. Torques move it only when it is dynamic, as in URSim."""
    chosen = PolyscopeVersion.parse(version) if version else None
    controller = ControllerConfig(
        model=load_model(model),
        version=chosen,
        initial_q=HOME,
        running=True,
        programs_dir=programs_dir,
        dynamic=dynamic,
        gripper=gripper,
    )
    config = EmulatorConfig(controller=controller, ephemeral_ports=True, speed=speed)
    return Emulator(config, PatientClock(controller.model.series.period_s, speed))


@contextmanager
def emulator_thread(model: str = "ur5e") -> Iterator[Emulator]:
    """One that runs in a thread of its own."""
    loop, running = asyncio.new_event_loop(), emulator(model)
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    asyncio.run_coroutine_threadsafe(running.__aenter__(), loop).result(PATIENCE_S)
    try:
        yield running
    finally:
        asyncio.run_coroutine_threadsafe(running.__aexit__(None, None, None), loop).result(PATIENCE_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def driver_options(robot: Emulator, **options: Any) -> dict[str, Any]:
    """Of a driver for this robot, on free ports and patient."""
    ports = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
    patience = {"silence_s": 5.0, "max_age_s": 5.0, "start_timeout_s": PATIENCE_S}
    return {"robot_ports": robot.ports} | patience | ports | options


class Pair:
    """A driver and the robot it drives, seen from inside."""

    def __init__(self, robot: Emulator, **options: Any) -> None:
        self.robot = robot
        self.driver = URDriver(HOST, **driver_options(robot, **options))

    @property
    def snapshot(self) -> Any:
        return self.robot.controller.snapshot

    @property
    def q(self) -> tuple[float, ...]:
        return tuple(self.snapshot.actual_q)

    @property
    def at_rest(self) -> bool:
        return not any(self.snapshot.target_qd)

    @property
    def program_ended(self) -> bool:
        return self.robot.controller.programs.state is RuntimeState.STOPPED

    @property
    def log(self) -> list[str]:
        return list(self.robot.controller.messages.history)

    def distance(self, q: tuple[float, ...] = HOME) -> float:
        """Of the farthest joint [rad]."""
        return max(abs(a - b) for a, b in zip(self.q, q, strict=True))

    async def until(self, condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
        """Look at every control period until it holds."""
        met: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def look(_: object) -> None:
            if condition() and not met.done():
                met.set_result(None)

        unsubscribe = self.robot.controller.subscribe(look)
        try:
            async with timeout(timeout_s):
                await met
        except TimeoutError:
            raise AssertionError(f"not within {timeout_s} s; the log says {self.log[-10:]}") from None
        finally:
            unsubscribe()

    async def periods(self, count: int) -> None:
        """Let control periods pass."""
        last = self.snapshot.step + count
        await self.until(lambda: self.snapshot.step >= last)

    async def setpoints(self, seconds: float, send: Callable[[float], None]) -> None:
        """Call `send` with the robot's time since the beginning, once a control period."""
        period, begin = self.robot.controller.period_s, self.snapshot.step
        while (elapsed := (self.snapshot.step - begin) * period) < seconds:
            send(elapsed)
            await self.periods(1)


class Lab(Pair):
    """The facade over a driver, and its robot seen from inside."""

    def __init__(self, robot: Emulator, **options: Any) -> None:
        self.robot = robot
        self.arm = AsyncRobot(HOST, **driver_options(robot, **options))
        self.driver = self.arm.driver


def moved(*offsets: float) -> tuple[float, ...]:
    """Joint angles so far from HOME."""
    return tuple(q + offset for q, offset in zip(HOME, offsets, strict=True))


_GOALS = """
publisher_joint_trajectory_controller:
  ros__parameters:
    controller_name: {controller}
    wait_sec_between_publish: 1
    goal_names: [there, back]
    there: {{positions: {there}}}
    back: {back}
    check_starting_point: true
    starting_point_limits: {{shoulder_pan_joint: [{low}, {high}]}}
"""


def goals_file(
    folder: Path, there: tuple[float, ...], base: tuple[float, float] = (HOME[0] - 0.1, HOME[0] + 0.1)
) -> Path:
    """A file of two goals: there, and back to HOME. base: between which angles the base may be at the start [rad]."""
    file = folder / "goals.yaml"
    low, high = base
    file.write_text(_GOALS.format(controller=SCALED, there=list(there), back=list(HOME), low=low, high=high))
    return file


def swing(t: float, radius: float = 0.2, period_s: float = 2.0) -> tuple[float, ...]:
    """Joint angles of a smooth to and fro that begins and ends at rest in HOME."""
    offset = radius * (1 - math.cos(2 * math.pi * t / period_s)) / 2
    return tuple(q + offset for q in HOME)
