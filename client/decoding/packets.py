"""TCP segments out of captured packets.

Link layers: Ethernet with VLAN tags, loopback of BSD, macOS and Windows, Linux cooked
(``tcpdump -i any``) in both forms, raw IP. Numbers: www.tcpdump.org/linktypes.html.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address

from client.decoding.capture import Packet

_IPV4, _IPV6 = 0x0800, 0x86DD
_VLAN_TAGS = (0x8100, 0x88A8, 0x9100)
_TCP = 6
_IPV6_EXTENSIONS = (0, 43, 60)  # hop-by-hop, routing, destination options
_IPV6_FRAGMENT = 44
_FIN, _SYN, _RST, _ACK = 1, 2, 4, 16


class UnreadablePacketError(Exception):
    """A packet that may contain TCP but cannot be read; the text says why."""


@dataclass(frozen=True, slots=True)
class SocketAddress:
    """One end of a connection."""

    address: str
    port: int

    def __str__(self) -> str:
        return f"[{self.address}]:{self.port}" if ":" in self.address else f"{self.address}:{self.port}"


@dataclass(frozen=True, slots=True)
class TcpSegment:
    """One TCP segment. missing: bytes at the end of its data that were not captured. ack: None if it has none."""

    source: SocketAddress
    destination: SocketAddress
    sequence: int
    ack: int | None
    data: bytes
    missing: int
    syn: bool
    fin: bool
    rst: bool
    time_ns: int | None


def tcp_segment(packet: Packet) -> TcpSegment | None:
    """The segment in a packet; None if the packet contains something else. Raises UnreadablePacketError."""
    strip = _LINKS.get(packet.link)
    if strip is None:
        raise UnreadablePacketError(f"packets of link type {packet.link} cannot be read")
    try:
        network = strip(packet.data)
        return _of_ip(network, packet.time_ns) if network else None
    except (struct.error, IndexError, ValueError) as error:  # ValueError: a truncated address
        raise UnreadablePacketError("packets with truncated headers cannot be read") from error


# link layers: the data after their header, b"" if that is not IP


def _ethernet(data: bytes) -> bytes:
    place = 12
    (kind,) = struct.unpack_from(">H", data, place)
    while kind in _VLAN_TAGS:
        place += 4
        (kind,) = struct.unpack_from(">H", data, place)
    return data[place + 2 :] if kind in (_IPV4, _IPV6) else b""


def _cooked(data: bytes) -> bytes:
    return data[16:] if struct.unpack_from(">H", data, 14)[0] in (_IPV4, _IPV6) else b""


def _cooked2(data: bytes) -> bytes:
    return data[20:] if struct.unpack_from(">H", data)[0] in (_IPV4, _IPV6) else b""


_LINKS: dict[int, Callable[[bytes], bytes]] = {
    0: lambda data: data[4:],  # BSD loopback
    108: lambda data: data[4:],  # OpenBSD loopback
    1: _ethernet,
    113: _cooked,
    276: _cooked2,
    12: lambda data: data,  # raw IP, by its numbers on several systems
    14: lambda data: data,
    101: lambda data: data,
    228: lambda data: data,
    229: lambda data: data,
}


# IP and TCP


def _of_ip(data: bytes, time_ns: int | None) -> TcpSegment | None:
    version = data[0] >> 4
    if version == 4:
        return _of_ipv4(data, time_ns)
    return _of_ipv6(data, time_ns) if version == 6 else None


def _of_ipv4(data: bytes, time_ns: int | None) -> TcpSegment | None:
    header = (data[0] & 15) * 4
    total, fragment, protocol = struct.unpack_from(">2xH2xHxB", data)
    if protocol != _TCP:
        return None
    if fragment & 0x3FFF:
        raise UnreadablePacketError("fragments of IP packets cannot be read")
    size = (total or len(data)) - header  # 0: the network card splits the packet later
    return _of_tcp(data[header:], size, data[12:16], data[16:20], time_ns)


def _of_ipv6(data: bytes, time_ns: int | None) -> TcpSegment | None:
    payload, protocol = struct.unpack_from(">4xHB", data)
    place = 40
    while protocol in _IPV6_EXTENSIONS:
        protocol, place = data[place], place + 8 + data[place + 1] * 8
    if protocol == _IPV6_FRAGMENT:
        raise UnreadablePacketError("fragments of IP packets cannot be read")
    if protocol != _TCP:
        return None
    size = (payload or len(data) - 40) - (place - 40)
    return _of_tcp(data[place:], size, data[8:24], data[24:40], time_ns)


def _of_tcp(data: bytes, size: int, source: bytes, destination: bytes, time_ns: int | None) -> TcpSegment:
    ports = struct.unpack_from(">2H", data)
    sequence, ack, offset, flags = struct.unpack_from(">2I2B", data, 4)
    header = (offset >> 4) * 4
    wanted = max(0, size - header)
    payload = data[header : header + wanted]  # anything after it pads a short frame
    return TcpSegment(
        SocketAddress(str(ip_address(source)), ports[0]),
        SocketAddress(str(ip_address(destination)), ports[1]),
        sequence,
        ack if flags & _ACK else None,
        payload,
        wanted - len(payload),
        bool(flags & _SYN),
        bool(flags & _FIN),
        bool(flags & _RST),
        time_ns,
    )
