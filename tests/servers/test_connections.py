"""Features shared by all ports: slow readers, request queues, hooks."""

import asyncio
import logging
import socket
import struct
from typing import Any

import pytest
from server_rig import FakeController, MemoryClient

from emulator.mailbox import Command
from emulator.servers.command_queue import CommandQueue
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction
from emulator.servers.port import PortServer
from urproto.errors import RemoteProtocolError

MIB = 1024 * 1024


class Numbered(Command):
    def __init__(self, number: int) -> None:
        self.number = number


@pytest.fixture
def server() -> PortServer:
    return PortServer("test", FakeController())


def test_state_is_skipped_for_a_client_that_does_not_read(server: PortServer) -> None:
    slow, quick = MemoryClient(server), MemoryClient(server)
    slow.transport.stalled = True
    slow.connection.send(b"must arrive ")
    for number in range(3):
        for client in (slow, quick):
            client.connection.send_state(b"state%d " % number)
    slow.connection.send(b"too ")
    slow.transport.unstall()
    slow.connection.send_state(b"newest")
    assert slow.take() == b"must arrive too newest"
    assert quick.take() == b"state0 state1 state2 "


def test_debug_lines_report_connects_lag_and_disconnects(server: PortServer, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, logger="emulator")
    slow = MemoryClient(server)
    slow.transport.stalled = True
    for number in range(3):
        slow.connection.send_state(b"state%d" % number)
    slow.transport.unstall()
    for _ in range(2):
        slow.connection.send_state(b"newest")
    slow.transport.close()
    assert [record.getMessage() for record in caplog.records] == [
        "41.000 s: test: memory:0 connected",
        "41.000 s: test: memory:0 lags: states are skipped until it reads the 6 bytes that wait for it",
        "41.000 s: test: memory:0 has caught up: 2 states were skipped",
        "41.000 s: test: memory:0 disconnected",
    ]


def test_a_client_is_dropped_when_undroppable_messages_pile_up(
    server: PortServer, caplog: pytest.LogCaptureFixture
) -> None:
    slow, quick = MemoryClient(server), MemoryClient(server)
    slow.transport.stalled = True
    for _ in range(MIB // 1000):
        slow.connection.send(bytes(1000))
    assert slow.connected
    slow.connection.send(bytes(1000))
    assert slow.transport.aborted
    assert server.connections == [quick.connection]
    assert "does not read" in caplog.text
    slow.connection.send(b"late")
    slow.connection.send_state(b"late")
    quick.connection.send(b"fine")
    assert quick.take() == b"fine"


def test_commands_of_one_connection_keep_their_order() -> None:
    controller = FakeController()
    answers: list[Any] = []
    queue = CommandQueue(controller, lambda going: None, max_unanswered=2)
    for number in range(5):
        queue.put(Numbered(number), answers.append)
    seen = []
    while not queue.idle:
        controller.tick()
        seen.append(len(answers))
    assert seen == [2, 4, 5]
    assert [command.number for command in controller.commands] == [0, 1, 2, 3, 4]


def test_reading_pauses_during_a_flood_until_the_controller_catches_up(server: PortServer) -> None:
    client = MemoryClient(server)
    queue = CommandQueue(server.controller, client.connection.read_on)
    for number in range(200):
        queue.put(Numbered(number))
    assert not client.transport.is_reading()
    server.controller.tick(250)
    assert client.transport.is_reading()
    assert len(server.controller.commands) == 200


def test_a_failing_reply_does_not_block_the_queue() -> None:
    controller = FakeController()
    queue = CommandQueue(controller, lambda going: None)

    def fail(answer: Any) -> None:
        raise RuntimeError(answer)

    queue.put(Numbered(0), fail)
    queue.put(Numbered(1))
    with pytest.raises(RuntimeError):
        controller.tick()
    controller.tick()
    assert queue.idle


class Picky(Connection):
    def received(self, data: bytes) -> None:
        raise RemoteProtocolError("rubbish")


def test_a_protocol_violation_ends_only_its_own_connection(
    server: PortServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    other = MemoryClient(server)
    monkeypatch.setattr(server, "connect", lambda: Picky(server))
    picky = MemoryClient(server)
    picky.feed(b"x")
    assert not picky.connected
    assert other.connected
    assert "rubbish" in caplog.text


def test_hooks_see_and_change_bytes(server: PortServer) -> None:
    seen: list[tuple[Direction, bytes]] = []

    def record(connection: Connection, direction: Direction, data: bytes) -> bytes:
        seen.append((direction, data))
        return data

    def lose(connection: Connection, direction: Direction, data: bytes) -> bytes:
        return b"" if b"lost" in data else data.upper()

    server.hooks.on_bytes += [record, lose]
    client = MemoryClient(server)
    client.connection.send(b"a")
    client.connection.send_state(b"lost")
    client.feed(b"b")
    assert client.take() == b"A"
    assert seen == [(Direction.SENT, b"a"), (Direction.SENT, b"lost"), (Direction.RECEIVED, b"b")]


def test_held_bytes_pass_before_the_end_which_is_noticed_once(server: PortServer) -> None:
    seen: list[object] = []

    class Patient(Connection):
        def received(self, data: bytes) -> None:
            seen.append(data)
            self.send(b"answer")

        def at_end(self) -> bool:
            seen.append("end")
            return True

    def hold(connection: Connection, direction: Direction, data: bytes) -> bytes:
        connection.keep(direction, len(data))
        return b""

    server.hooks.on_bytes.append(hold)
    server.connect = lambda: Patient(server)  # type: ignore[method-assign]
    client = MemoryClient(server)
    client.feed(b"question")
    client.end()
    assert (seen, client.connected) == ([], True)
    client.connection.pass_on(Direction.RECEIVED, b"question", hold)
    client.connection.send(b" more")
    client.connection.pass_on(Direction.SENT, b" more", hold)
    assert (seen, client.take(), client.connected) == ([b"question", "end"], b" more", True)
    client.connection.close()
    assert client.connected
    client.connection.pass_on(Direction.SENT, b"answer", hold)
    assert (client.take(), client.connected) == (b"answer", False)


def test_hooks_turn_clients_away(server: PortServer) -> None:
    server.hooks.on_connect.append(lambda connection: False)
    assert not MemoryClient(server).connected
    assert not server.connections


async def test_data_sent_before_a_connection_reset_is_processed() -> None:
    received = bytearray()

    class Listening(Connection):
        def received(self, data: bytes) -> None:
            received.extend(data)

    class Port(PortServer):
        def connect(self) -> Connection:
            return Listening(self)

    server = Port("test", FakeController())
    await server.start("127.0.0.1", 0)
    try:
        client = socket.create_connection(("127.0.0.1", server.port))
        while not server.connections:
            await asyncio.sleep(0)
        (connection,) = server.connections
        client.sendall(b"the last command")
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.close()  # as with unread states: a reset
        connection.send_state(b"a state")  # notices it first
        while server.connections:
            await asyncio.sleep(0)
    finally:
        await server.stop()
    assert received == b"the last command"
