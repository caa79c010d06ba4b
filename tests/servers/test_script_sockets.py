"""The connections of scripts, over real loopback sockets."""

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from emulator.programs.sockets import ScriptSocket
from emulator.servers import script_sockets
from emulator.servers.script_sockets import NetworkSockets

HOST = "127.0.0.1"


class Peer:
    """The server a script connects to."""

    def __init__(self) -> None:
        self.connections: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
        self.port = 0
        self.writers: list[asyncio.StreamWriter] = []

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        await self.connections.put((reader, writer))


@pytest.fixture
async def peer() -> AsyncIterator[Peer]:
    peer = Peer()
    server = await asyncio.start_server(peer.accept, HOST, 0)
    peer.port = server.sockets[0].getsockname()[1]
    yield peer
    server.close()
    await asyncio.sleep(0.01)  # what is still being accepted
    for writer in peer.writers:
        writer.transport.abort()
    await asyncio.sleep(0)


@pytest.fixture
async def sockets() -> AsyncIterator[NetworkSockets]:
    sockets = NetworkSockets()
    yield sockets
    await sockets.close()


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0)


async def opened(sockets: NetworkSockets, peer: Peer) -> ScriptSocket:
    socket = sockets.open(HOST, peer.port)
    assert socket.state == "connecting"
    assert not socket.send(b"too early")
    await until(lambda: socket.state == "open")
    return socket


async def test_both_ways(sockets: NetworkSockets, peer: Peer) -> None:
    socket = await opened(sockets, peer)
    reader, writer = await peer.connections.get()
    assert socket.send(b"hello\n")
    assert await reader.readline() == b"hello\n"
    writer.write(b"answer")
    await until(lambda: bytes(socket.inbox) == b"answer")
    writer.close()
    await until(lambda: socket.state == "closed")
    assert bytes(socket.inbox) == b"answer", "what had arrived stays readable"
    assert not socket.send(b"more")


async def test_the_peer_sees_a_close(sockets: NetworkSockets, peer: Peer) -> None:
    socket = await opened(sockets, peer)
    reader, _ = await peer.connections.get()
    socket.send(b"last words")
    socket.close()
    socket.close()
    assert socket.state == "closed"
    assert await reader.read() == b"last words"


@pytest.mark.parametrize("port", [1, 0, -1, 70_000])
async def test_impossible_addresses_turn_closed(sockets: NetworkSockets, port: int) -> None:
    socket = sockets.open(HOST, port)
    await until(lambda: socket.state == "closed")


async def test_closing_while_connecting(sockets: NetworkSockets, peer: Peer) -> None:
    socket = sockets.open(HOST, peer.port)
    socket.close()
    assert socket.state == "closed"
    other = sockets.open(HOST, peer.port)
    await asyncio.sleep(0)
    other.close()
    await sockets.close()
    assert other.state == "closed"


async def test_a_peer_that_is_far_ahead_has_to_wait(
    sockets: NetworkSockets, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script_sockets, "_MOST_UNREAD", 1000)
    socket = await opened(sockets, peer)
    _, writer = await peer.connections.get()
    sent = bytes(range(256)) * 8000
    writer.write(sent)
    await until(lambda: len(socket.inbox) >= 1000)
    await asyncio.sleep(0.05)
    assert len(socket.inbox) < len(sent)
    got = bytearray()

    def read() -> bool:
        if socket.state == "open":
            got.extend(socket.inbox)
            socket.inbox.clear()
        return len(got) == len(sent)

    await until(read)
    assert got == sent
