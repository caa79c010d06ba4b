"""Cut the bytes of one direction into messages. Garbage is reported once, with its offset, and skipped.

In step, the next message starts where the last one ended. Out of step, after garbage or lost bytes, decoding resumes at
the first position that looks like a message and is followed by another one or by the end of the available data.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from client.decoding import formatting
from urproto.errors import ProtocolError, RemoteProtocolError
from urproto.text import from_bytes

_MAX_GARBAGE = 1 << 20  # bytes of garbage reported in one line


@dataclass(frozen=True, slots=True)
class Line:
    """A message as text. problem: whether it is about bytes that could not be read.

    The other fields are known in captures only: the time since 1970, both ends, and the protocol.
    """

    text: str
    problem: bool = False
    time_ns: int | None = None
    source: str = ""
    destination: str = ""
    protocol: str = ""


def problem(text: str) -> Line:
    """A line about bytes that could not be read."""
    return Line(text, True)


class Stream(Protocol):
    """One direction of a connection."""

    def feed(self, data: bytes) -> Iterator[Line]:
        """Take bytes; return lines for the messages they complete."""

    def skip(self, size: int) -> None:
        """Note that this many bytes are missing here (0: unknown)."""

    def end(self) -> Iterator[Line]:
        """Finish the stream; return lines for the unfinished rest."""


Reader = Callable[[bytes], Iterable[Line]]


@dataclass(frozen=True, slots=True)
class Framing:
    """How to cut a stream into messages.

    header: number of bytes needed to know the size. size: size of the whole message from its header; raises
    ProtocolError if it cannot be a message. likely: whether bytes (the header and anything after it) look like a
    message, at a position where a message is not certain to start.
    """

    name: str
    header: int
    size: Callable[[bytes], int]
    likely: Callable[[bytes], bool]

    def plausible(self, data: bytes) -> bool:
        """Whether a message may start here, judging from the bytes so far."""
        try:
            return len(data) < self.header or (self.size(data) > 0 and self.likely(data))
        except ProtocolError:
            return False


class FramedStream:
    """Messages that contain their size, or have a fixed size."""

    def __init__(self, framing: Framing, read: Reader) -> None:
        self._framing = framing
        self._read = read
        self._buffer = bytearray()
        self._offset = 0  # of the buffer's first byte in the stream
        self._synchronised = True
        self._garbage: tuple[int, str] | None = None  # its offset, and the reason

    def feed(self, data: bytes) -> Iterator[Line]:
        self._buffer += data
        yield from self._advance(final=False)

    def skip(self, size: int) -> None:
        self._offset += len(self._buffer) + size
        self._buffer.clear()
        self._synchronised = False

    def end(self) -> Iterator[Line]:
        yield from self._advance(final=True)
        yield from self._garbage_until(self._offset)

    def _advance(self, final: bool) -> Iterator[Line]:
        while self._buffer:
            if not self._synchronised and not (yield from self._find_sync(final)):
                return
            size = self._size()
            if size and len(self._buffer) >= size:
                yield from self._message(size)
            elif size is None:
                self._lose_sync()
            elif not final:
                return
            else:
                self._begin_garbage(f"the stream ends {len(self._buffer)} bytes into a message" + _of_size(size))
                self._lose_sync()

    def _size(self) -> int | None:
        """Size of the message that starts here: 0 if not known yet, None if it is not a message."""
        if len(self._buffer) < self._framing.header:
            return 0
        header = bytes(self._buffer[: self._framing.header])
        try:
            size = self._framing.size(header)
            if self._offset or self._framing.likely(header):
                return size
            raise RemoteProtocolError("the stream does not start with a message")
        except ProtocolError as error:
            self._begin_garbage(str(error))
            return None

    def _message(self, size: int) -> Iterator[Line]:
        data, offset = bytes(self._buffer[:size]), self._offset
        self._drop(size)
        try:
            yield from self._read(data)
        except ProtocolError as error:
            yield problem(
                f"offset {offset}: {self._framing.name} message of {size} bytes: {error}: {formatting.value(data)}"
            )

    def _drop(self, size: int) -> None:
        del self._buffer[:size]
        self._offset += size

    # out of step

    def _begin_garbage(self, reason: str) -> None:
        if self._garbage is None:
            self._garbage = self._offset, reason

    def _garbage_until(self, until: int) -> Iterator[Line]:
        if self._garbage is not None and until > self._garbage[0]:
            start, reason = self._garbage
            yield problem(f"offset {start}: {until - start} bytes are not valid {self._framing.name} data: {reason}")
        self._garbage = None

    def _lose_sync(self) -> None:
        self._drop(1)
        self._synchronised = False

    def _find_sync(self, final: bool) -> Generator[Line, None, bool]:
        """Skip to the next position where a message seems to start; return whether there is one."""
        for start in range(len(self._buffer)):
            begins = self._starts_at(start)
            if begins or (begins is None and not final):
                self._drop(start)
                if begins:
                    yield from self._garbage_until(self._offset)
                    self._synchronised = True
                return bool(begins)
        self._drop(len(self._buffer))
        if self._garbage is not None and self._offset - self._garbage[0] > _MAX_GARBAGE:
            yield from self._garbage_until(self._offset)
            self._begin_garbage("as before")
        return False

    def _starts_at(self, start: int) -> bool | None:
        """Whether a message seems to start at this position; None if more bytes are needed."""
        header = bytes(self._buffer[start : start + self._framing.header])
        if len(header) < self._framing.header:
            return None
        if not self._framing.plausible(header):
            return False
        end = start + self._framing.size(header)
        if len(self._buffer) < end:
            return None
        return self._framing.plausible(bytes(self._buffer[end : end + self._framing.header]))


def _of_size(size: int) -> str:
    return f" of {size}" if size else ""


class LineStream:
    """Text, line by line; a line that gets too long is shown in pieces.

    unfinished: also show text that does not end with a line feed (yet), for protocols that do not always send one.
    """

    def __init__(self, read: Callable[[str], Iterable[Line]], max_length: int, *, unfinished: bool = False) -> None:
        self._read = read
        self._max_length = max_length
        self._unfinished = unfinished
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Line]:
        *ended, rest = data.split(b"\n")
        for part in ended:
            yield from self._append(part)
            yield from self._flush()
        yield from self._append(rest)
        if self._unfinished and self._buffer:
            yield from self._flush()

    def skip(self, size: int) -> None:
        self._buffer += b"..."

    def end(self) -> Iterator[Line]:
        if self._buffer:
            yield from self._flush()

    def _append(self, part: bytes) -> Iterator[Line]:
        self._buffer += part
        while len(self._buffer) > self._max_length:
            yield from self._read(from_bytes(self._buffer[: self._max_length]))
            del self._buffer[: self._max_length]

    def _flush(self) -> Iterator[Line]:
        text = from_bytes(self._buffer.removesuffix(b"\r"))
        self._buffer.clear()
        yield from self._read(text)
