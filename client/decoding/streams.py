"""Messages out of one direction's bytes. Garbage is reported once, with its place, and skipped.

In step, the next message begins where the last one ended. Out of step, after garbage or
lost bytes, the stream goes on at the first place that looks like a message and is followed
by the end of what is there or by something that looks like a message too.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from client.decoding import formatting
from urproto.errors import ProtocolError, RemoteProtocolError
from urproto.text import from_bytes

_LONGEST_STRETCH = 1 << 20  # bytes of garbage that are reported as one stretch


@dataclass(frozen=True, slots=True)
class Line:
    """What is shown of a message; ``problem`` when it is about bytes that could not be read.

    The rest is known in captures: when it was sent (nanoseconds since 1970), its ends, and the protocol.
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
        """Take bytes, tell what they complete."""

    def lost(self, size: int) -> None:
        """So many bytes are missing here (0: nobody knows how many)."""

    def end(self) -> Iterator[Line]:
        """No more bytes come: tell what is unfinished."""


Reader = Callable[[bytes], Iterable[Line]]


@dataclass(frozen=True, slots=True)
class Framing:
    """How a protocol's messages are cut.

    header: bytes that are enough to know the size. size: of the whole message, from its
    header; raises ProtocolError for what cannot be one. likely: whether bytes (the header
    and whatever follows) may be a message when nothing proves that one begins here.
    """

    name: str
    header: int
    size: Callable[[bytes], int]
    likely: Callable[[bytes], bool]

    def plausible(self, data: bytes) -> bool:
        """Whether a message may begin here, as far as the bytes tell."""
        try:
            return len(data) < self.header or (self.size(data) > 0 and self.likely(data))
        except ProtocolError:
            return False


class FramedStream:
    """Messages that carry their size, or have one size."""

    def __init__(self, framing: Framing, read: Reader) -> None:
        self._framing = framing
        self._read = read
        self._buffer = bytearray()
        self._offset = 0  # of the buffer's first byte in the stream
        self._in_step = True
        self._garbage: tuple[int, str] | None = None  # where it began, and why it is some

    def feed(self, data: bytes) -> Iterator[Line]:
        """Take bytes, tell the messages they complete."""
        self._buffer += data
        yield from self._go_on(final=False)

    def lost(self, size: int) -> None:
        """What is unfinished stays so; look for the next message."""
        self._offset += len(self._buffer) + size
        self._buffer.clear()
        self._in_step = False

    def end(self) -> Iterator[Line]:
        """Tell what is unfinished, and look for messages in it."""
        yield from self._go_on(final=True)
        yield from self._garbage_until(self._offset)

    def _go_on(self, final: bool) -> Iterator[Line]:
        while self._buffer:
            if not self._in_step and not (yield from self._find_step(final)):
                return
            size = self._size()
            if size and len(self._buffer) >= size:
                yield from self._message(size)
            elif size is None:
                self._leave_step()
            elif not final:
                return
            else:
                self._begin_garbage(f"the end comes {len(self._buffer)} bytes into a message" + _of(size))
                self._leave_step()

    def _size(self) -> int | None:
        """Of the message that begins here: 0 when that is not known yet, None when there is none."""
        if len(self._buffer) < self._framing.header:
            return 0
        header = bytes(self._buffer[: self._framing.header])
        try:
            size = self._framing.size(header)
            if self._offset or self._framing.likely(header):
                return size
            raise RemoteProtocolError("the stream does not begin with one")
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
            yield problem(f"offset {start}: {until - start} bytes are no {self._framing.name} message: {reason}")
        self._garbage = None

    def _leave_step(self) -> None:
        self._drop(1)
        self._in_step = False

    def _find_step(self, final: bool) -> Generator[Line, None, bool]:
        """Skip to where a message seems to begin; whether there is such a place."""
        for start in range(len(self._buffer)):
            begins = self._begins_at(start)
            if begins or (begins is None and not final):
                self._drop(start)
                if begins:
                    yield from self._garbage_until(self._offset)
                    self._in_step = True
                return bool(begins)
        self._drop(len(self._buffer))
        if self._garbage is not None and self._offset - self._garbage[0] > _LONGEST_STRETCH:
            yield from self._garbage_until(self._offset)
            self._begin_garbage("as before")
        return False

    def _begins_at(self, start: int) -> bool | None:
        """Whether a message seems to begin there; None when more bytes will tell."""
        header = bytes(self._buffer[start : start + self._framing.header])
        if len(header) < self._framing.header:
            return None
        if not self._framing.plausible(header):
            return False
        end = start + self._framing.size(header)
        if len(self._buffer) < end:
            return None
        return self._framing.plausible(bytes(self._buffer[end : end + self._framing.header]))


def _of(size: int) -> str:
    return f" of {size}" if size else ""


class LineStream:
    """Text, shown line by line; a line that grows too long is shown in pieces.

    unfinished: the protocol does not end every text with a line feed, so what is left when
    bytes stop coming for now is shown too.
    """

    def __init__(self, read: Callable[[str], Iterable[Line]], longest: int, *, unfinished: bool = False) -> None:
        self._read = read
        self._longest = longest
        self._unfinished = unfinished
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Line]:
        """Take bytes, tell the lines they complete."""
        *ended, rest = data.split(b"\n")
        for part in ended:
            yield from self._take(part)
            yield from self._tell()
        yield from self._take(rest)
        if self._unfinished and self._buffer:
            yield from self._tell()

    def lost(self, size: int) -> None:
        """The line in the making has lost its end."""
        self._buffer += b"..."

    def end(self) -> Iterator[Line]:
        """Tell a last line that has no end."""
        if self._buffer:
            yield from self._tell()

    def _take(self, part: bytes) -> Iterator[Line]:
        self._buffer += part
        while len(self._buffer) > self._longest:
            yield from self._read(from_bytes(self._buffer[: self._longest]))
            del self._buffer[: self._longest]

    def _tell(self) -> Iterator[Line]:
        text = from_bytes(self._buffer.removesuffix(b"\r"))
        self._buffer.clear()
        yield from self._read(text)
