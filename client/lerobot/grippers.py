"""Grippers that follow a position, from 0 (open) to 1 (closed), without making the caller wait."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Final, Protocol

from client.gripper import GripperClient
from client.robot import Robot
from urproto.compat import Self
from urproto.errors import LocalProtocolError, URError
from urproto.robotiq import FULL

_POLL_S: Final = 0.02
_HALF: Final = 0.5


class FollowingGripper(Protocol):
    """A gripper; use it with ``with``. position: where its fingers are, or are thought to be."""

    @property
    def position(self) -> float: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def follow(self, position: float) -> None:
        """Go on to a position. Raises LocalProtocolError for one that is not from 0 to 1, and what has failed."""


class DigitalGripper:
    """A gripper that a digital output closes, from a half on."""

    def __init__(self, robot: Robot, host: str, output: int) -> None:
        self._robot, self._output = robot, output

    @property
    def position(self) -> float:
        return float(self._robot.digital_out(self._output))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def follow(self, position: float) -> None:
        closed = checked_position(position) >= _HALF
        if closed != self._robot.digital_out(self._output):
            self._robot.set_digital_out(self._output, closed)


class RobotiqGripper:
    """A Robotiq gripper, which is asked and commanded in the robot's event loop."""

    def __init__(self, robot: Robot, host: str, output: int) -> None:
        self._robot = robot
        self._client = GripperClient(host)
        self._task: asyncio.Task[None] | None = None
        self._wanted: int | None = None
        self._failure: URError | None = None
        self.position = 0.0

    def __enter__(self) -> Self:
        self._robot.call(self._begin())
        return self

    def __exit__(self, *_: object) -> None:
        self._robot.call(self._end())

    def follow(self, position: float) -> None:
        if self._failure is not None:
            raise self._failure
        self._wanted = round(FULL * checked_position(position))

    async def _begin(self) -> None:
        if (await self._client.state()).problem:
            await self._client.activate()
        self.position = (await self._client.state()).position_count / FULL
        self._task = asyncio.create_task(self._follow())

    async def _follow(self) -> None:
        commanded: int | None = None
        try:
            while True:
                if self._wanted != commanded and (commanded := self._wanted) is not None:
                    await self._client.move(commanded)
                self.position = (await self._client.state()).position_count / FULL
                await asyncio.sleep(_POLL_S)
        except URError as error:
            self._failure = error

    async def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
        await self._client.close()


def checked_position(position: float) -> float:
    """The position. Raises LocalProtocolError for one that is not from 0 to 1."""
    if not 0.0 <= position <= 1.0:
        raise LocalProtocolError(f"a gripper's position must be from 0 (open) to 1 (closed), not {position}")
    return position


GRIPPERS: Final[Mapping[str, Callable[[Robot, str, int], FollowingGripper]]] = MappingProxyType(
    {"robotiq": RobotiqGripper, "digital": DigitalGripper}
)
