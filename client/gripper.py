"""Client for a Robotiq 2-finger gripper, through the software of its URCap on the robot (port 63352), or an emulator's.

    async with GripperClient("192.168.56.101") as gripper:
        await gripper.activate()
        await gripper.move(MODELS["robotiq-2f-85"].closed_stop, force_count=50)
        print((await gripper.at_rest()).holds_object)

Positions, speeds and forces are the gripper's own counts; `urproto.robotiq.GripperModel` converts them. A request after
the connection was lost, or after an answer that did not come in time, connects again.
"""

import asyncio
from dataclasses import dataclass
from typing import Final

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, Flow, Reconnect
from client.errors import GripperError, RobotUnreachableError
from client.quantities import checked
from urproto import robotiq as wire
from urproto.compat_asyncio import timeout
from urproto.errors import RemoteProtocolError, RobotRefused
from urproto.robotiq import FULL, PORT, Fault, ObjectStatus, Reply, Status
from urproto.text import from_bytes, quoted

__all__ = ["PORT", "GripperClient", "GripperState"]

_POLL_S: Final = 0.02  # between two reads of a variable that is to change (guess)
_UNREACHABLE: Final = "start the emulator with --gripper, or install the gripper's URCap on the robot"
_NO_ANSWER: Final = "switch the arm on, which supplies the gripper, and check the gripper's cable"
_BLOCKED: Final = "remove what blocks the fingers, and activate it again"
_NOT_A_GRIPPER: Final = "check the port, and what listens on it"
_WAITING: Final = (Fault.NONE, Fault.ACTION_DELAYED, Fault.NOT_ACTIVATED)  # faults that an activation ends


@dataclass(frozen=True, slots=True)
class GripperState:
    """What the gripper reports. position_count: of the fingers, 0 (open) to 255.

    requested_count: the position that it has been commanded to; object_status is about the way there.
    """

    status: Status
    object_status: ObjectStatus
    fault: Fault
    position_count: int
    requested_count: int

    @property
    def holds_object(self) -> bool:
        """Whether an object has stopped the fingers."""
        return self.object_status in (ObjectStatus.HELD_OPENING, ObjectStatus.HELD_CLOSING)

    @property
    def problem(self) -> str:
        """Why the gripper does not carry out motions, as in "has the fault RELEASED"; empty if it does."""
        if self.fault not in _WAITING:
            return f"has the fault {self.fault.name} ({self.fault:#04x})"
        return {Status.ACTIVE: "", Status.ACTIVATING: "is being activated"}.get(self.status, "is not active")


@checked
class GripperClient(AsyncConnection):
    """Gripper client for asyncio programs. Tasks may share it; without ``async with``, its first request connects."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._lock = asyncio.Lock()
        self._decoder = wire.ReplyDecoder()
        self._in_step = False  # whether the next reply belongs to the next request
        self._requested_count: int | None = None  # by the last motion; None before

    async def state(self) -> GripperState:
        """Read the state of the gripper. Raises GripperError if it does not answer its controller."""
        status, object_status, fault, position, requested = await self._get("STA", "OBJ", "FLT", "POS", "PRE")
        try:
            return GripperState(Status(status), ObjectStatus(object_status), Fault(fault), position, requested)
        except ValueError as error:
            raise RemoteProtocolError(f"the gripper reports an unknown state ({error}): see its manual") from error

    async def activate(self, timeout_s: float = 20.0) -> None:
        """Reset the gripper and activate it; the fingers close and open once. Raises GripperError for a fault.

        An object between the fingers is dropped. timeout_s: how long this may take [s].
        """
        try:
            async with timeout(timeout_s):
                await self._set(ACT=0)
                await self._set(ATR=0)
                while await self._get("STA") != [Status.RESET]:
                    await asyncio.sleep(_POLL_S)
                await self._set(ACT=1)
                while (state := await self.state()).problem:
                    if state.fault not in _WAITING:
                        raise GripperError(self.host, self.port, state.problem, _BLOCKED)
                    await asyncio.sleep(_POLL_S)
        except TimeoutError as error:
            why = f"was not activated within {timeout_s:g} s"
            raise GripperError(self.host, self.port, why, _BLOCKED) from error

    async def move(self, position_count: int, speed_count: int = FULL, force_count: int = FULL) -> None:
        """Begin to move the fingers, in place of a motion under way."""
        await self._set(POS=position_count, SPE=speed_count, FOR=force_count, GTO=1)
        self._requested_count = position_count

    async def at_rest(self) -> GripperState:
        """Wait for the end of the motion begun last; return the state then. Raises GripperError if it fails."""
        while True:
            state = await self.state()
            if state.problem:
                raise GripperError(self.host, self.port, state.problem, "activate it again")
            taken_over = self._requested_count in (None, state.requested_count)
            if taken_over and state.object_status is not ObjectStatus.MOVING:
                return state
            await asyncio.sleep(_POLL_S)

    async def stop(self) -> None:
        """Stop the fingers where they are."""
        await self._set(GTO=0)

    async def _open(self) -> None:
        try:
            await super()._open()
        except RobotUnreachableError as error:
            raise RobotUnreachableError(error.host, error.port, error.reason, _UNREACHABLE) from error

    def _opening(self) -> Flow[None]:
        self._decoder = wire.ReplyDecoder()
        self._in_step = True
        yield from ()

    def _replies(self, lines: bytes, count: int) -> Flow[list[Reply]]:
        """Send requests together; read their replies, which come together, too."""
        if not self._in_step:
            yield Reconnect(within_s=0.0)
            yield from self._opening()
        self._in_step = False
        yield lines
        replies: list[Reply] = []
        while len(replies) < count:
            replies += self._decoder.feed((yield None))
        if len(replies) > count:
            raise RemoteProtocolError(f"several replies to one request: {_NOT_A_GRIPPER}")
        self._in_step = True
        return replies

    async def _request(self, lines: bytes, count: int = 1) -> list[Reply]:
        async with self._lock:
            return await self.run(self._replies(lines, count))

    async def _set(self, **values: int) -> None:
        line = wire.encode_set(values)
        if (replies := await self._request(line)) != [wire.ACK]:
            raise RobotRefused(from_bytes(line).rstrip(), _shown(replies[0]), _NOT_A_GRIPPER)

    async def _get(self, *names: str) -> list[int]:
        replies = await self._request(b"".join(map(wire.encode_get, names)), len(names))
        return [self._value(name, reply) for name, reply in zip(names, replies, strict=True)]

    def _value(self, name: str, reply: Reply) -> int:
        if reply == wire.Value(name, wire.UNKNOWN):
            raise GripperError(self.host, self.port, "does not answer its controller", _NO_ANSWER)
        text = reply.text if isinstance(reply, wire.Value) and reply.name == name else ""
        value = wire.parse_whole_number(text)
        if value is None or not 0 <= value <= FULL:
            raise RemoteProtocolError(f"GET {name} is answered with {_shown(reply)}: {_NOT_A_GRIPPER}")
        return value


def _shown(reply: Reply) -> str:
    return quoted(f"{reply.name} {reply.text}" if isinstance(reply, wire.Value) else from_bytes(reply))
