"""Recorded devices: what one has answered, it answers again as a peer of a script."""

import asyncio
from pathlib import Path
from xmlrpc.client import Fault, dumps

import pytest
from typer.testing import CliRunner

from client.cli import app
from client.decoding.packets import SocketAddress
from client.traffic.peers_file import PeersRecorder, peers_of
from client.traffic.proxy import Proxy, peer_routes
from client.traffic.recording import Conversation, Piece
from emulator.peers.connection import PeerSocket
from emulator.peers.file import parse_peers, read_peers
from tests.rows import each_row
from urproto.modbus import Frame, Function, ModbusRequest, encode_frame, encode_request, encode_response

HOST, PORT = "127.87.0.1", 50123
SERVER = SocketAddress("10.0.0.9", 5000)


def conversation(*pieces: tuple[bool, bytes], port: int = 5000, step_ms: int = 1) -> Conversation:
    """from_server and data of each piece."""
    timed = [Piece(number * step_ms * 10**6, *piece) for number, piece in enumerate(pieces)]
    return Conversation(port, SocketAddress("10.0.0.1", 40000), SocketAddress(SERVER.address, port), 0, timed)


GRIPPER = conversation(
    *((True, b"ready\n"), (False, b"SET POS"), (False, b" 9\n"), (True, b"ack")),
    *((False, b"GET POS\n"), (True, b"POS 3\n"), (False, b"GET POS\n"), (True, b"POS 9\n")),
)
SOCKETS = {
    "lines, and values that change": (
        [GRIPPER],
        {"greeting": "ready\n", "answers": {"SET POS 9": "ack", "GET POS": ["POS 3\n", "POS 9\n"]}},
    ),
    "several lines at a time": (
        [conversation((False, b"a\nb\n"), (True, b"1\n2\n"))],
        {"answers": {"a": "1\n", "b": "2\n"}},
    ),
    "no line end, slow, and the server hangs up": (
        [conversation((False, b"find"), (True, b"(1,2)"), (True, b""), (False, b""), step_ms=200)],
        {"delay": 0.2, "answers": {"find": {"reply": "(1,2)", "close": True}}},
    ),
    "binary": (
        [conversation((False, b"\0\1"), (True, b"\0\2"), (False, b"\0\1"), (False, b"\n"), (True, b"\0\3"))],
        {"binary": True, "answers": {"0001": "0002", "00010a": "0003"}},
    ),
    "text like a pattern": ([conversation((False, b"/a.c/\n"), (True, b"x"))], {"answers": {r"//a\.c//": "x"}}),
}


@each_row("case", SOCKETS)
def test_sockets(case: str) -> None:
    conversations, expected = SOCKETS[case]
    content = peers_of(conversations)
    assert content == {"sockets": {"10.0.0.9:5000": expected}}
    _replayed(content, conversations[0])


def _replayed(content: dict, one: Conversation) -> None:
    """What the script reads when it sends the same again."""
    peers = parse_peers(content, "peers", Path())
    now_s = [0.0]
    [log] = peers.logs
    log.now = lambda: now_s[0]
    socket = peers.open(SERVER.address, SERVER.port)
    assert isinstance(socket, PeerSocket)
    for piece in one.pieces:
        if piece.from_server:
            now_s[0] += 1.0
            assert socket.state
        else:
            socket.send(piece.data)
    now_s[0] += 1.0
    assert socket.state == ("closed" if any(not piece.data and piece.from_server for piece in one.pieces) else "open")
    assert bytes(socket.inbox) == one.sent(from_server=True)


def _http(body: str) -> bytes:
    head = "POST /RPC2 HTTP/1.1" if "methodCall" in body else "HTTP/1.1 200 OK"
    return f"{head}\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode()


def test_xmlrpc() -> None:
    calls = [("grip", True), ("width", 25.0), ("width", 60.0), ("stop", Fault(1, "no current"))]
    pieces: list[tuple[bool, bytes]] = []
    for name, value in calls:
        reply = dumps(value if isinstance(value, Fault) else (value,), methodresponse=True)
        pieces += [(False, _http(dumps((0,), name))), (True, _http(reply))]
    content = peers_of([conversation(*pieces)])
    methods = {"grip": True, "width": {"each": [25.0, 60.0]}, "stop": {"fault": "no current"}}
    assert content == {"xmlrpc": {"http://10.0.0.9:5000": methods}}
    _replay_of_calls(content, calls)


def _replay_of_calls(content: dict, calls: list) -> None:
    peer = parse_peers(content, "peers", Path()).sockets["10.0.0.9", 5000]
    for name, value in calls:
        reply = peer.answerer.answer(dumps((0,), name).encode()).data
        expected = dumps(value if isinstance(value, Fault) else (value,), methodresponse=True)
        assert reply.partition(b"\r\n\r\n")[2].decode() == expected


def test_modbus() -> None:
    read = ModbusRequest(Function.READ_HOLDING_REGISTERS, 128, 2)
    write = ModbusRequest(Function.WRITE_COIL, 16, values=(1,))
    pieces: list[tuple[bool, bytes]] = []
    for number, (request, values) in enumerate([(read, (7, 1)), (write, ()), (read, (7, 2))]):
        pieces += [
            (False, encode_frame(Frame(number, 255, encode_request(request)))),
            (True, encode_frame(Frame(number, 255, encode_response(request, values)))),
        ]
    content = peers_of([conversation(*pieces, port=502)])
    assert content == {"modbus": {"10.0.0.9": {"coils": {16: 1}, "registers": {128: 7, 129: [1, 2]}}}}
    unit = parse_peers(content, "peers", Path()).units["10.0.0.9"]
    answers = [unit.request(read), unit.request(read)]
    assert [exchange.values for exchange in answers] == [(7, 1), (7, 2)]


async def test_the_proxy_records_a_device(tmp_path: Path) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            writer.write(b"got " + line)
        writer.close()

    device = await asyncio.start_server(serve, HOST, PORT)
    recorder = PeersRecorder(tmp_path / "device.yaml")
    routes = peer_routes([(HOST, PORT)], HOST, listen_offset=1)
    async with Proxy(routes, recorder, lambda text: None):
        reader, writer = await asyncio.open_connection(HOST, PORT + 1)
        writer.write(b"one\n")
        assert await reader.readline() == b"got one\n"
        writer.close()
        await writer.wait_closed()
    device.close()
    await device.wait_closed()
    recorder.close()
    socket = read_peers(tmp_path / "device.yaml").open(HOST, PORT)
    socket.send(b"one\n")
    assert bytes(socket.inbox) == b"got one\n"


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--peer", "10.0.0.9"], "not of the form HOST:PORT"),
        (["--record", "a.yaml", "--listen", "127.0.0.9"], "records peers only: give --peer"),
    ],
)
def test_wrong_options(options: list[str], complaint: str) -> None:
    result = CliRunner().invoke(app, ["proxy", *options])
    assert result.exit_code == 2
    assert complaint in " ".join(result.output.replace("│", " ").split())
