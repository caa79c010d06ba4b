"""Write connections to a capture file, and read a whole capture file into memory: who sent what, and when."""

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from client.decoding.capture import MAGIC_SIZE, PacketReader, head_of_capture, open_capture, packet_block
from client.decoding.codecs import ConnectionFrames
from client.decoding.connections import Closed, Data, Ends, Event, Gap, Reassemblies, opens, possible_servers
from client.decoding.packets import SocketAddress, TcpSegment, UnreadablePacketError, tcp_segment
from client.errors import FileError
from client.traffic.ports import is_traffic
from urproto.compat import Self
from urproto.durable import NewFile
from urproto.errors import RemoteProtocolError

FLUSH_S: Final = 0.25  # interval at which to call ``flush`` [s]
_BUFFER_BYTES: Final = 1 << 18  # a larger buffer is written immediately
_APPLICATION: Final = "ur-client proxy"
_CHUNK = 1 << 20  # bytes


def wall_clock() -> Callable[[], int]:
    """A clock of nanoseconds since 1970 that never goes back."""
    begin = time.time_ns() - time.monotonic_ns()
    return lambda: begin + time.monotonic_ns()


class TrafficRecorder:
    """Writes connections to a capture file. Raises FileError if it cannot be created.

    comments: stored at the start of the file. now_ns: clock for the packets. problem: called once with the reason if
    the file can no longer be written. failed: that reason; None if there is none. place: where the packets are: in
    ``traffic.unfinished.pcapng`` until `close`, and afterwards if it failed; an earlier ``traffic.pcapng`` then stays.
    """

    def __init__(
        self,
        path: Path,
        comments: Iterable[str] = (),
        *,
        now_ns: Callable[[], int] | None = None,
        problem: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.path = path
        self.failed: str | None = None
        self._problem = problem
        self._now_ns = now_ns or wall_clock()
        self._kept = bytearray()
        self._connections = 0
        try:
            self._file = NewFile(path, unfinished=True)
        except OSError as error:
            raise FileError(path, f"cannot be written: {error.strerror}") from error
        self._kept += head_of_capture(_APPLICATION, "proxy", comments)
        self.flush()

    def connection(self, client: SocketAddress, server: SocketAddress) -> "Recorded":
        """Start recording a connection."""
        self._connections += 1
        return Recorded(self._packets, ConnectionFrames(client, server, self._connections))

    def flush(self) -> None:
        """Pass the buffered data to the operating system."""
        kept, self._kept = self._kept, bytearray()
        try:
            self._file.write(kept)
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """Finish the recording; closing it twice is allowed. If it failed, it keeps the name of an unfinished one."""
        if self._file.closed:
            return
        self.flush()
        try:
            if self.failed:
                self._file.close()
            else:
                self._file.publish()
        except OSError as error:
            self._fail(error)

    def _packets(self, frames: Iterable[bytes]) -> None:
        if self.failed or self._file.closed:
            return
        now_ns = self._now_ns()
        for frame in frames:
            self._kept += packet_block(now_ns, frame)
        if len(self._kept) > _BUFFER_BYTES:
            self.flush()

    def _fail(self, error: OSError) -> None:
        self.failed = f"{self.place} can no longer be written, after {self._file.tell()} bytes: {error.strerror}"
        with suppress(OSError):  # a pipe cannot be truncated
            self._file.truncate()
        if not self._connections:
            self._file.discard()
        self._problem(self.failed)

    @property
    def place(self) -> Path:
        return self._file.path


class ConnectionRecorder(Protocol):
    """Records one connection; each call is an event at the current time."""

    def data(self, from_client: bool, data: bytes) -> None:
        """One end has sent bytes."""

    def end(self, from_client: bool) -> None:
        """This end has closed its sending direction."""

    def reset(self, from_client: bool) -> None:
        """This end has reset the connection."""


class ConversationRecorder(Protocol):
    """Records the connections of a proxy."""

    def connection(self, client: SocketAddress, server: SocketAddress) -> ConnectionRecorder:
        """Start recording a connection."""
        ...

    def flush(self) -> None:
        """Pass the buffered data to the operating system."""


class Recorded:
    """Records one connection in a capture file."""

    def __init__(self, write: Callable[[Iterable[bytes]], None], frames: ConnectionFrames) -> None:
        self._write = write
        self._frames = frames
        write(frames.open())

    def data(self, from_client: bool, data: bytes) -> None:
        self._write(self._frames.data(from_client, data))

    def end(self, from_client: bool) -> None:
        self._write((self._frames.end(from_client),))

    def reset(self, from_client: bool) -> None:
        self._write((self._frames.reset(from_client),))


@dataclass(frozen=True, slots=True)
class Piece:
    """Bytes that one end sent at a time; empty if it closed its sending direction. time_ns: since 1970."""

    time_ns: int
    from_server: bool
    data: bytes


@dataclass(slots=True)
class Conversation:
    """One connection. port: the usual port of its protocol. begin_ns: time it was opened. lost: bytes not captured."""

    port: int
    client: SocketAddress
    server: SocketAddress
    begin_ns: int
    pieces: list[Piece] = field(default_factory=list)
    lost: int = 0

    def sent(self, from_server: bool) -> bytes:
        """All bytes that one end sent."""
        return b"".join(piece.data for piece in self.pieces if piece.from_server == from_server)


@dataclass(slots=True)
class TrafficRecording:
    """All connections to the ports of a robot or its driver, in the order in which they were opened.

    comments: remarks stored in the file. problems: messages about parts that could not be read.
    """

    path: Path
    conversations: list[Conversation] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path, port_offset: int = 0) -> Self:
        """Read a pcap or pcapng file of ``ur-client proxy``, tcpdump or Wireshark.

        port_offset: offset of the robot's ports when it was recorded. Raises FileError.
        """
        reader = _Reader(port_offset)
        try:
            with path.open("rb") as file:
                magic = file.read(MAGIC_SIZE)
                packets = open_capture(magic)
                if packets is None:
                    raise FileError(path, "is not a pcap or pcapng file: record one with ur-client proxy --record")
                reader.read(packets, magic)
                while data := file.read(_CHUNK):
                    reader.read(packets, data)
        except OSError as error:
            raise FileError(path, f"cannot be read: {error.strerror}") from error
        reader.end(packets)
        if not reader.conversations:
            why = "; ".join(reader.problems) or "check the port offset, and that the clients went through the proxy"
            raise FileError(path, f"contains no connection to a port of a robot: {why}")
        return cls(path, reader.conversations, packets.comments, reader.problems)

    def on_port(self, *ports: int) -> list[Conversation]:
        """The connections to these ports, in the order in which they were opened."""
        return [one for one in self.conversations if one.port in ports]

    @property
    def ports(self) -> list[int]:
        """The usual port numbers of all connections."""
        return sorted({one.port for one in self.conversations})


