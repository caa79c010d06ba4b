"""Moves the arm for a pendant: while a button is held, to a target, or by freedrive.

The driver's control program carries out the motion. It is on the robot only while it is needed, because the robot runs
one program at a time: the first motion starts it, and some seconds without motion end it. It does not replace another
client's program.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, Final

from client.calibration import geometry_of, model_of
from client.driver.link import MOVABLE
from client.errors import (
    ClientError,
    LateSetpointError,
    MotionError,
    MotionStoppedError,
    ProgramEndedError,
    SafetyStopError,
)
from client.pendant.jogging import Bounds, Ramp, Velocity
from client.robot import AsyncRobot
from urproto.errors import RobotRefused, URError
from urproto.modes import RobotMode, RuntimeState, mode_name

if TYPE_CHECKING:
    from client.planning import Plan

STALE_S: Final = 0.4
"""A button without a message for this long is no longer held."""

_IDLE_S: Final = 10.0  # then the control program ends
_STOP_TIMEOUT_S: Final = 0.5  # guess: a program that has ended is reported as running for no longer than this
_JOGGING: Final = "Jogging"
_FREEDRIVE: Final = "Freedrive"
_OTHER_BROWSER: Final = "Another browser is jogging the arm: wait until it stops, or press Stop."


class BusyError(ClientError):
    """The arm is already moved from this pendant, perhaps by another browser; the text says how."""


class Mover:
    """Moves the arm, one motion at a time for all browsers. The methods that wait raise the robot's errors.

    activity: the present motion as a text, "" without one. slowed: why a jog is too slow.
    stop_count: number of requests, by anyone, to stop a motion. on_error: called with the reason why a jog ended.
    holder: identifies the page that holds a button, and that has to release it.
    """

    RATE_HZ: ClassVar[float] = 50.0

    def __init__(self, open_robot: Callable[[], AsyncRobot]) -> None:
        self._open_robot = open_robot
        self._robot: AsyncRobot | None = None
        self._connecting = asyncio.Lock()
        self._held: Velocity | None = None
        self._held_at = 0.0
        self._holder: object = None
        self._failed_holder: object = None  # the page that still holds the button of a failed jog
        self._jog: asyncio.Task[None] | None = None
        self._idle_timer: asyncio.TimerHandle | None = None
        self._release_task: asyncio.Task[None] | None = None
        self._freedrive_end: asyncio.Event | None = None
        self.stop_count = 0
        self._releasing = False
        self.activity = ""
        self.slowed = ""
        self.on_error: list[Callable[[str], None]] = []

    @property
    def freedrive(self) -> bool:
        return self._freedrive_end is not None

    @property
    def in_control(self) -> bool:
        """Whether the robot runs the control program of this mover, or is about to."""
        return (
            bool(self.activity) or self._releasing or (self._robot is not None and self._robot.driver.program_running)
        )

    @property
    def has_slider(self) -> bool:
        """Whether only this connection may move the speed slider now."""
        return self._robot is not None

    async def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider while the control program is connected."""
        assert self._robot is not None
        await self._robot.set_speed_slider(fraction)

    # jogging

    def hold(self, velocity: Velocity, holder: object) -> None:
        """Move at this velocity until ``release``, or until this has not been called again for 0.4 s.

        Raises BusyError while something else moves the arm.
        """
        if self._failed_holder is holder:
            return
        if self.activity not in ("", _JOGGING) or self._holder not in (None, holder):
            other = self._holder not in (None, holder)
            raise BusyError(_OTHER_BROWSER) if other else self._busy()
        self._held, self._held_at, self._holder = velocity, asyncio.get_running_loop().time(), holder
        if self._jog is None:
            self.activity = _JOGGING
            self._jog = asyncio.create_task(self._run_jog())

    def release(self, holder: object) -> None:
        """Come to rest, unless another page holds a button now."""
        if self._failed_holder is holder:
            self._failed_holder = None
        if self._holder is holder:
            self._held = None

    async def _run_jog(self) -> None:
        try:
            while (held := self._held) is not None:
                try:
                    await self._jog_while_held(held)
                except LateSetpointError:
                    pass  # this machine was too slow, so the arm has stopped; it continues if the button is still held
                except ProgramEndedError:
                    if self._robot is None or not self._robot.driver.loss_reason:
                        raise
                    # this machine was even slower, so the program ended: it is started again
        except (URError, OSError) as error:
            self._failed_holder = self._holder
            await self._release_quietly()
            if not isinstance(error, MotionStoppedError):
                self._report_error(str(_user_error(error, _JOGGING)))
        finally:
            self._held = self._holder = self._jog = None
            self.activity = self.slowed = ""
            self._schedule_release()

    async def _jog_while_held(self, held: Velocity) -> None:
        robot = await self._ready_robot()
        ramp = Ramp(held.space, _bounds(robot))
        state = robot.state
        async with robot.velocity_j() if held.space == "joints" else robot.velocity_l() as send_speeds:
            while (target := self._target_speeds(held.space)) is not None or not ramp.at_rest:
                speeds = ramp.next(target, state.q_rad, state.pose_base_tcp, 1.0 / self.RATE_HZ)
                self.slowed = ramp.slowed
                state = await send_speeds(speeds)
        self.slowed = ""

    def _target_speeds(self, space: str) -> tuple[float, ...] | None:
        held = self._held
        if held is None or held.space != space:
            return None
        if asyncio.get_running_loop().time() - self._held_at > STALE_S:
            self._held = None
            return None
        return held.values

    def _report_error(self, text: str) -> None:
        for callback in self.on_error:
            callback(text)

    # motions that end by themselves

    async def move_j(self, q_rad: Sequence[float], activity: str = "Moving", **options: Any) -> None:
        """Move to joint angles (6,)."""
        await self._run_motion(activity, lambda robot: robot.move_j(q_rad, **options))

    async def move_l(self, pose_base_tcp: Sequence[float], activity: str = "Moving", **options: Any) -> None:
        """Move to a pose (6,) in a straight line."""
        await self._run_motion(activity, lambda robot: robot.move_l(pose_base_tcp, **options))

    async def move_to_pose(self, pose_base_tcp: Sequence[float], activity: str = "Moving", **options: Any) -> None:
        """Move to a pose (6,), linearly in joint space."""
        await self._run_motion(activity, lambda robot: robot.move_j(pose_base_tcp=pose_base_tcp, **options))

    async def execute(self, plan: "Plan", activity: str = "Moving as planned") -> None:
        """Execute a plan. Raises PlanningError if the arm is not at its start."""
        await self._run_motion(activity, lambda robot: robot.planning.execute(plan))

    async def start_freedrive(self) -> None:
        """Enable freedrive; returns when it has ended, by ``end_freedrive`` or otherwise."""

        async def hold_freedrive(robot: AsyncRobot) -> None:
            async with robot.freedrive():
                while not freedrive_end.is_set() and _is_controllable(robot):
                    await asyncio.sleep(1.0 / self.RATE_HZ)

        self._require_idle()
        freedrive_end = self._freedrive_end = asyncio.Event()
        try:
            await self._run_motion(_FREEDRIVE, hold_freedrive)
        finally:
            self._freedrive_end = None

    def end_freedrive(self) -> None:
        """End freedrive: the arm holds its position."""
        if self._freedrive_end is not None:
            self._freedrive_end.set()

    async def stop(self) -> None:
        """Stop the present motion; its caller gets MotionStoppedError."""
        self.stop_count += 1
        self._held = None
        self.end_freedrive()
        if self._robot is not None and self._robot.moving:
            await self._robot.stop()

    async def _run_motion(self, activity: str, motion: Callable[[AsyncRobot], Awaitable[None]]) -> None:
        self._require_idle()
        stop_count, self.activity = self.stop_count, activity
        try:
            robot = await self._ready_robot()
            if self.stop_count != stop_count:
                raise MotionStoppedError(activity, "it was stopped")
            await motion(robot)
        except BaseException as error:
            if self._robot is not None and not self._robot.driver.program_running:
                await self._release_quietly()
            raise _user_error(error, activity) from None
        finally:
            self.activity = ""
            self._schedule_release()

    def _require_idle(self) -> None:
        if self.activity:
            raise self._busy()

    def _busy(self) -> BusyError:
        return BusyError(f"The arm is already moved from this pendant ({self.activity}): press Stop first.")

    # the control program

    async def _ready_robot(self) -> AsyncRobot:
        self._cancel_idle_timer()
        async with self._connecting:
            if self._robot is None:
                robot = self._open_robot()
                await robot.__aenter__()
                self._robot = robot
        state = self._robot.state
        if state.robot_mode is not RobotMode.RUNNING:  # it may have changed since the page allowed this
            raise RobotRefused(
                "motion", f"the robot mode is {mode_name(RobotMode, state.robot_mode)}", "release the brakes first"
            )
        if not self._robot.driver.program_running:
            await self._require_no_program(self._robot)
        await self._robot.make_ready()
        return self._robot

    async def _require_no_program(self, robot: AsyncRobot) -> None:
        try:
            await robot.wait_for(lambda state: state.runtime_state == RuntimeState.STOPPED, _STOP_TIMEOUT_S)
        except TimeoutError:
            raise RobotRefused("motion", "a program is running", "stop it first") from None

    def _schedule_release(self) -> None:
        self._cancel_idle_timer()
        if self._robot is not None:
            self._idle_timer = asyncio.get_running_loop().call_later(_IDLE_S, self._release_when_idle)

    def _cancel_idle_timer(self) -> None:
        if self._idle_timer is not None:
            self._idle_timer.cancel()
            self._idle_timer = None

    def _release_when_idle(self) -> None:
        self._release_task = asyncio.create_task(self._release_quietly())

    async def release_control(self) -> None:
        """End the control program, so that another one can run. Raises BusyError while it moves the arm."""
        self._require_idle()
        await self._release_quietly()

    async def _release_quietly(self) -> None:
        self._cancel_idle_timer()
        async with self._connecting:
            robot, self._robot = self._robot, None
            if robot is None:
                return
            self._releasing = True
            try:
                with suppress(URError, OSError):
                    await robot.driver.stop_program()
                with suppress(URError, OSError):
                    await robot.__aexit__(None, None, None)
            finally:
                self._releasing = False

    async def close(self) -> None:
        with suppress(URError, OSError):
            await self.stop()
        await self._release_quietly()


def _bounds(robot: AsyncRobot) -> Bounds:
    """The limits that the robot reports, infinite if it reports none."""
    link = robot.driver.link
    arm = link.configuration
    if arm is None:
        return Bounds((-inf,) * 6, (inf,) * 6, (inf,) * 6)
    model = model_of(arm)
    q_min, q_max = (arm.q_min, arm.q_max) if model is None else model.position_limits
    return Bounds(q_min, q_max, arm.qd_max, geometry_of(arm, link.calibration))


def _user_error(error: BaseException, activity: str) -> BaseException:
    """Replace advice for programmers in errors by advice for users of a pendant."""
    if isinstance(error, ProgramEndedError):
        return MotionError(activity, f"the control program has ended: {error.why}")
    if isinstance(error, SafetyStopError):
        stop = error.mode.name.replace("_", " ").lower()
        return MotionError(activity, f"{stop}, {error.cause or 'the robot gives no reason'}: see Initialize")
    return error


def _is_controllable(robot: AsyncRobot) -> bool:
    return robot.driver.program_running and robot.driver.link.safety_mode in MOVABLE
