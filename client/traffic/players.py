"""One connection of a fake robot, without I/O: what it says at which time, and what it answers.

Three kinds, by what a port speaks:

- Broadcast: what the robot sends anyway, by the recorded times (primary, secondary, realtime)
- InOrder: the recorded bytes; what followed bytes of the client waits for as many from this one (the tool's line)
- Dialogue: an answer for each request, wherever in the recording that was asked (dashboard, gripper, ...)
- RTDEPlayer: states for recipes, by the recorded times

The last two have modules of their own.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from client.decoding.streams import Framing
from client.traffic.recording import Conversation


class UnansweredError(Exception):
    """The recording has no answer to what a client sent; the text says to what."""


@dataclass(frozen=True, slots=True)
class Timing:
    """speed: recorded seconds a second. loop: begin again at the end, instead of closing the connection."""

    speed: float = 1.0
    loop: bool = False


class Player(Protocol):
    """One connection. Times are seconds of any clock that only goes on."""

    def begin(self, now_s: float) -> None:
        """The client has connected."""

    def take(self, data: bytes, now_s: float) -> bytes:
        """The client sent bytes: what to answer at once. Raises UnansweredError, RemoteProtocolError."""

    def due(self, now_s: float) -> bytes:
        """What is to be sent by now, apart from answers."""

    @property
    def next_s(self) -> float | None:
        """When there is more to send; None when that depends on the client."""

    @property
    def over(self) -> bool:
        """Whether the robot has closed the connection."""


# broadcasts


class Script:
    """Messages and when they come, from 0 on [s]. end_s: when the robot closed the connection, or began again."""

    def __init__(self, messages: Iterable[tuple[float, bytes]]) -> None:
        pairs = list(messages)
        self.times_s = [time_s for time_s, _ in pairs]
        self.messages = [message for _, message in pairs]
        steps = len(pairs) - 1
        last_s = self.times_s[-1] if pairs else 0.0
        self.end_s = last_s + (last_s - self.times_s[0]) / steps if steps > 0 else last_s

    @classmethod
    def of(cls, conversation: Conversation, framing: Framing) -> "Script":
        """Whole messages of the server; each comes when its last byte came. Raises RemoteProtocolError."""
        return cls(_timed(conversation, framing))


def _timed(conversation: Conversation, framing: Framing) -> Iterator[tuple[float, bytes]]:
    buffer = bytearray()
    for piece in conversation.pieces:
        if not piece.from_server:
            continue
        buffer += piece.data
        time_s = (piece.time_ns - conversation.begin_ns) / 1e9
        for message in cut(buffer, framing):
            yield time_s, message


def cut(buffer: bytearray, framing: Framing) -> Iterator[bytes]:
    """Take the whole messages off the front of a buffer."""
    while len(buffer) >= framing.header:
        size = framing.size(bytes(buffer[: framing.header]))
        if len(buffer) < size:
            return
        yield bytes(buffer[:size])
        del buffer[:size]


class Broadcast:
    """A script from its beginning, whatever the client sends."""

    def __init__(self, script: Script, timing: Timing) -> None:
        self._script = script
        self._timing = timing
        self._begin_s = 0.0
        self._next = 0

    def begin(self, now_s: float) -> None:
        """Position 0 is now."""
        self._begin_s = now_s

    def take(self, data: bytes, now_s: float) -> bytes:
        """Scripts and other texts have no answer."""
        return b""

    def due(self, now_s: float) -> bytes:
        """The messages whose time has come."""
        position_s = (now_s - self._begin_s) * self._timing.speed
        end = bisect_right(self._script.times_s, position_s + 1e-9)
        messages = self._script.messages[self._next : end]
        self._next = max(self._next, end)
        if self._next == len(self._script.messages) and self._timing.loop and position_s >= self._script.end_s > 0:
            self._begin_s, self._next = now_s, 0
        return b"".join(messages)

    @property
    def next_s(self) -> float | None:
        """When the next message is due, or the end."""
        times = self._script.times_s
        position_s = times[self._next] if self._next < len(times) else self._script.end_s
        return self._begin_s + position_s / self._timing.speed

    @property
    def over(self) -> bool:
        """Whether all was said."""
        return self._next == len(self._script.messages) and not self._timing.loop


# any bytes


class InOrder:
    """The recorded bytes of the server, each as long after what came before it as it was recorded."""

    def __init__(self, conversation: Conversation, timing: Timing) -> None:
        self._pieces = conversation.pieces
        self._timing = timing
        self._time_ns = conversation.begin_ns  # of what was last played
        self._now_s = 0.0  # when that was
        self._next = 0
        self._taken = 0  # bytes of the client that no piece has used up

    def begin(self, now_s: float) -> None:
        """The recording begins now."""
        self._now_s = now_s

    def take(self, data: bytes, now_s: float) -> bytes:
        """Count them."""
        self._taken += len(data)
        self._use_up(now_s)
        return b""

    def due(self, now_s: float) -> bytes:
        """What the server said by now."""
        said = b""
        self._use_up(now_s)
        while (due_s := self.next_s) is not None and due_s <= now_s and not self.over:
            said += self._pieces[self._next].data
            self._step(due_s)
            self._use_up(due_s)
        return said

    def _use_up(self, now_s: float) -> None:
        while self._next < len(self._pieces) and not (piece := self._pieces[self._next]).from_server:
            if len(piece.data) > self._taken:
                return
            self._taken -= len(piece.data)
            self._step(now_s)

    def _step(self, now_s: float) -> None:
        self._now_s, self._time_ns = now_s, self._pieces[self._next].time_ns
        self._next += 1

    @property
    def next_s(self) -> float | None:
        """When the server speaks next; None while it waits for the client."""
        if self._next < len(self._pieces) and self._pieces[self._next].from_server:
            wait_s = (self._pieces[self._next].time_ns - self._time_ns) / 1e9 / self._timing.speed
            return self._now_s + max(0.0, wait_s)
        return None

    @property
    def over(self) -> bool:
        """Whether the server has said all."""
        return not any(piece.from_server for piece in self._pieces[self._next :])
