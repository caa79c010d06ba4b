"""Blocks of a pcapng file, as Wireshark opens it: one section, one Ethernet interface, times in nanoseconds.

Layout: the IETF draft draft-ietf-opsawg-pcapng, which ``capture`` reads. ``frames`` makes the packets.
"""

import struct
from collections.abc import Iterable

from urproto.text import to_bytes

_SECTION, _INTERFACE, _ENHANCED_PACKET = 0x0A0D0D0A, 1, 6
_COMMENT, _APPLICATION, _NAME, _TSRESOL = 1, 4, 2, 9
_ETHERNET = 1
_NANOSECONDS = 9  # powers of ten
_LONGEST_OPTION = 0xFFFF  # bytes, by its size field


def head_of_capture(application: str, interface: str, comments: Iterable[str] = ()) -> bytes:
    """What comes before the packets: who wrote the file, where, and remarks about it."""
    remarks = [(_COMMENT, to_bytes(comment)) for comment in comments]
    about = _options([*remarks, (_APPLICATION, to_bytes(application))])
    link = _options([(_NAME, to_bytes(interface)), (_TSRESOL, bytes([_NANOSECONDS]))])
    section = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1) + about
    return _block(_SECTION, section) + _block(_INTERFACE, struct.pack("<HHI", _ETHERNET, 0, 0) + link)


def packet_block(time_ns: int, frame: bytes) -> bytes:
    """An Ethernet frame at a time since 1970 [ns]."""
    size = len(frame)
    return _block(_ENHANCED_PACKET, struct.pack("<5I", 0, time_ns >> 32, time_ns & 0xFFFFFFFF, size, size) + frame)


def _block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack("<2I", kind, size) + body + struct.pack("<I", size)


def _options(items: Iterable[tuple[int, bytes]]) -> bytes:
    parts = [_option(code, value[:_LONGEST_OPTION]) for code, value in items]
    return b"".join(parts) + bytes(4)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<2H", code, len(value)) + value + bytes(-len(value) % 4)
