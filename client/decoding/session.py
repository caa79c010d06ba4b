"""Decode an input into lines: bytes of one direction, the same as hexadecimal text, or a capture file."""

import re
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from enum import Enum

from client.decoding.capture import MAGIC_SIZE, Packet, PacketReader, open_capture
from client.decoding.codecs import Channel, Codec, Side, codec_of_port, guess
from client.decoding.connections import (
    MAX_CONNECTIONS,
    Closed,
    Data,
    Ends,
    Event,
    Gap,
    Reassemblies,
    opens,
    possible_servers,
)
from client.decoding.packets import SocketAddress, TcpSegment, UnreadablePacketError, tcp_segment
from client.decoding.streams import Line, Stream, problem
from urproto.errors import RemoteProtocolError

_HEX_TEXT = re.compile(rb"(?:#[^\n]*(?:\n|$)|0[xX]|[0-9a-fA-F]|[\s,:;])*")
_HEX_NOISE = re.compile(rb"#[^\n]*(?=\n|$)|0[xX]|[\s,:;]")
_CHECKED = 4096  # bytes of an input from which its format is recognised
_MAX_HEX_LINE = 1 << 20
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_LISTED = 8  # ports listed in a note
_MAX_COUNTED = 1024  # ports counted for it


class InputForm(Enum):
    """Format of an input."""

    AUTO = "auto"
    RAW = "raw"
    HEX = "hex"
    PCAP = "pcap"


@dataclass(frozen=True, slots=True)
class Choice:
    """What the caller specified; the rest is guessed. ports: those of a capture to show, all of a robot's if empty."""

    codec: Codec | None = None
    side: Side | None = None
    ports: tuple[int, ...] = ()
    port_offset: int = 0
    form: InputForm = InputForm.AUTO

    def codec_of(self, port: int) -> Codec | None:
        """The protocol on a port; None if it has to be guessed."""
        return self.codec or codec_of_port(port - self.port_offset)

    def wants(self, port: int) -> bool:
        """Whether to show a capture's connections to this port."""
        return port in self.ports if self.ports else codec_of_port(port - self.port_offset) is not None


class DecodingSession:
    """Decodes one input. problems: number of lines about unreadable data. form: formats a line."""

    def __init__(self, choice: Choice, form: Callable[[Line], str] | None = None) -> None:
        self.problems = 0
        self._form = form or as_text
        self._choice = choice
        self._input: _Raw | _Hex | _Capture | None = None
        self._head = bytearray()

    def feed(self, data: bytes) -> Iterator[str]:
        """Take bytes; return the lines they complete."""
        if self._input is None:
            self._head += data
            if len(self._head) < MAGIC_SIZE:
                return
            self._open()
            data = bytes(self._head)
        assert self._input is not None
        yield from self._counted(self._input.feed(data))

    def end(self) -> Iterator[str]:
        """Finish the input; return the remaining lines."""
        if self._input is None:
            self._open()
            assert self._input is not None
            yield from self._counted(self._input.feed(bytes(self._head)))
        yield from self._counted(self._input.end())

    def _open(self) -> None:
        form, head = self._choice.form, bytes(self._head[:_CHECKED])
        reader = open_capture(head[:MAGIC_SIZE])
        if form is InputForm.PCAP or (form is InputForm.AUTO and reader is not None):
            self._input = _Capture(self._choice, reader)
        elif form is InputForm.HEX or (form is InputForm.AUTO and _is_hex(head)):
            self._input = _Hex(_Raw(self._choice))
        else:
            self._input = _Raw(self._choice)

    def _counted(self, lines: Iterator[Line]) -> Iterator[str]:
        for line in lines:
            self.problems += line.problem
            yield self._form(line)


def as_text(line: Line) -> str:
    """A line as text."""
    head = ""
    if line.source:
        time = f"{_time(line.time_ns, '%H:%M:%S.%f')} " if line.time_ns is not None else ""
        head = f"{time}{line.source} > {line.destination}{f' {line.protocol}' if line.protocol else ''}: "
    return f"{'! ' if line.problem else ''}{head}{line.text}"


