"""Replay of ports that answer requests: the dashboard, interpreter mode, grippers, Modbus."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from client.decoding.modbus import FRAMING as MODBUS
from client.traffic.players import Player, UnansweredError, cut
from client.traffic.recording import Conversation, Piece
from urproto import dashboard
from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, readable

_MAX_REQUEST: Final = 1 << 20  # bytes of a request without an end

CutRequests = Callable[[bytearray], Iterator[bytes]]

_NUMBER: Final = 2  # bytes of it
_UNIT_AND_FUNCTION: Final = slice(6, 8)
_NO_SUCH_ADDRESS: Final = 2


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
        """The answers to the requests that these bytes complete."""
        self._buffer += data
        return b"".join(self._answer(self._requests, request) for request in self._cut(self._buffer))

    def due(self, now_s: float) -> bytes:
        """The greeting, once."""
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


# Modbus: requests are equal regardless of their transaction number


cut_frames: Final[CutRequests] = partial(cut, framing=MODBUS)
"""Take Modbus frames off the front of a buffer. Raises RemoteProtocolError."""


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
