"""Moves the arm for a pendant: as long as a button is held, to a target, by hand.

The driver's control program does it. It is on the robot only while it is needed, since the robot runs one program at
a time: the first motion starts it, some seconds without one end it.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from client.errors import ClientError
from client.robot import AsyncRobot
from urproto.errors import ProtocolError, RobotRefused
from urproto.modes import RobotMode

__all__ = ["Mover", "Velocity"]

_STALE_S: Final = 0.4  # a button that has not been heard of for so long is no longer held
_IDLE_S: Final = 10.0  # then the control program ends
_JOINT_RAMP: Final = 1.4  # rad/s2: URScript's default acceleration of joints
_TOOL_RAMP: Final = 1.2  # m/s2, and rad/s2: of tools


@dataclass(frozen=True, slots=True)
class Velocity:
    """Of the joints (6,) [rad/s], or of the TCP in the base frame (6,) [m/s, rad/s]."""

    of: Literal["joints", "tool"]
    values: tuple[float, ...]


class Mover:
    """One motion at a time, whichever browser wants it. Errors of the robot come out of the calls that wait.

    on_error: told what ended a jog. freedrive: the arm can be moved by hand.
    """

    RATE_HZ: ClassVar[float] = 50.0

    def __init__(self, open_robot: Callable[[], AsyncRobot]) -> None:
        self._open_robot = open_robot
        self._robot: AsyncRobot | None = None
        self._one_at_a_time = asyncio.Lock()
        self._held: Velocity | None = None
        self._held_at = 0.0
        self._jog: asyncio.Task[None] | None = None
        self._idle: asyncio.TimerHandle | None = None
        self._hand: asyncio.Event | None = None
        self.on_error: list[Callable[[str], None]] = []

    @property
    def freedrive(self) -> bool:
        """The arm can be moved by hand."""
        return self._hand is not None

    @property
    def has_slider(self) -> bool:
        """Only this connection may move the speed slider now."""
        return self._robot is not None

    async def set_speed_slider(self, fraction: float) -> None:
        """While there is a control program."""
        assert self._robot is not None
        await self._robot.set_speed_slider(fraction)

    # jogging

    def hold(self, velocity: Velocity) -> None:
        """Move so until ``release``, or until this has not been said again for 0.4 s."""
        self._held, self._held_at = velocity, asyncio.get_running_loop().time()
        if self._jog is None:
            self._jog = asyncio.create_task(self._jogging())

    def release(self) -> None:
        """Come to rest."""
        self._held = None

    async def _jogging(self) -> None:
        try:
            async with self._one_at_a_time:
                while self._held is not None:
                    await self._jog_while_held(self._held.of)
        except (ClientError, ProtocolError, RobotRefused, OSError) as error:
            self._held = None
            for tell in self.on_error:
                tell(str(error))
            await self._give_back()
        finally:
            self._jog = None

    async def _jog_while_held(self, of: str) -> None:
        robot = await self._ready()
        ramp = (_JOINT_RAMP if of == "joints" else _TOOL_RAMP) / self.RATE_HZ
        speeds = [0.0] * 6
        async with robot.velocity_j() if of == "joints" else robot.velocity_l() as follow:
            while (wanted := self._wanted(of)) is not None or any(speeds):
                speeds = _towards(speeds, wanted or (0.0,) * 6, ramp)
                await follow(speeds)
        self._rest()

    def _wanted(self, of: str) -> tuple[float, ...] | None:
        held = self._held
        if held is None or held.of != of:
            return None
        if asyncio.get_running_loop().time() - self._held_at > _STALE_S:
            self._held = None
            return None
        return held.values

    # motions that end by themselves

    async def move_j(self, q_rad: Sequence[float], **options: Any) -> None:
        """To joint angles (6,)."""
        await self._do(lambda robot: robot.move_j(q_rad, **options))

    async def move_l(self, pose_base_tcp: Sequence[float], **options: Any) -> None:
        """To a pose (6,), straight."""
        await self._do(lambda robot: robot.move_l(pose_base_tcp, **options))

    async def move_to_pose(self, pose_base_tcp: Sequence[float], **options: Any) -> None:
        """To a pose (6,), turning the joints together."""
        await self._do(lambda robot: robot.move_j(pose_base_tcp=pose_base_tcp, **options))

    async def start_freedrive(self) -> None:
        """Let the arm be moved by hand until ``end_freedrive``."""
        hand = self._hand = asyncio.Event()

        async def by_hand(robot: AsyncRobot) -> None:
            async with robot.freedrive():
                await hand.wait()

        try:
            await self._do(by_hand)
        finally:
            self._hand = None

    def end_freedrive(self) -> None:
        """Hold the arm where it is."""
        if self._hand is not None:
            self._hand.set()

    async def stop(self) -> None:
        """End whatever moves; who waits for it gets MotionStoppedError."""
        self._held = None
        self.end_freedrive()
        if self._robot is not None:
            await self._robot.stop()

    async def _do(self, motion: Callable[[AsyncRobot], Awaitable[None]]) -> None:
        async with self._one_at_a_time:
            try:
                await motion(await self._ready())
            except BaseException:
                if self._robot is not None and not self._robot.driver.program_running:
                    await self._give_back()
                raise
            finally:
                self._rest()

    # the control program

    async def _ready(self) -> AsyncRobot:
        self._cancel_idle()
        if self._robot is None:
            robot = self._open_robot()
            await robot.__aenter__()
            self._robot = robot
        mode = self._robot.driver.robot.robot_mode
        if mode is not RobotMode.RUNNING:
            raise RobotRefused("motion", f"the robot mode is {mode.name}", "release the brakes on Initialize first")
        await self._robot.make_ready()
        return self._robot

    def _rest(self) -> None:
        self._cancel_idle()
        if self._robot is not None:
            self._idle = asyncio.get_running_loop().call_later(_IDLE_S, self._end_idle)

    def _cancel_idle(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None

    def _end_idle(self) -> None:
        self._ending = asyncio.create_task(self.give_back())

    async def give_back(self) -> None:
        """End the control program, so that another may run."""
        async with self._one_at_a_time:
            await self._give_back()

    async def _give_back(self) -> None:
        self._cancel_idle()
        robot, self._robot = self._robot, None
        if robot is not None:
            with suppress(ClientError, ProtocolError, RobotRefused, OSError):
                await robot.driver.stop_program()
            with suppress(ClientError, ProtocolError, RobotRefused, OSError):
                await robot.__aexit__(None, None, None)

    async def close(self) -> None:
        """Come to rest and disconnect."""
        with suppress(ClientError, ProtocolError, RobotRefused, OSError):
            await self.stop()
        await self.give_back()


def _towards(speeds: Sequence[float], wanted: Sequence[float], step: float) -> list[float]:
    """The next speeds on a ramp: each changes by ``step`` at most."""
    return [now + max(-step, min(step, goal - now)) for now, goal in zip(speeds, wanted, strict=True)]
