"""Read packets from pcap and pcapng files of tcpdump and Wireshark, in chunks of any size; write pcapng files.

Layouts: the IETF drafts draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. Written files have one section, one
Ethernet interface, and times in nanoseconds; ``codecs`` builds the frames.
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from urproto.errors import RemoteProtocolError
from urproto.text import from_bytes, readable, to_bytes

MAGIC_SIZE = 4
_MAX_SIZE = 1 << 20  # bytes of a packet or block; tcpdump cuts packets at 256 kB
_PCAP = {  # magic number: byte order, ticks per second
    b"\xa1\xb2\xc3\xd4": (">", 1_000_000),
    b"\xd4\xc3\xb2\xa1": ("<", 1_000_000),
    b"\xa1\xb2\x3c\x4d": (">", 1_000_000_000),
    b"\x4d\x3c\xb2\xa1": ("<", 1_000_000_000),
}
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _ENHANCED_PACKET = 0x0A0D0D0A, 1, 2, 3, 6
_BYTE_ORDERS = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}
_NAME, _TSRESOL, _TSOFFSET = 2, 9, 14  # options of an interface
_APPLICATION = 4  # option of a section
_COMMENT = 1  # option of any block
_MAX_COMMENTS = 64  # kept of a file's
_MICROSECONDS = 1_000_000
_ETHERNET = 1
_NANOSECONDS = 9  # powers of ten
_MAX_OPTION = 0xFFFF  # bytes, by its size field


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet as captured. time_ns: since 1970 [ns], or None. link: its LINKTYPE. size: its size on the wire."""

    time_ns: int | None
    link: int
    data: bytes
    size: int


