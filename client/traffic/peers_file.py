"""Record the devices that a robot's program talks to, as peers for ``urscript run --peers`` (docs/peers.md)."""

import re
import statistics
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final
from xmlrpc.client import Fault, loads

from client.decoding.packets import SocketAddress
from client.traffic.players import cut_lines
from client.traffic.recording import Conversation, Piece, wall_clock
from urproto.durable import write_file
from urproto.errors import RemoteProtocolError
from urproto.modbus import (
    Frame,
    FrameDecoder,
    Function,
    ModbusException,
    ModbusRequest,
    decode_request,
    decode_response,
)
from urproto.text import from_bytes

_MODBUS_PORT: Final = 502
_SHORT_S: Final = 0.01  # a shorter delay is not recorded
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
_LENGTH: Final = re.compile(rb"\r\ncontent-length: *(\d+)", re.IGNORECASE)
_READ_BITS: Final = (Function.READ_COILS, Function.READ_DISCRETE_INPUTS)


class PeersRecorder:
    """Keeps conversations in memory, and writes them as a file of peers when it is closed.

    problem: called with the reason if the file cannot be written; ``failed`` is that reason.
    """

    def __init__(self, path: Path, problem: Callable[[str], None] = lambda text: None) -> None:
        self.path = self.place = path
        self.failed: str | None = None
        self.conversations: list[Conversation] = []
        self._problem = problem
        self._now_ns = wall_clock()

    def connection(self, client: SocketAddress, server: SocketAddress) -> "RecordedPeer":
        """Start recording a connection."""
        self.conversations.append(Conversation(server.port, client, server, self._now_ns()))
        return RecordedPeer(self.conversations[-1].pieces, self._now_ns)

    def flush(self) -> None:
        """Nothing is written before the end."""

    def close(self) -> None:
        """Write the file."""
        import yaml  # after the recording: it takes long to import

        try:
            text = yaml.safe_dump(peers_of(self.conversations), sort_keys=False, allow_unicode=True, width=1000)
            write_file(self.path, text)
        except OSError as error:
            self.failed = f"{self.path} cannot be written: {error.strerror}"
            self._problem(self.failed)


class RecordedPeer:
    """Records one connection; each call is an event at the current time."""

    def __init__(self, pieces: list[Piece], now_ns: Callable[[], int]) -> None:
        self._pieces = pieces
        self._now_ns = now_ns

    def data(self, from_client: bool, data: bytes) -> None:
        """One end has sent bytes."""
        self._pieces.append(Piece(self._now_ns(), not from_client, data))

    def end(self, from_client: bool) -> None:
        """This end has closed its sending direction."""
        self.data(from_client, b"")

    reset = end


def peers_of(conversations: Iterable[Conversation]) -> dict[str, Any]:
    """The content of a file of peers in which each server answers as it did in these conversations."""
    by_server: dict[SocketAddress, list[Conversation]] = {}
    for one in conversations:
        by_server.setdefault(one.server, []).append(one)
    found: dict[str, Any] = {}
    for server, some in by_server.items():
        if server.port == _MODBUS_PORT:
            found.setdefault("modbus", {})[server.address] = _unit(some)
        elif any(one.sent(from_server=False).startswith(b"POST ") for one in some):
            found.setdefault("xmlrpc", {})[f"http://{server.address}:{server.port}"] = _methods(some)
        else:
            found.setdefault("sockets", {})[f"{server.address}:{server.port}"] = _dialogue(some)
    return found


def _single(values: list[Any]) -> Any:
    """The values, or the only one if all are the same."""
    return values[0] if values.count(values[0]) == len(values) else values


# sockets


def _dialogue(conversations: list[Conversation]) -> dict[str, Any]:
    binary = any(_CONTROL.search(piece.data) for one in conversations for piece in one.pieces)

    def written(data: bytes) -> str:
        return data.hex() if binary else from_bytes(data)

    def key_of(message: bytes) -> str:
        key = written(message if binary else message.strip())
        return f"/{re.escape(key)}/" if key[:1] == key[-1:] == "/" else key

    answers: dict[str, list[Any]] = {}
    delays_s: list[float] = []
    greetings = []
    for one in conversations:
        greeting, pairs = _exchanges(one.pieces, binary, delays_s)
        greetings.append(greeting)
        for message, answer in pairs:
            answers.setdefault(key_of(message), []).append(written(answer))
        ends = [piece.from_server for piece in one.pieces if not piece.data]
        if pairs and ends and ends[0]:  # the server hung up
            last = answers[key_of(pairs[-1][0])]
            last[-1] = {"reply": last[-1], "close": True}
    found: dict[str, Any] = {"binary": True} if binary else {}
    if greeting := next(filter(None, greetings), b""):
        found["greeting"] = written(greeting)
    if delays_s and (delay_s := statistics.median(delays_s)) > _SHORT_S:
        found["delay"] = round(delay_s, 3)
    return {**found, "answers": {key: _single(values) for key, values in answers.items()}}


