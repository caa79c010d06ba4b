"""One connection of a replayed robot, without I/O: what it sends at which time, and its answers.

There are four kinds, depending on the port's protocol:

- Broadcast: unsolicited messages at the recorded times (primary, secondary, realtime)
- SequentialPlayer: the recorded bytes; those after bytes of the client wait for as many bytes (the tool's line)
- DialoguePlayer: an answer for each request, wherever it is in the recording (dashboard, gripper, ...)
- RTDEPlayer: states for recipes, at the recorded times

The last one has a separate module.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from client.decoding.modbus import FRAMING as MODBUS
from client.decoding.streams import Framing
from client.traffic.recording import Conversation, Piece
from urproto import dashboard
from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, readable

_MAX_REQUEST: Final = 1 << 20  # bytes of a request without an end

CutRequests = Callable[[bytearray], Iterator[bytes]]

_NUMBER: Final = 2  # bytes of it
_UNIT_AND_FUNCTION: Final = slice(6, 8)
_NO_SUCH_ADDRESS: Final = 2


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


def cut_frames(buffer: bytearray) -> Iterator[bytes]:
    """Take Modbus frames off the front of a buffer. Raises RemoteProtocolError."""
    return cut(buffer, MODBUS)


class Broadcast(Player):
    """Plays a script from its start, regardless of what the client sends."""

    def __init__(self, script: TimedMessages, timing: PlaybackOptions) -> None:
        self._script = script
        self._timing = timing
        self._begin_s = 0.0
        self._next = 0

    def begin(self, now_s: float) -> None:
        self._begin_s = now_s

    def due(self, now_s: float) -> bytes:
        position_s = (now_s - self._begin_s) * self._timing.speed
        end = bisect_right(self._script.times_s, position_s + 1e-9)
        messages = self._script.messages[self._next : end]
        self._next = max(self._next, end)
        if self._next == len(self._script.messages) and self._timing.loop and position_s >= self._script.end_s > 0:
            self._begin_s, self._next = now_s, 0
        return b"".join(messages)

    @property
    def next_s(self) -> float | None:
        times = self._script.times_s
        position_s = times[self._next] if self._next < len(times) else self._script.end_s
        return self._begin_s + position_s / self._timing.speed

    @property
    def finished(self) -> bool:
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
        self._now_s = now_s

    def take(self, data: bytes, now_s: float) -> bytes:
        self._taken += len(data)
        self._match_client_pieces(now_s)
        return b""

    def due(self, now_s: float) -> bytes:
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
        if self._next < len(self._pieces) and self._pieces[self._next].from_server:
            wait_s = (self._pieces[self._next].time_ns - self._time_ns) / 1e9 / self._timing.speed
            return self._now_s + max(0.0, wait_s)
        return None

    @property
    def finished(self) -> bool:
        return not any(piece.from_server for piece in self._pieces[self._next :])


@dataclass(slots=True)
class RequestLog:
    """The recorded requests to one port, in order, with their answers; shared by all clients.

    A request gets the answer of its next occurrence in the recording. After the last occurrence, it keeps getting that
    answer, or with ``loop`` starts again with the first.
    """

    loop: bool = False
    _pairs: list[tuple[bytes, bytes]] = field(default_factory=list)
    _position: int = 0

    def add(self, request: bytes, answer: bytes) -> None:
        """Add a recorded pair."""
        self._pairs.append((request, answer))

    def answer(self, request: bytes) -> bytes | None:
        """The answer to a request; None if the recording does not contain the request."""
        places = [place for place, (known, _) in enumerate(self._pairs) if known == request]
        if not places:
            return None
        later = next((place for place in places if place >= self._position), None)
        place = later if later is not None else places[0 if self.loop else -1]
        if later is not None or self.loop:
            self._position = place + 1
        return self._pairs[place][1]


class DialoguePlayer(Player):
    """Greets, then answers. answer: finds the answer to a request; raises UnansweredError if there is none."""

    def __init__(
        self, greeting: bytes, requests: RequestLog, cut: CutRequests, answer: Callable[[RequestLog, bytes], bytes]
    ) -> None:
        self._greeting = greeting
        self._requests = requests
        self._cut = cut
        self._answer = answer
        self._buffer = bytearray()

    def take(self, data: bytes, now_s: float) -> bytes:
        self._buffer += data
        return b"".join(self._answer(self._requests, request) for request in self._cut(self._buffer))

    def due(self, now_s: float) -> bytes:
        greeting, self._greeting = self._greeting, b""
        return greeting


def cut_lines(buffer: bytearray) -> Iterator[bytes]:
    """Take complete lines off the front of a buffer. Raises RemoteProtocolError for an endless line."""
    while (end := buffer.find(b"\n") + 1) > 0:
        yield bytes(buffer[:end])
        del buffer[:end]
    if len(buffer) > _MAX_REQUEST:
        raise RemoteProtocolError(f"a line of more than {_MAX_REQUEST} bytes")


def line_requests(conversations: Iterable[Conversation], loop: bool) -> tuple[bytes, RequestLog]:
    """The greeting of a line-based port, and its answers."""
    greeting, requests = b"", RequestLog(loop)
    for one in conversations:
        first_greeting, pairs = _line_pairs(one.pieces)
        greeting = greeting or first_greeting
        for line, answer in pairs:
            requests.add(line.strip(), answer)
    return greeting, requests


def _line_pairs(pieces: Iterable[Piece]) -> tuple[bytes, list[tuple[bytes, bytes]]]:
    """Pair the n-th line with the n-th answer; if the counts differ, with the data received before the next line."""
    greeting, requests, following, buffer = b"", list[bytes](), list[bytes](), bytearray()
    for piece in pieces:
        if piece.from_server and not requests:
            greeting += piece.data
        elif piece.from_server:
            following[-1] += piece.data
        else:
            buffer += piece.data
            for line in cut_lines(buffer):
                requests.append(line)
                following.append(b"")
    answers = b"".join(following).splitlines(keepends=True)
    return greeting, list(zip(requests, answers if len(answers) == len(requests) else following, strict=True))


def answer_line(requests: RequestLog, line: bytes) -> bytes:
    """Answer a request to a line-based port. Raises UnansweredError."""
    answer = requests.answer(line.strip())
    if answer is None:
        raise UnansweredError(readable(from_bytes(line.strip())))
    return answer


def answer_dashboard(requests: RequestLog, line: bytes) -> bytes:
    """Answer a dashboard command; an unknown one gets the dashboard's own answer to that."""
    answer = requests.answer(line.strip())
    if answer is None:
        return dashboard.encode_line(dashboard.not_understood(from_bytes(line.strip())))
    return answer


def modbus_requests(conversations: Iterable[Conversation], loop: bool) -> RequestLog:
    """The recorded requests without their transaction numbers, and the answers."""
    requests = RequestLog(loop)
    for one in conversations:
        unanswered: dict[bytes, bytes] = {}
        buffers = {True: bytearray(), False: bytearray()}
        for piece in one.pieces:
            buffers[piece.from_server] += piece.data
            for frame in cut_frames(buffers[piece.from_server]):
                if not piece.from_server:
                    unanswered[frame[:_NUMBER]] = frame
                elif frame[:_NUMBER] in unanswered:
                    requests.add(unanswered.pop(frame[:_NUMBER])[_NUMBER:], frame[_NUMBER:])
    return requests


def answer_modbus(requests: RequestLog, frame: bytes) -> bytes:
    """Answer a Modbus request; one that is not in the recording gets the exception for an illegal address."""
    answer = requests.answer(frame[_NUMBER:])
    if answer is None:
        unit, function = frame[_UNIT_AND_FUNCTION]
        answer = bytes((0, 0, 0, 3, unit, function | 0x80, _NO_SUCH_ADDRESS))
    return frame[:_NUMBER] + answer