def _is_hex(head: bytes) -> bool:
    return _HEX_TEXT.fullmatch(head) is not None and len(_HEX_NOISE.sub(b"", head)) > 1


class _Raw:
    """Bytes from one side."""

    def __init__(self, choice: Choice) -> None:
        codec = choice.codec or (codec_of_port(choice.ports[0] - choice.port_offset) if choice.ports else None)
        self._stream: Stream = _GuessedStream({}, choice.side)
        if codec is not None:
            self._stream = codec.open().stream(choice.side, codec.usual)

    def feed(self, data: bytes) -> Iterator[Line]:
        return self._stream.feed(data)

    def end(self) -> Iterator[Line]:
        return self._stream.end()


class _Hex:
    """The same as hexadecimal text; ``#`` starts a comment."""

    def __init__(self, raw: _Raw) -> None:
        self._raw = raw
        self._text = bytearray()
        self._line = 1
        self._broken = False

    def feed(self, data: bytes) -> Iterator[Line]:
        """Take text; return lines for the messages that its complete lines contain."""
        self._text += data
        while not self._broken and (end := self._text.find(b"\n") + 1 or len(self._text) > _MAX_HEX_LINE):
            yield from self._read(bytes(self._text[:end]))
            del self._text[:end]

    def end(self) -> Iterator[Line]:
        if not self._broken:
            yield from self._read(bytes(self._text))
        yield from self._raw.end()

    def _read(self, line: bytes) -> Iterator[Line]:
        digits = _HEX_NOISE.sub(b"", line)
        try:
            data = bytes.fromhex(digits.decode("ascii"))
        except ValueError:
            self._broken = True
            self._text.clear()
            yield problem(f"line {self._line} is not hexadecimal text: the rest is left out")
            return
        self._line += 1
        yield from self._raw.feed(data)


class _GuessedStream:
    """A stream whose protocol is guessed from its first bytes. channels: those of the connection, by protocol."""

    def __init__(self, channels: dict[str, Channel], side: Side | None, from_server: bool | None = None) -> None:
        self._channels = channels
        self._side = side
        self._from_server = from_server
        self._head = bytearray()
        self._stream: Stream | None = None

    def feed(self, data: bytes) -> Iterator[Line]:
        if self._stream is None:
            self._head += data
            yield from self._decide(final=False)
        else:
            yield from self._stream.feed(data)

    def skip(self, size: int) -> None:
        if self._stream is None:
            self._head.clear()
        else:
            self._stream.skip(size)

    def end(self) -> Iterator[Line]:
        if self._stream is None:
            yield from self._decide(final=True)
        if self._stream is not None:
            yield from self._stream.end()

    def _decide(self, final: bool) -> Iterator[Line]:
        guessed = guess(bytes(self._head), final)
        if guessed is None or not self._head:
            return
        codec, side = guessed.codec, self._side or guessed.side
        if self._from_server is not None:
            side = codec.side(self._from_server)
        channel = self._channels.setdefault(codec.name, codec.open())
        self._stream = channel.stream(side, codec.usual)
        sender = side.value if side else f"{codec.usual.value}?"
        yield Line(f"# guessed to be {codec.name} (sender: {sender}); override with --as and --from")
        yield from self._stream.feed(bytes(self._head))
        self._head.clear()


# captures


@dataclass(slots=True)
class _Tracked:
    """A tracked connection: its server, and the decoder of each end's bytes."""

    server: SocketAddress
    codec: Codec | None
    streams: dict[SocketAddress, Stream] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)

    def stream(self, source: SocketAddress) -> Stream:
        """The decoder of an end's bytes."""
        if source not in self.streams:
            stream: Stream = _GuessedStream(self.channels, None, source == self.server)
            if self.codec is not None:
                channel = self.channels.setdefault(self.codec.name, self.codec.open())
                stream = channel.stream(self.codec.side(source == self.server), self.codec.usual)
            self.streams[source] = stream
        return self.streams[source]

    def close(self, source: SocketAddress) -> Stream:
        """Close an end; when both are closed, forget the state of their protocol."""
        stream = self.streams.pop(source)
        if not self.streams:
            self.channels.clear()
        return stream


