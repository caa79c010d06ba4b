"""Ethernet frames of a TCP connection of which only the bytes are known: the opposite of ``packets``.

Numbers are those two ends would use that lose nothing, and acknowledge at once.
"""

import struct
from collections.abc import Iterator
from ipaddress import IPv4Address, IPv6Address, ip_address

from client.decoding.packets import Endpoint

__all__ = ["ConnectionFrames"]

_FIN, _SYN, _RST, _PSH, _ACK = 1, 2, 4, 8, 16
_TCP = 6
_MOST = 32768  # bytes of a segment: IP's size field ends at 64 kB
_WINDOW = 0xFFFF
_NUMBERS = 1 << 32
_MACS = {True: bytes.fromhex("020000000001"), False: bytes.fromhex("020000000002")}  # locally administered


class ConnectionFrames:
    """The frames of one connection. ``number`` tells it from an earlier one between the same ends."""

    def __init__(self, client: Endpoint, server: Endpoint, number: int = 0) -> None:
        addresses = _addresses(client.address, server.address)
        self._ends = {True: (addresses[0], client.port), False: (addresses[1], server.port)}
        self._next = {True: _first_number(2 * number), False: _first_number(2 * number + 1)}

    def open(self) -> Iterator[bytes]:
        """The handshake."""
        yield self._frame(True, _SYN)
        yield self._frame(False, _SYN | _ACK)
        yield self._frame(True, _ACK)

    def data(self, from_client: bool, data: bytes) -> Iterator[bytes]:
        """Bytes of one end."""
        for start in range(0, len(data), _MOST):
            yield self._frame(from_client, _PSH | _ACK, data[start : start + _MOST])

    def end(self, from_client: bool) -> bytes:
        """This end sends nothing more."""
        return self._frame(from_client, _FIN | _ACK)

    def reset(self, from_client: bool) -> bytes:
        """This end breaks the connection off."""
        return self._frame(from_client, _RST | _ACK)

    def _frame(self, from_client: bool, flags: int, data: bytes = b"") -> bytes:
        (source, port), (destination, other_port) = self._ends[from_client], self._ends[not from_client]
        ack = self._next[not from_client] if flags & _ACK else 0
        head = struct.pack(">2H2I2B3H", port, other_port, self._next[from_client], ack, 5 << 4, flags, _WINDOW, 0, 0)
        tcp = head + data
        self._next[from_client] = (self._next[from_client] + len(data) + bool(flags & (_FIN | _SYN))) % _NUMBERS
        pseudo = source.packed + destination.packed + struct.pack(">2I", len(tcp), _TCP)
        tcp = tcp[:16] + _checksum(pseudo + tcp) + tcp[18:]
        macs = _MACS[not from_client] + _MACS[from_client]
        if source.version == 4:
            return macs + b"\x08\x00" + _ipv4(source.packed, destination.packed, len(tcp)) + tcp
        return macs + b"\x86\xdd" + _ipv6(source.packed, destination.packed, len(tcp)) + tcp


def _addresses(client: str, server: str) -> list[IPv4Address | IPv6Address]:
    """Both as IPv4, or both as IPv6 when one of them is."""
    found = [ip_address(text.partition("%")[0]) for text in (client, server)]
    if found[0].version == found[1].version:
        return found
    return [ip_address(f"::ffff:{address}") if address.version == 4 else address for address in found]


def _first_number(number: int) -> int:
    return number * 0x01000193 % _NUMBERS  # far from that of the connection before


def _ipv4(source: bytes, destination: bytes, size: int) -> bytes:
    head = struct.pack(">2B3H2BH", 0x45, 0, 20 + size, 0, 0x4000, 64, _TCP, 0) + source + destination
    return head[:10] + _checksum(head) + head[12:]


def _ipv6(source: bytes, destination: bytes, size: int) -> bytes:
    return struct.pack(">IH2B", 6 << 28, size, _TCP, 64) + source + destination


def _checksum(data: bytes) -> bytes:
    """Of IP and TCP: the complement of the sum of all 16-bit words, whose carries are added again (RFC 1071)."""
    words = int.from_bytes(data + bytes(len(data) % 2), "big") % 0xFFFF  # 2^16 is 1 there: the remainder is that sum
    return (0xFFFF - words).to_bytes(2, "big") if words else bytes(2)
