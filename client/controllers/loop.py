"""The control loop: a controller manager that is updated with each state of a robot.

async with URDriver(host, outputs=RTDE_OUTPUTS) as driver:
    await driver.start_program()
    async with ControlLoop(driver) as loop:
        loop.manager.activate("scaled_joint_trajectory_controller")
        result = await loop.follow("scaled_joint_trajectory_controller", trajectory)
"""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any, Final

from client.controllers.calls import Call
from client.controllers.configuration import ControllersFile, usual_controllers
from client.controllers.goals import FollowJointTrajectory, GoalHandle, JointTrajectory, Result
from client.controllers.manager import ControllerManager
from client.controllers.ur_hardware import URHardware
from client.controllers.ur_states import RTDE_OUTPUTS
from client.driver import URDriver
from client.errors import ControllerError, NoAnswerError
from client.rtde import ReceivedState
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES

_FIRST_STATE_S: Final = 5.0  # guess: a robot that sends states at all does so within this
_REST_S: Final = 3.0  # guess: a ramp to rest takes less than one second
_AT_REST_RAD_S: Final = 0.005  # guess: above the noise at rest

_logger = logging.getLogger(__name__)


class ControlLoop:
    """Runs the controllers of a robot through its driver; use it with ``async with``.

    driver: a connected driver, with `RTDE_OUTPUTS` among its outputs. manager: loads, activates and switches
    controllers. prefix: prefix of the names of joints and interfaces. The loop runs at the rate of the robot's states,
    and in the robot's time. States that arrive together, for example after this machine was busy, make one cycle.
    States older than ``max_age_s`` make none.
    """

    def __init__(self, driver: URDriver, file: ControllersFile | None = None, *, prefix: str = "") -> None:
        self.driver = driver
        self._file = usual_controllers(prefix) if file is None else file
        self.prefix = prefix
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest: ReceivedState | None = None
        self._old_since_s: float | None = None  # since when states have been too old
        self._last_s: float | None = None
        self._cycled = asyncio.Event()
        self._manager: ControllerManager | None = None

    @property
    def manager(self) -> ControllerManager:
        """The controller manager. Raises RuntimeError outside the context."""
        if self._manager is None:
            raise RuntimeError("the control loop is not running: use it in an async with statement")
        return self._manager

    async def __aenter__(self) -> Self:
        if missing := [name for name in RTDE_OUTPUTS if name not in self.driver.state]:
            raise ControllerError("control loop", f"the driver does not receive {missing[0]}: give it RTDE_OUTPUTS")
        hardware = URHardware(self.driver, self.driver.version, self._spawn, prefix=self.prefix)
        rate_hz = self.driver.config.frequency_hz or float(self.driver.version.series.frequency_hz)
        self._manager = ControllerManager(hardware, self._file, rate_hz, self.prefix)
        self._subscribe()
        try:
            await self._first_cycle()
        except BaseException:
            self._unsubscribe()
            raise
        return self

    async def _first_cycle(self) -> None:
        try:
            async with timeout(_FIRST_STATE_S):
                await self._cycled.wait()
        except TimeoutError:
            config = self.driver.config
            port = config.robot_ports["rtde"]
            raise NoAnswerError(config.host, port, _FIRST_STATE_S, "states that a control loop can use") from None

    def _subscribe(self) -> None:
        self.driver.link.on_state.append(self._on_state)
        self.driver.link.on_silence.append(self._on_silence)

    def _unsubscribe(self) -> None:
        self.driver.link.on_state.remove(self._on_state)
        self.driver.link.on_silence.remove(self._on_silence)

    def _on_silence(self) -> None:
        """End all motions and requests: without states there are no more cycles that would end them."""
        self.manager.fall_silent("the robot sends nothing: check the network, then activate again")

    async def __aexit__(self, *_: object) -> None:
        """Deactivate all controllers, which stops the arm."""
        self._unsubscribe()
        manager = self.manager
        try:
            manager.switch(deactivate=[controller.name for controller in manager.active()])
        finally:
            self._manager = None
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)

    async def follow(self, name: str, goal: FollowJointTrajectory | JointTrajectory) -> Result:
        """Send a goal to a trajectory controller and wait for its end; it is canceled if the caller is cancelled."""
        controller = self.manager.controller(name)
        handle: GoalHandle = controller.send_goal(goal)
        try:
            return await self.result(handle)
        except BaseException:
            if controller.goal is handle:
                controller.cancel()
            raise

    async def result(self, handle: GoalHandle) -> Result:
        """Wait for the end of a goal."""
        if handle.result is None:
            await _called(handle.on_end)
        assert handle.result is not None
        return handle.result

    async def answer(self, call: Call) -> None:
        """Wait for the answer to a request to a controller. Raises ControllerError if it failed."""
        if call.success is None:
            await _called(call.on_end)
        if not call.success:
            raise ControllerError("controller", call.message)

    async def cycles(self, count: int = 1) -> None:
        """Wait for ``count`` cycles."""
        for _ in range(count):
            await self._cycled.wait()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to wrist 3, with the prefix."""
        return tuple(self.prefix + joint for joint in JOINT_NAMES)

    @property
    def at_rest(self) -> bool:
        """True if the arm is at rest, by its measured joint speeds."""
        return bool(max(map(abs, self.driver.state["actual_qd"])) < _AT_REST_RAD_S)

    async def rest(self, timeout_s: float = _REST_S) -> None:
        """Wait until the arm is at rest, at most ``timeout_s`` [s] of the robot's time."""
        begin_s = self.manager.time_s
        while self.manager.time_s < begin_s + timeout_s:
            await self.cycles()
            if self.at_rest:
                return

    def _spawn(self, work: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _on_state(self, state: ReceivedState) -> None:
        first, self._newest = self._newest is None, state
        if first:
            asyncio.get_running_loop().call_soon(self._cycle)

    def _is_young(self, state: ReceivedState) -> bool:
        """Whether controllers may act on a state. If states stay too old, motions end, as when the robot is silent."""
        if (age_s := state.age_s) <= self.driver.link.feed.max_age_s:
            self._old_since_s = None
            return True
        now_s = asyncio.get_running_loop().time()
        if self._old_since_s is None:
            self._old_since_s = now_s
            _logger.warning("the robot's states may be %.2f s old: controllers wait for younger ones", age_s)
        elif now_s - self._old_since_s > self.driver.config.silence_s:
            self.manager.stop_motion(
                f"the robot's states may be {age_s:.2f} s old: check the network, then activate again"
            )
        return False

    def _cycle(self) -> None:
        state, self._newest = self._newest, None
        if state is None or self._manager is None or not self._is_young(state):
            return
        time_s = state["timestamp"]
        period_s = 0.0 if self._last_s is None else max(time_s - self._last_s, 0.0)  # a robot may start again
        if not self._manager.cycle(state, time_s, period_s):
            return
        self._last_s = time_s
        cycled, self._cycled = self._cycled, asyncio.Event()
        cycled.set()


async def _called(callbacks: list[Callable[[Any], object]]) -> None:
    """Wait until these callbacks are called."""
    called = asyncio.Event()
    callbacks.append(lambda _: called.set())
    await called.wait()