class _Capture:
    """A pcap or pcapng file."""

    def __init__(self, choice: Choice, reader: PacketReader | None) -> None:
        self._choice = choice
        self._reader = reader
        self._connections = Reassemblies()
        self._tracked: OrderedDict[Ends, _Tracked] = OrderedDict()
        self._left_out: Counter[int] = Counter()
        self._unreadable: Counter[str] = Counter()
        self._begun = False
        self._broken = False

    def feed(self, data: bytes) -> Iterator[Line]:
        """Take bytes of the file; return lines for the messages they complete."""
        if self._broken:
            return
        if self._reader is None:
            self._broken = True
            yield problem("this is not a pcap or pcapng file")
            return
        try:
            for packet in self._reader.feed(data):
                yield from self._read(packet)
        except RemoteProtocolError as error:
            self._broken = True
            yield problem(str(error))

    def end(self) -> Iterator[Line]:
        """Return lines for the rest, and for everything left out."""
        for ends, event in self._connections.finish():
            yield from self._lines(ends, event)
        if self._reader is not None and self._reader.rest and not self._broken:
            yield problem(f"the capture file ends {self._reader.rest} bytes into a packet")
        for why, count in self._unreadable.items():
            yield problem(f"{count} packets were left out: {why}")
        if self._left_out:
            ports = ", ".join(str(port) for port, _ in self._left_out.most_common(_LISTED))
            yield Line(f"# {self._left_out.total()} TCP packets of other ports were left out ({ports}); see --port")

    def _read(self, packet: Packet) -> Iterator[Line]:
        if not self._begun and packet.time_ns is not None:
            self._begun = True
            yield Line(f"# the capture begins {_time(packet.time_ns, '%Y-%m-%d %H:%M:%S.%f')} UTC")
            if self._choice.side is not None:
                yield Line("# --from has no effect: a capture shows who sent what")
        try:
            segment = tcp_segment(packet)
        except UnreadablePacketError as error:
            self._unreadable[str(error)] += 1
            return
        if segment is not None and self._is_tracked(segment):
            for ends, event in self._connections.add(segment):
                yield from self._lines(ends, event)

    def _is_tracked(self, segment: TcpSegment) -> bool:
        """Whether a segment's connection is to be shown; determines its server."""
        ends = frozenset((segment.source, segment.destination))
        if ends in self._tracked and not opens(segment):
            self._tracked.move_to_end(ends)
            return True
        candidates = possible_servers(segment)
        server = next((end for end in candidates if self._choice.wants(end.port)), None)
        if server is None:
            self._leave_out(candidates[0].port)
            return False
        if ends not in self._tracked or self._tracked[ends].server != server:
            self._tracked[ends] = _Tracked(server, self._choice.codec_of(server.port))
        if len(self._tracked) > 2 * MAX_CONNECTIONS:  # more than are followed: the oldest has ended
            self._tracked.popitem(last=False)
        return True

    def _leave_out(self, port: int) -> None:
        self._left_out[port] += 1
        if len(self._left_out) > _MAX_COUNTED:
            self._left_out = Counter(dict(self._left_out.most_common(_LISTED)))

    def _lines(self, ends: Ends, event: Event) -> Iterator[Line]:
        tracked = self._tracked[ends]
        match event:
            case Data():
                lines = tracked.stream(event.source).feed(event.data)
            case Gap():
                tracked.stream(event.source).skip(event.size)
                lines = iter([problem(f"{event.size} bytes are not in the capture")])
            case Closed():
                tracked.stream(event.source)
                lines = tracked.close(event.source).end()
        destination = next((end for end in ends if end != event.source), event.source)
        protocol = tracked.codec.name if tracked.codec else ""
        for line in lines:
            yield Line(line.text, line.problem, event.time_ns, str(event.source), str(destination), protocol)


def _time(time_ns: int, form: str) -> str:
    """The time in UTC, or as a plain number if it is out of range."""
    try:
        return (_EPOCH + timedelta(microseconds=time_ns // 1000)).strftime(form)
    except OverflowError:
        return f"{time_ns / 1e9:.6f}"