def _exchanges(pieces: Iterable[Piece], binary: bool, delays_s: list[float]) -> tuple[bytes, list[tuple[bytes, bytes]]]:
    """What a server sent first, and each message with what it sent before the next one. Adds the delays of answers.

    A message ends at a line feed, or when the server answers. If there are as many lines of answers as messages, they
    are those of the messages, also if several were sent at a time.
    """
    greeting, messages, following, buffer, sent_ns = b"", list[bytes](), list[bytes](), bytearray(), 0
    for piece in pieces:
        found = []
        if not piece.from_server:
            buffer += piece.data
            sent_ns = piece.time_ns
            found = [] if binary else list(cut_lines(buffer))
        elif buffer:
            found = [bytes(buffer)]
            buffer.clear()
        messages += found
        following += [b""] * len(found)
        if piece.from_server and messages:
            if not following[-1] and piece.data:
                delays_s.append((piece.time_ns - sent_ns) / 1e9)
            following[-1] += piece.data
        elif piece.from_server:
            greeting += piece.data
    if buffer:
        messages.append(bytes(buffer))
        following.append(b"")
    lines = b"".join(following).splitlines(keepends=True)
    answers = lines if not binary and len(lines) == len(messages) else following
    return greeting, list(zip(messages, answers, strict=True))


# XML-RPC


def _methods(conversations: Iterable[Conversation]) -> dict[str, Any]:
    values: dict[str, list[Any]] = {}
    for one in conversations:
        calls, replies = (list(_bodies(one.sent(from_server=side))) for side in (False, True))
        for call, reply in zip(calls, replies, strict=False):
            name = str(loads(call)[1])
            try:
                value: Any = loads(reply)[0][0]
            except Fault as fault:
                value = {"fault": fault.faultString}
            values.setdefault(name, []).append(value)
    return {name: some[0] if some.count(some[0]) == len(some) else {"each": some} for name, some in values.items()}


def _bodies(data: bytes) -> Iterator[bytes]:
    """The bodies of HTTP messages with a length."""
    while (end := data.find(b"\r\n\r\n") + 4) > 3:
        length = _LENGTH.search(data[:end])
        size = int(length[1]) if length else 0
        yield data[end : end + size]
        data = data[end + size :]


# Modbus


def _unit(conversations: Iterable[Conversation]) -> dict[str, Any]:
    """The values that were read, in their order, and those that were written before they were read."""
    tables: dict[str, dict[int, list[int]]] = {"coils": {}, "registers": {}}
    for one in conversations:
        for request, values in _modbus_exchanges(one.pieces):
            bits = request.function in (*_READ_BITS, Function.WRITE_COIL, Function.WRITE_COILS)
            table = tables["coils" if bits else "registers"]
            for address, value in enumerate(values, request.address):
                table.setdefault(address, []).append(value)
            start = request.write_address if request.function == Function.READ_WRITE_REGISTERS else request.address
            for address, value in enumerate(request.values, start):
                table.setdefault(address, [value])
    return {
        name: {address: _single(values) for address, values in sorted(table.items())} for name, table in tables.items()
    }


def _modbus_exchanges(pieces: Iterable[Piece]) -> Iterator[tuple[ModbusRequest, tuple[int, ...]]]:
    """The requests that succeeded, with the values read."""
    decoders = {True: FrameDecoder(), False: FrameDecoder()}
    waiting: dict[int, Frame] = {}
    for piece in pieces:
        for frame in decoders[piece.from_server].feed(piece.data):
            if not piece.from_server:
                waiting[frame.transaction] = frame
            elif (asked := waiting.pop(frame.transaction, None)) is not None:
                try:
                    request = decode_request(asked.pdu)
                    yield request, decode_response(request, frame.pdu)
                except (ModbusException, RemoteProtocolError):
                    continue