class _Reader:
    """Turns packets into conversations."""

    def __init__(self, port_offset: int) -> None:
        self.conversations: list[Conversation] = []
        self.problems: list[str] = []
        self._port_offset = port_offset
        self._connections = Reassemblies()
        self._open: dict[Ends, _Open] = {}
        self._servers: dict[Ends, SocketAddress] = {}
        self._now_ns = 0
        self._broken = False

    def read(self, packets: PacketReader, data: bytes) -> None:
        """Process bytes of the file."""
        if self._broken:
            return
        try:
            for packet in packets.feed(data):
                self._now_ns = packet.time_ns if packet.time_ns is not None else self._now_ns
                self._report_unreadable(lambda: self._segment(tcp_segment(packet)))  # noqa: B023 - called at once
        except RemoteProtocolError as error:
            self._broken = True
            self._problem(str(error))

    def end(self, packets: PacketReader) -> None:
        """Finish at the end of the file."""
        for ends, event in self._connections.finish():
            self._event(ends, event)
        if packets.rest and not self._broken:
            self._problem(f"the file ends {packets.rest} bytes into a packet")
        for one in self.conversations:
            if one.lost:
                self._problem(f"{one.lost} bytes of {one.client} > {one.server} are not in the file")

    def _report_unreadable(self, work: Callable[[], None]) -> None:
        try:
            work()
        except UnreadablePacketError as error:
            self._problem(str(error))

    def _problem(self, text: str) -> None:
        if text not in self.problems:
            self.problems.append(text)

    def _segment(self, segment: TcpSegment | None) -> None:
        if segment is None:
            return
        ends = frozenset((segment.source, segment.destination))
        if len(ends) < 2 or not self._is_relevant(ends, segment):
            return
        for of, event in self._connections.add(segment):
            self._event(of, event)
        if opens(segment) and ends not in self._open:  # otherwise it is a retransmission
            self._begin(ends)

    def _is_relevant(self, ends: Ends, segment: TcpSegment) -> bool:
        if ends in self._servers and not opens(segment):
            return True
        servers = (end for end in possible_servers(segment) if is_traffic(end.port - self._port_offset))
        if (server := next(servers, None)) is None:
            return False
        self._servers[ends] = server
        return True

    def _begin(self, ends: Ends) -> "_Open":
        server = self._servers[ends]
        client = next(end for end in ends if end != server)
        one = Conversation(server.port - self._port_offset, client, server, self._now_ns)
        self._open[ends] = _Open(one)
        self.conversations.append(one)
        return self._open[ends]

    def _event(self, ends: Ends, event: Event) -> None:
        opened = self._open.get(ends) or self._begin(ends)
        opened.add(event, self._now_ns)
        if opened.closed:
            del self._open[ends]


class _Open:
    """A conversation that is still open."""

    def __init__(self, conversation: Conversation) -> None:
        self._conversation = conversation
        self._ended: set[SocketAddress] = set()

    @property
    def closed(self) -> bool:
        return len(self._ended) == 2

    def add(self, event: Event, now_ns: int) -> None:
        time_ns = event.time_ns if event.time_ns is not None else now_ns
        from_server = event.source == self._conversation.server
        match event:
            case Data():
                self._conversation.pieces.append(Piece(time_ns, from_server, event.data))
            case Gap():
                self._conversation.lost += event.size
            case Closed():
                self._ended.add(event.source)
                self._conversation.pieces.append(Piece(time_ns, from_server, b""))
