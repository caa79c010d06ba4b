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
from client.driver.robot import MOVABLE
from client.errors import (
    LateSetpointError,
    MotionError,
    MotionStoppedError,
    ProgramEndedError,
    SafetyStopError,
)
from client.pendant.jogging import Bounds, Ramp, Velocity
from client.robot import AsyncRobot
from urproto.errors import RobotRefused, URError
from urproto.modes import RobotMode, RuntimeState

if TYPE_CHECKING:
    from client.planning import Plan

STALE_S: Final = 0.4
"""A button that has not been heard of for so long is no longer held."""

_IDLE_S: Final = 10.0  # then the control program ends
_ENDING_S: Final = 0.5  # guess: a program that has ended is said to run for no longer
_JOGGING: Final = "Jogging"
_FREEDRIVE: Final = "Freedrive"


class Mover:
    """Moves the arm, one motion at a time for all browsers. The methods that wait raise the robot's errors.

    doing: the present motion, as a text for people; empty without one. slowed: why a jog is slower than requested.
    stops: number of requests, by anyone, to stop a motion. on_error: called with the reason why a jog ended. holder:
    identifies the page that holds a button, and that has to release it.
    """

    RATE_HZ: ClassVar[float] = 50.0

    def __init__(self, open_robot: Callable[[], AsyncRobot]) -> None:
        self._open_robot = open_robot
        self._robot: AsyncRobot | None = None
        self._connecting = asyncio.Lock()
        self._held: Velocity | None = None
        self._held_at = 0.0
        self._holder: object = None
        self._failed: object = None  # still holds the button of a jog that failed
        self._jog: asyncio.Task[None] | None = None
        self._idle: asyncio.TimerHandle | None = None
        self._ending: asyncio.Task[None] | None = None
        self._hand: asyncio.Event | None = None
        self.stops = 0
        self._leaving = False
        self.doing = ""
        self.slowed = ""
        self.on_error: list[Callable[[str], None]] = []

    @property
    def freedrive(self) -> bool:
        """The arm can be moved by hand, or is about to be."""
        return self._hand is not None

    @property
    def in_charge(self) -> bool:
        """The program on the robot is the one of this mover, or is about to be."""
        return bool(self.doing) or self._leaving or (self._robot is not None and self._robot.driver.program_running)

    @property
    def has_slider(self) -> bool:
        """Only this connection may move the speed slider now."""
        return self._robot is not None

    async def set_speed_slider(self, fraction: float) -> None:
        """While there is a control program."""
        assert self._robot is not None
        await self._robot.set_speed_slider(fraction)

    # jogging

    def hold(self, velocity: Velocity, holder: object) -> None:
        """Move so until ``release``, or until this has not been said again for 0.4 s.

        Raises RobotRefused while something else moves the arm.
        """
        if self._failed is holder:
            return
        if self.doing not in ("", _JOGGING) or self._holder not in (None, holder):
            raise self._busy("jogging")
        self._held, self._held_at, self._holder = velocity, asyncio.get_running_loop().time(), holder
        if self._jog is None:
            self.doing = _JOGGING
            self._jog = asyncio.create_task(self._jogging())

    def release(self, holder: object) -> None:
        """Come to rest, unless somebody else holds a button now."""
        if self._failed is holder:
            self._failed = None
        if self._holder is holder:
            self._held = None

    async def _jogging(self) -> None:
        try:
            while (held := self._held) is not None:
                try:
                    await self._jog_while_held(held)
                except LateSetpointError:
                    pass  # this machine was too slow, so the arm has stopped; it goes on for who still holds the button
                except ProgramEndedError:
                    if self._robot is None or not self._robot.driver.lost_why:
                        raise
                    # this machine was slower still, so the program ended: it is started again for them
        except (URError, OSError) as error:
            self._failed = self._holder
            await self._give_back_quietly()
            if not isinstance(error, MotionStoppedError):
                self._tell(str(_for_people(error, _JOGGING)))
        finally:
            self._held = self._holder = self._jog = None
            self.doing = self.slowed = ""
            self._rest()

    async def _jog_while_held(self, held: Velocity) -> None:
        robot = await self._ready()
        ramp = Ramp(held.of, _bounds(robot))
        state = robot.state
        async with robot.velocity_j() if held.of == "joints" else robot.velocity_l() as follow:
            while (wanted := self._wanted(held.of)) is not None or not ramp.at_rest:
                speeds = ramp.next(wanted, state.q_rad, state.pose_base_tcp, 1.0 / self.RATE_HZ)
                self.slowed = ramp.slowed
                state = await follow(speeds)
        self.slowed = ""

    def _wanted(self, of: str) -> tuple[float, ...] | None:
        held = self._held
        if held is None or held.of != of:
            return None
        if asyncio.get_running_loop().time() - self._held_at > STALE_S:
            self._held = None
            return None
        return held.values

    def _tell(self, text: str) -> None:
        for tell in self.on_error:
            tell(text)

    # motions that end by themselves

    async def move_j(self, q_rad: Sequence[float], doing: str = "Moving", **options: Any) -> None:
        """To joint angles (6,)."""
        await self._do(doing, lambda robot: robot.move_j(q_rad, **options))

    async def move_l(self, pose_base_tcp: Sequence[float], doing: str = "Moving", **options: Any) -> None:
        """To a pose (6,), straight."""
        await self._do(doing, lambda robot: robot.move_l(pose_base_tcp, **options))

    async def move_to_pose(self, pose_base_tcp: Sequence[float], doing: str = "Moving", **options: Any) -> None:
        """To a pose (6,), turning the joints together."""
        await self._do(doing, lambda robot: robot.move_j(pose_base_tcp=pose_base_tcp, **options))

    async def follow(self, plan: "Plan", doing: str = "Moving as planned") -> None:
        """Execute a plan. Raises PlanningError if the arm is not at its start."""
        await self._do(doing, lambda robot: robot.planning.execute(plan))

    async def start_freedrive(self) -> None:
        """Let the arm be moved by hand; returns when that has ended, by ``end_freedrive`` or otherwise."""

        async def by_hand(robot: AsyncRobot) -> None:
            async with robot.freedrive():
                while not hand.is_set() and _obeys(robot):
                    await asyncio.sleep(1.0 / self.RATE_HZ)

        self._check_free(_FREEDRIVE)
        hand = self._hand = asyncio.Event()
        try:
            await self._do(_FREEDRIVE, by_hand)
        finally:
            self._hand = None

    def end_freedrive(self) -> None:
        """Hold the arm where it is."""
        if self._hand is not None:
            self._hand.set()

    async def stop(self) -> None:
        """End whatever moves; who waits for it gets MotionStoppedError."""
        self.stops += 1
        self._held = None
        self.end_freedrive()
        if self._robot is not None and self._robot.moving:
            await self._robot.stop()

    async def _do(self, doing: str, motion: Callable[[AsyncRobot], Awaitable[None]]) -> None:
        self._check_free(doing)
        stops, self.doing = self.stops, doing
        try:
            robot = await self._ready()
            if self.stops != stops:
                raise MotionStoppedError(doing, "it was stopped")
            await motion(robot)
        except BaseException as error:
            if self._robot is not None and not self._robot.driver.program_running:
                await self._give_back_quietly()
            raise _for_people(error, doing) from None
        finally:
            self.doing = ""
            self._rest()

    def _check_free(self, doing: str) -> None:
        if self.doing:
            raise self._busy(doing)

    def _busy(self, doing: str) -> RobotRefused:
        return RobotRefused(doing, f"another operation is in progress: {self.doing}", "stop that first")

    # the control program

    async def _ready(self) -> AsyncRobot:
        self._cancel_idle()
        async with self._connecting:
            if self._robot is None:
                robot = self._open_robot()
                await robot.__aenter__()
                self._robot = robot
        state = self._robot.state
        if state.robot_mode is not RobotMode.RUNNING:  # it may have changed since the page allowed this
            raise RobotRefused("motion", f"the robot mode is {_name(state.robot_mode)}", "release the brakes first")
        if not self._robot.driver.program_running:
            await self._check_no_program(self._robot)
        await self._robot.make_ready()
        return self._robot

    async def _check_no_program(self, robot: AsyncRobot) -> None:
        try:
            await robot.wait_for(lambda state: state.runtime_state == RuntimeState.STOPPED, _ENDING_S)
        except TimeoutError:
            raise RobotRefused("motion", "a program is running", "stop it first") from None

    def _rest(self) -> None:
        self._cancel_idle()
        if self._robot is not None:
            self._idle = asyncio.get_running_loop().call_later(_IDLE_S, self._end_idle)

    def _cancel_idle(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None

    def _end_idle(self) -> None:
        self._ending = asyncio.create_task(self._give_back_quietly())

    async def give_back(self) -> None:
        """End the control program, so that another may run. Raises RobotRefused while it moves the arm."""
        self._check_free("the program")
        await self._give_back_quietly()

    async def _give_back_quietly(self) -> None:
        self._cancel_idle()
        async with self._connecting:
            robot, self._robot = self._robot, None
            if robot is None:
                return
            self._leaving = True
            try:
                with suppress(URError, OSError):
                    await robot.driver.stop_program()
                with suppress(URError, OSError):
                    await robot.__aexit__(None, None, None)
            finally:
                self._leaving = False

    async def close(self) -> None:
        """Come to rest and disconnect."""
        with suppress(URError, OSError):
            await self.stop()
        await self._give_back_quietly()


def _bounds(robot: AsyncRobot) -> Bounds:
    """As the robot tells them; without a word from it, none."""
    link = robot.driver.robot
    arm = link.configuration
    if arm is None:
        return Bounds((-inf,) * 6, (inf,) * 6, (inf,) * 6)
    model = model_of(arm)
    q_min, q_max = (arm.q_min, arm.q_max) if model is None else model.position_limits
    return Bounds(q_min, q_max, arm.qd_max, geometry_of(arm, link.calibration))


def _for_people(error: BaseException, doing: str) -> BaseException:
    """Errors whose advice is for who writes programs, with advice for who holds a pendant."""
    if isinstance(error, ProgramEndedError):
        return MotionError(doing, f"the control program has ended: {error.why}")
    if isinstance(error, SafetyStopError):
        stop = error.mode.name.replace("_", " ").lower()
        return MotionError(doing, f"{stop}, {error.cause or 'the robot gives no reason'}: see Initialize")
    return error


def _obeys(robot: AsyncRobot) -> bool:
    return robot.driver.program_running and robot.driver.robot.safety_mode in MOVABLE


def _name(mode: int) -> str:
    return getattr(mode, "name", str(mode))
