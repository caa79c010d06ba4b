"""Both shells do the same with what a flow yields."""

import asyncio
from collections.abc import Callable

import pytest

from client.connection import POLL, AsyncConnection, BlockingConnection, Reconnect, TimeLimit
from client.errors import ConnectionLostError, NoAnswerError, RobotUnreachableError


def echo(connection):
    while data := connection.recv(100):
        connection.sendall(data)


def hang_up(connection):
    connection.recv(1)


def run_blocking(port: int, flow, **options):
    with BlockingConnection("127.0.0.1", port) as connection:
        return connection.run(flow, **options)


def run_async(port: int, flow, **options):
    async def run():
        async with AsyncConnection("127.0.0.1", port) as connection:
            return await connection.run(flow, **options)

    return asyncio.run(run())


both_shells = pytest.mark.parametrize("run", [run_blocking, run_async])
Run = Callable[..., object]


@both_shells
def test_sending_polling_and_receiving(serve, run: Run):
    def flow():
        assert (yield POLL) == b""
        yield b"hello"
        received = b""
        while received != b"hello":
            received += yield None
        return received, (yield POLL)

    assert run(serve(echo), flow()) == (b"hello", b"")


@both_shells
def test_a_flow_may_shorten_its_time_and_explain_the_silence(serve, run: Run):
    def flow():
        yield TimeLimit(0.01)
        try:
            yield None
        except NoAnswerError as error:
            silent_for = error.timeout_s
        yield TimeLimit(None)
        yield b"x"
        return silent_for, (yield None)

    assert run(serve(echo), flow()) == (0.01, b"x")


@both_shells
def test_an_error_the_flow_does_not_handle_comes_out(serve, run: Run):
    ended = []

    def flow():
        try:
            yield b"x"
            yield None
        finally:
            ended.append(True)

    with pytest.raises(ConnectionLostError):
        run(serve(hang_up), flow())
    assert ended == [True]


@both_shells
def test_reconnecting_begins_the_time_anew(serve, run: Run):
    def flow():
        yield b"x"
        with pytest.raises(ConnectionLostError):
            yield None
        yield Reconnect(5.0)
        yield b"y"
        try:
            while True:
                assert (yield POLL) == b""
        except ConnectionLostError:
            return "back"

    assert run(serve(hang_up), flow(), timeout_s=5.0) == "back"


@both_shells
def test_reconnecting_without_a_server(serve, run: Run, monkeypatch):
    """The attempts end with their time; their error is the flow's to handle."""
    port = serve(echo)

    def flow():
        monkeypatch.setattr("client.connection.socket.create_connection", refuse)
        monkeypatch.setattr("client.connection.asyncio.open_connection", refuse)
        try:
            yield Reconnect(0.0)
        except RobotUnreachableError as error:
            return error.reason

    assert run(port, flow()) == "away"


def refuse(*_: object) -> None:
    raise OSError(113, "away")


@both_shells
def test_a_flow_without_requests(serve, run: Run):
    def flow():
        yield from ()
        return 5

    assert run(serve(echo), flow()) == 5
