"""A capture file's connections: who sent what, and when. It is held in memory as a whole."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from client.decoding.capture import MAGIC_SIZE, PacketReader, open_capture
from client.decoding.connections import Closed, Connections, Data, Ends, Event, Lost, opens, possible_servers
from client.decoding.packets import Endpoint, Segment, UnreadablePacketError, tcp_segment
from client.errors import FileError
from client.traffic.ports import is_traffic
from urproto.errors import RemoteProtocolError

__all__ = ["Conversation", "Piece", "Recording"]

_CHUNK = 1 << 20  # bytes


@dataclass(frozen=True, slots=True)
class Piece:
    """What one end sent at a time: bytes, or none when it said that there are no more. time_ns: since 1970."""

    time_ns: int
    from_server: bool
    data: bytes


@dataclass(slots=True)
class Conversation:
    """One connection. port: the usual one of its protocol; begin_ns: when it was opened; lost: bytes not captured."""

    port: int
    client: Endpoint
    server: Endpoint
    begin_ns: int
    pieces: list[Piece] = field(default_factory=list)
    lost: int = 0

    def sent(self, from_server: bool) -> bytes:
        """All bytes of one end."""
        return b"".join(piece.data for piece in self.pieces if piece.from_server == from_server)


@dataclass(slots=True)
class Recording:
    """All connections to the ports of a robot or its driver, as they began.

    comments: what the file says about itself. troubles: what could not be read, in words.
    """

    path: Path
    conversations: list[Conversation] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path, port_offset: int = 0) -> Self:
        """A pcap or pcapng file, of ``ur-client proxy``, tcpdump or Wireshark.

        port_offset: what the robot added to each usual port, as it was recorded. Raises FileError.
        """
        reader = _Reader(port_offset)
        try:
            with path.open("rb") as file:
                magic = file.read(MAGIC_SIZE)
                packets = open_capture(magic)
                if packets is None:
                    raise FileError(path, "this is no pcap or pcapng file; `ur-client proxy --record` makes one")
                reader.take(packets, magic)
                while data := file.read(_CHUNK):
                    reader.take(packets, data)
        except OSError as error:
            raise FileError(path, f"cannot be read: {error.strerror}") from error
        reader.end(packets)
        if not reader.conversations:
            why = "; ".join(reader.troubles) or "check the port offset, and that the clients went through the proxy"
            raise FileError(path, f"holds no connection to a port of a robot: {why}")
        return cls(path, reader.conversations, packets.comments, reader.troubles)

    def on_port(self, *ports: int) -> list[Conversation]:
        """The connections to these ports, in their order."""
        return [one for one in self.conversations if one.port in ports]

    @property
    def ports(self) -> list[int]:
        """The usual ports of which there are connections."""
        return sorted({one.port for one in self.conversations})


class _Reader:
    """Packets in, conversations out."""

    def __init__(self, port_offset: int) -> None:
        self.conversations: list[Conversation] = []
        self.troubles: list[str] = []
        self._port_offset = port_offset
        self._connections = Connections()
        self._open: dict[Ends, _Open] = {}
        self._servers: dict[Ends, Endpoint] = {}
        self._now_ns = 0
        self._broken = False

    def take(self, packets: PacketReader, data: bytes) -> None:
        """Bytes of the file."""
        if self._broken:
            return
        try:
            for packet in packets.feed(data):
                self._now_ns = packet.time_ns if packet.time_ns is not None else self._now_ns
                self._guarded(lambda: self._segment(tcp_segment(packet)))  # noqa: B023 - called at once
        except RemoteProtocolError as error:
            self._broken = True
            self._trouble(str(error))

    def end(self, packets: PacketReader) -> None:
        """The file has ended."""
        for ends, event in self._connections.finish():
            self._event(ends, event)
        if packets.rest and not self._broken:
            self._trouble(f"the file ends {packets.rest} bytes into a packet")
        for one in self.conversations:
            if one.lost:
                self._trouble(f"{one.lost} bytes of {one.client} > {one.server} are not in the file")

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except UnreadablePacketError as error:
            self._trouble(str(error))

    def _trouble(self, text: str) -> None:
        if text not in self.troubles:
            self.troubles.append(text)

    def _segment(self, segment: Segment | None) -> None:
        if segment is None:
            return
        ends = frozenset((segment.source, segment.destination))
        if len(ends) < 2 or not self._is_wanted(ends, segment):
            return
        for of, event in self._connections.add(segment):
            self._event(of, event)
        if opens(segment) and ends not in self._open:  # there it is one that was sent again
            self._begin(ends)

    def _is_wanted(self, ends: Ends, segment: Segment) -> bool:
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
        opened.take(event, self._now_ns)
        if opened.closed:
            del self._open[ends]


class _Open:
    """A conversation that goes on."""

    def __init__(self, conversation: Conversation) -> None:
        self._conversation = conversation
        self._ended: set[Endpoint] = set()

    @property
    def closed(self) -> bool:
        return len(self._ended) == 2

    def take(self, event: Event, now_ns: int) -> None:
        time_ns = event.time_ns if event.time_ns is not None else now_ns
        from_server = event.source == self._conversation.server
        match event:
            case Data():
                self._conversation.pieces.append(Piece(time_ns, from_server, event.data))
            case Lost():
                self._conversation.lost += event.size
            case Closed():
                self._ended.add(event.source)
                self._conversation.pieces.append(Piece(time_ns, from_server, b""))
