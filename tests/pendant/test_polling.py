"""Polling, reconnection and execution of the latest request."""

import asyncio
import struct
from collections.abc import Callable

import pytest

from client.errors import ClientError
from client.pendant.polling import GeneralRegisters, LatestRequest, Poller, follow_forever
from urproto.compat_asyncio import timeout
from urproto.modbus import Frame, FrameDecoder, encode_frame


async def until(condition: Callable[[], object]) -> None:
    async with timeout(20.0):
        while not condition():
            await asyncio.sleep(0)


async def test_polls_while_read_and_reports_changes() -> None:
    answers, changes = [1], []
    poller = Poller(lambda: answer(), 0.0, lambda: changes.append(poller.value))

    async def answer() -> int:
        return answers[0]

    assert poller.value is None
    await until(lambda: poller.value == 1)
    answers[0] = 2
    await until(lambda: poller.value == 2)
    assert changes == [1, 2]
    await poller.close()


async def test_does_not_poll_unless_read() -> None:
    others, queries = len(asyncio.all_tasks()), list[int]()

    async def answer() -> int:
        queries.append(1)
        return 1

    poller = Poller(answer, 0.0, lambda: None)
    for _ in range(20):
        await asyncio.sleep(0)
    assert not queries
    assert poller.value is None
    await until(lambda: len(asyncio.all_tasks()) == others)
    assert 1 <= len(queries) <= 4
    count = len(queries)
    assert poller.value == 1
    await until(lambda: len(queries) > count)
    await poller.close()


async def test_reports_problem_without_answer() -> None:
    async def answer() -> int:
        raise ClientError("nobody there")

    poller = Poller(answer, 0.0, lambda: None)
    await until(lambda: poller.value is None and poller.problem)
    assert poller.problem == "nobody there"
    await poller.close()


async def test_releases_resources_when_unread_or_closed() -> None:
    releases, answers = list[int](), list[int]()

    async def release() -> None:
        releases.append(1)

    async def answer() -> int:
        answers.append(1)
        return len(answers)

    poller = Poller(answer, 0.0, lambda: None, release)
    assert poller.value is None
    await until(lambda: releases)
    count = len(answers)
    await until(lambda: poller.value == count + 1)
    await poller.close()
    assert len(releases) == 2


async def test_lost_connection_is_reopened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("client.pendant.polling._RETRY_PERIOD_S", 0.0)
    attempts, changes = list[int](), list[str]()

    async def follow() -> None:
        attempts.append(1)
        raise OSError("gone")

    following = asyncio.create_task(follow_forever(follow, changes.append))
    await until(lambda: len(attempts) > 2)
    following.cancel()
    assert changes[:2] == ["gone", "gone"]


async def test_registers_are_read_over_one_connection() -> None:
    memory = [*range(256)]
    connections = list[int]()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(1)
        frames = FrameDecoder()
        while data := await reader.read(4096):
            for frame in frames.feed(data):
                first, count = struct.unpack(">2H", frame.pdu[1:5])
                words = struct.pack(f">{count}H", *memory[first : first + count])
                writer.write(encode_frame(Frame(frame.transaction, frame.unit, bytes([3, 2 * count]) + words)))
        connections.append(-1)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    registers = GeneralRegisters("127.0.0.1", server.sockets[0].getsockname()[1], lambda: None)
    await until(lambda: registers.words == tuple(range(128, 256)))
    memory[130] = 7
    await until(lambda: registers.words[2] == 7)
    assert connections == [1]
    await until(lambda: sum(connections) == 0)  # no longer read
    server.close()
    await until(lambda: registers.words == () and registers.problem)
    await registers.close()


async def test_only_latest_request_is_executed() -> None:
    done, may_continue = list[int](), asyncio.Event()

    async def execute(request: int) -> None:
        await may_continue.wait()
        done.append(request)

    requests = LatestRequest(execute, lambda text: None)
    requests.submit(1)
    await asyncio.sleep(0)
    for request in (2, 3, 4):
        requests.submit(request)
    may_continue.set()
    await requests.finish()
    assert done == [1, 4]


async def test_failed_request_is_reported_and_next_one_executed() -> None:
    complaints, done = list[str](), list[int]()

    async def execute(request: int) -> None:
        if request < 0:
            raise ClientError("no such thing")
        done.append(request)

    requests = LatestRequest(execute, complaints.append)
    requests.submit(-1)
    await requests.finish()
    requests.submit(1)
    await requests.finish()
    assert (complaints, done) == (["no such thing"], [1])
