"""One connection of a replayed robot, without I/O: what it sends at which time, and its answers.

There are four kinds, depending on the port's protocol:

- Broadcast: unsolicited messages at the recorded times (primary, secondary, realtime)
- SequentialPlayer: the recorded bytes; those after bytes of the client wait for as many bytes (the tool's line)
- DialoguePlayer: an answer for each request, wherever it is in the recording (dashboard, gripper, ...)
- RTDEPlayer: states for recipes, at the recorded times

The last two have separate modules.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from client.decoding.streams import Framing
from client.traffic.recording import Conversation


class UnansweredError(Exception):
    """The recording has no answer to a client's request, which is the text of the error."""


@dataclass(frozen=True, slots=True)
class PlaybackOptions:
    """speed: recorded seconds per second. loop: start again at the end instead of closing the connection."""

    speed: float = 1.0
    loop: bool = False


class Player:
    """One connection. Times are seconds of any monotonic clock."""

    def begin(self, now_s: float) -> None:
        """The client has connected."""

    def take(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the client; return the immediate answer. Raises UnansweredError, RemoteProtocolError."""
        return b""

    def due(self, now_s: float) -> bytes:
        """The bytes due by now, apart from answers."""
        raise NotImplementedError

    @property
    def next_s(self) -> float | None:
        """Time of the next bytes to send; None if that depends on the client."""
        return None

    @property
    def finished(self) -> bool:
        """Whether the robot has closed the connection."""
        return False


# broadcasts


class TimedMessages:
    """Messages and their times from 0 on [s]. end_s: when the connection is closed, or the script starts again."""

    def __init__(self, messages: Iterable[tuple[float, bytes]]) -> None:
        pairs = list(messages)
        self.times_s = [time_s for time_s, _ in pairs]
        self.messages = [message for _, message in pairs]
        steps = len(pairs) - 1
        last_s = self.times_s[-1] if pairs else 0.0
        self.end_s = last_s + (last_s - self.times_s[0]) / steps if steps > 0 else last_s

    @classmethod
    def of(cls, conversation: Conversation, framing: Framing) -> "TimedMessages":
        """Complete messages of the server, at the time of their last byte. Raises RemoteProtocolError."""
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
    """Take complete messages off the front of a buffer."""
    while len(buffer) >= framing.header:
        size = framing.size(bytes(buffer[: framing.header]))
        if len(buffer) < size:
            return
        yield bytes(buffer[:size])
        del buffer[:size]


class Broadcast(Player):
    """Plays a script from its start, regardless of what the client sends."""

    def __init__(self, script: TimedMessages, timing: PlaybackOptions) -> None:
        self._script = script
        self._timing = timing
        self._begin_s = 0.0
        self._next = 0

    def begin(self, now_s: float) -> None:
        """Start at position 0 now."""
        self._begin_s = now_s

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
        """Time of the next message, or of the end."""
        times = self._script.times_s
        position_s = times[self._next] if self._next < len(times) else self._script.end_s
        return self._begin_s + position_s / self._timing.speed

    @property
    def finished(self) -> bool:
        """Whether everything was sent."""
        return self._next == len(self._script.messages) and not self._timing.loop


# any bytes


class SequentialPlayer(Player):
    """Plays the recorded bytes of the server with the recorded delays after the preceding bytes."""

    def __init__(self, conversation: Conversation, timing: PlaybackOptions) -> None:
        self._pieces = conversation.pieces
        self._timing = timing
        self._time_ns = conversation.begin_ns  # recorded time of the last piece played
        self._now_s = 0.0  # time at which it was played
        self._next = 0
        self._taken = 0  # bytes of the client not yet matched to a recorded piece

    def begin(self, now_s: float) -> None:
        """Start the recording now."""
        self._now_s = now_s

    def take(self, data: bytes, now_s: float) -> bytes:
        """Count the bytes."""
        self._taken += len(data)
        self._match_client_pieces(now_s)
        return b""

    def due(self, now_s: float) -> bytes:
        """The server's bytes due by now."""
        sent = b""
        self._match_client_pieces(now_s)
        while (due_s := self.next_s) is not None and due_s <= now_s and not self.finished:
            sent += self._pieces[self._next].data
            self._step(due_s)
            self._match_client_pieces(due_s)
        return sent

    def _match_client_pieces(self, now_s: float) -> None:
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
        """Time at which the server sends next; None while it waits for the client."""
        if self._next < len(self._pieces) and self._pieces[self._next].from_server:
            wait_s = (self._pieces[self._next].time_ns - self._time_ns) / 1e9 / self._timing.speed
            return self._now_s + max(0.0, wait_s)
        return None

    @property
    def finished(self) -> bool:
        """Whether the server has sent everything."""
        return not any(piece.from_server for piece in self._pieces[self._next :])