class PacketReader:
    """Cuts a file, which arrives in chunks of any size, into packets. comments: the file's comments read so far."""

    def __init__(self) -> None:
        self.comments: list[str] = []
        self._buffer = bytearray()
        self._skip = 0  # following bytes to ignore
        self._offset = 0  # of the buffer in the file

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take bytes; return the packets they complete. Raises RemoteProtocolError where the file is damaged."""
        self._buffer += data
        self._drop(0)
        while not self._skip and (size := self._size()) and len(self._buffer) >= size:
            piece = bytes(self._buffer[:size])
            try:
                packet = self._read(piece)
            except struct.error as error:
                raise self._broken(f"a block is too short: {error}") from error
            self._drop(size)
            if packet is not None:
                yield packet

    @property
    def rest(self) -> int:
        """Number of bytes of an incomplete packet."""
        return len(self._buffer)

    def _drop(self, size: int) -> None:
        self._skip += size
        dropped = min(self._skip, len(self._buffer))
        del self._buffer[:dropped]
        self._skip -= dropped
        self._offset += dropped

    def _broken(self, why: str) -> RemoteProtocolError:
        return RemoteProtocolError(f"the capture file cannot be read beyond offset {self._offset}: {why}")

    def _size(self) -> int:
        """Size of the next piece of the file; 0 if not known yet."""
        raise NotImplementedError

    def _read(self, piece: bytes) -> Packet | None:
        raise NotImplementedError


def open_capture(magic: bytes) -> PacketReader | None:
    """The reader for a file that starts with these 4 bytes (feed them as well); None if it is not a capture."""
    if magic == _PCAPNG:
        return _PcapngReader()
    return _PcapReader(*_PCAP[magic]) if magic in _PCAP else None


class _PcapReader(PacketReader):
    """A header, then records: seconds, ticks, bytes captured, bytes on the wire."""

    def __init__(self, order: str, ticks: int) -> None:
        super().__init__()
        self._header = struct.Struct(order + "20xI")
        self._record = struct.Struct(order + "4I")
        self._ticks = ticks
        self._link: int | None = None

    def _size(self) -> int:
        if self._link is None:
            return self._header.size
        if len(self._buffer) < self._record.size:
            return 0
        captured = self._record.unpack_from(self._buffer)[2]
        if captured > _MAX_SIZE:
            raise self._broken(f"a packet of {captured} bytes")
        return int(self._record.size + captured)

    def _read(self, piece: bytes) -> Packet | None:
        if self._link is None:
            self._link = self._header.unpack(piece)[0] & 0x0FFFFFFF  # the upper bits are about checksums
            return None
        seconds, ticks, _, size = self._record.unpack_from(piece)
        time_ns = seconds * 1_000_000_000 + ticks * (1_000_000_000 // self._ticks)
        return Packet(time_ns, self._link, piece[self._record.size :], size)


@dataclass(frozen=True, slots=True)
class _Interface:
    link: int
    ticks: int = _MICROSECONDS  # a second
    offset_s: int = 0


class _PcapngReader(PacketReader):
    """Blocks: type, size, body, size again."""

    def __init__(self) -> None:
        super().__init__()
        self._order = "<"
        self._interfaces: list[_Interface] = []

    def _size(self) -> int:
        if len(self._buffer) < 12:
            return 0
        if self._buffer[:4] == _PCAPNG:
            magic = bytes(self._buffer[8:12])
            if magic not in _BYTE_ORDERS:
                raise self._broken("a section has no byte order")
            self._order = _BYTE_ORDERS[magic]
        kind, size = self._unpack("2I", self._buffer)
        if size < 12 or size % 4:
            raise self._broken(f"a block has size {size}")
        if size <= _MAX_SIZE:
            return int(size)
        if kind in (_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _ENHANCED_PACKET):
            raise self._broken(f"a block of type {kind} has {size} bytes")
        self._drop(size)  # not used here
        return 0

    def _unpack(self, layout: str, data: bytes | bytearray, offset: int = 0) -> tuple[int, ...]:
        return struct.unpack_from(self._order + layout, data, offset)

    def _read(self, piece: bytes) -> Packet | None:
        kind, body = self._unpack("I", piece)[0], piece[8:-4]
        if kind == _SECTION:
            self._interfaces.clear()
            self._take_comments(body)
        elif kind == _INTERFACE:
            self._interfaces.append(self._interface(body))
        elif kind == _ENHANCED_PACKET:
            number, high, low, captured, size = self._unpack("5I", body)
            return self._packet(number, high << 32 | low, body[20 : 20 + captured], size)
        elif kind == _OLD_PACKET:
            number, _, high, low, captured, size = self._unpack("2H4I", body)
            return self._packet(number, high << 32 | low, body[20 : 20 + captured], size)
        elif kind == _SIMPLE_PACKET:
            (size,) = self._unpack("I", body)
            return self._packet(0, None, body[4 : 4 + size], size)
        return None

    def _packet(self, number: int, ticks: int | None, data: bytes, size: int) -> Packet:
        if number >= len(self._interfaces):
            raise self._broken(f"a packet belongs to interface {number}, which was not described")
        interface = self._interfaces[number]
        time_ns = None
        if ticks is not None:
            time_ns = interface.offset_s * 1_000_000_000 + ticks * 1_000_000_000 // interface.ticks
        return Packet(time_ns, interface.link, data, size)

    def _interface(self, body: bytes) -> _Interface:
        link, ticks, offset_s = self._unpack("H", body)[0], _MICROSECONDS, 0
        for code, option in self._options(body, 8):
            if code == _TSRESOL and len(option) == 1:
                ticks = 2 ** (option[0] & 0x7F) if option[0] & 0x80 else 10 ** option[0]
            elif code == _TSOFFSET and len(option) == 8:
                (offset_s,) = self._unpack("q", option)
        return _Interface(link, ticks, offset_s)

    def _take_comments(self, section: bytes) -> None:
        for code, option in self._options(section, 16):
            if code == _COMMENT and len(self.comments) < _MAX_COMMENTS:
                self.comments.append(readable(from_bytes(option)))

    def _options(self, body: bytes, place: int) -> Iterator[tuple[int, bytes]]:
        """Code and value of each option."""
        while place + 4 <= len(body):
            code, size = self._unpack("2H", body, place)
            if code == 0:
                return
            yield code, body[place + 4 : place + 4 + size]
            place += 4 + size + -size % 4


def head_of_capture(application: str, interface: str, comments: Iterable[str] = ()) -> bytes:
    """The blocks before the packets: the application, the interface, and comments."""
    remarks = [(_COMMENT, to_bytes(comment)) for comment in comments]
    about = _options([*remarks, (_APPLICATION, to_bytes(application))])
    link = _options([(_NAME, to_bytes(interface)), (_TSRESOL, bytes([_NANOSECONDS]))])
    section = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1) + about
    return _block(_SECTION, section) + _block(_INTERFACE, struct.pack("<HHI", _ETHERNET, 0, 0) + link)


def packet_block(time_ns: int, frame: bytes) -> bytes:
    """The block of an Ethernet frame. time_ns: since 1970."""
    size = len(frame)
    return _block(_ENHANCED_PACKET, struct.pack("<5I", 0, time_ns >> 32, time_ns & 0xFFFFFFFF, size, size) + frame)


def _block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack("<2I", kind, size) + body + struct.pack("<I", size)


def _options(items: Iterable[tuple[int, bytes]]) -> bytes:
    parts = [_option(code, value[:_MAX_OPTION]) for code, value in items]
    return b"".join(parts) + bytes(4)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<2H", code, len(value)) + value + bytes(-len(value) % 4)
