"""Captures created manually, and the output of a session for them."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from client.decoding.session import Choice, DecodingSession, InputForm

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FIN, SYN, RST, PSH, ACK = 1, 2, 4, 8, 16
ROBOT, CLIENT = "10.0.0.1", "10.0.0.2"
BEGIN_S = 1_700_000_000  # 2023-11-14 22:13:20 UTC


def golden(name: str) -> bytes:
    lines = (GOLDEN / f"{name}.hex").read_text().splitlines()
    return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))


def decoded_lines(data: bytes, chunk: int = 0, **choice) -> list[str]:
    """The output lines for raw bytes."""
    return session(data, chunk, **{"form": InputForm.RAW, **choice})[0]


def session(data: bytes, chunk: int = 0, **choice) -> tuple[list[str], int]:
    """The output lines for any input, and the number of problems."""
    one = DecodingSession(Choice(**choice))
    lines = []
    for start in range(0, len(data), chunk or max(1, len(data))):
        lines += one.feed(data[start : start + (chunk or len(data))])
    return [*lines, *one.end()], one.problems


@dataclass(frozen=True)
class Sent:
    """A segment sent by one side of a connection."""

    from_robot: bool
    flags: int
    sequence: int
    ack: int
    data: bytes = b""


class Conversation:
    """Segments of one connection between two ends without packet loss."""

    def __init__(self, robot_isn: int = 0xFFFFFFF0, client_isn: int = 1000) -> None:
        self.next = {True: robot_isn, False: client_isn}
        self.segments: list[Sent] = []

    def open(self) -> "Conversation":
        self._send(False, SYN)
        self._send(True, SYN | ACK)
        return self

    def send(self, from_robot: bool, data: bytes, pieces: int = 1) -> "Conversation":
        size = -(-len(data) // pieces)
        for start in range(0, len(data), size):
            self._send(from_robot, ACK | PSH, data[start : start + size])
        return self

    def close(self) -> "Conversation":
        self._send(True, ACK | FIN)
        self._send(False, ACK | FIN)
        return self

    def _send(self, from_robot: bool, flags: int, data: bytes = b"") -> None:
        ack = self.next[not from_robot] if flags & ACK else 0
        self.segments.append(Sent(from_robot, flags, self.next[from_robot], ack, data))
        self.next[from_robot] = (self.next[from_robot] + len(data) + bool(flags & (SYN | FIN))) % 2**32


def ip_packet(sent: Sent, port: int, client_port: int = 45678, robot: str = ROBOT, client: str = CLIENT) -> bytes:
    ends = ((robot, port), (client, client_port))
    (source, sport), (destination, dport) = ends if sent.from_robot else ends[::-1]
    tcp = struct.pack(">HHIIBBHHH", sport, dport, sent.sequence, sent.ack, 5 << 4, sent.flags, 8192, 0, 0) + sent.data
    addresses = ip_address(source).packed + ip_address(destination).packed
    if len(addresses) == 32:
        return struct.pack(">IHBB", 6 << 28, len(tcp), 6, 64) + addresses + tcp
    return struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(tcp), 0, 0x4000, 64, 6, 0) + addresses + tcp


def ethernet(ip: bytes) -> bytes:
    kind = 0x0800 if ip[0] >> 4 == 4 else 0x86DD
    return (bytes(12) + struct.pack(">H", kind) + ip).ljust(60, b"\0")  # a short frame is padded


def pcap(packets: Iterable[bytes], link: int = 1, order: str = "<", nanoseconds: bool = False) -> bytes:
    """A capture file, its packets 1 ms apart."""
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    data = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 262144, link)
    for index, packet in enumerate(packets):
        ticks = index * (1_000_000 if nanoseconds else 1000)
        data += struct.pack(order + "IIII", BEGIN_S, ticks, len(packet), len(packet)) + packet
    return data


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack(order + "II", kind, size) + body + struct.pack(order + "I", size)


def pcapng(packets: Iterable[bytes], link: int = 1, order: str = "<") -> bytes:
    """The same as pcapng with ticks of 1 ns, a block of an unknown kind between the packets."""
    data = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)
    resolution = struct.pack(order + "HH", 9, 1) + bytes([9, 0, 0, 0]) + struct.pack(order + "HH", 0, 0)
    data += block(1, struct.pack(order + "HHI", link, 0, 0) + resolution, order)
    for index, packet in enumerate(packets):
        ticks = BEGIN_S * 10**9 + index * 10**6
        head = struct.pack(order + "IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet))
        data += block(6, head + packet, order) + block(5, b"statistics", order)
    return data
