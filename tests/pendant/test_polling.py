"""What is asked again and again, and what is done again and again."""

import asyncio
import struct
from collections.abc import Callable

import pytest

from client.errors import ClientError
from client.pendant.polling import Newest, Poller, PortRegisters, keep_following
from urproto.compat_asyncio import timeout
from urproto.modbus import Frame, FrameDecoder, encode_frame


async def until(condition: Callable[[], object]) -> None:
    async with timeout(20.0):
        while not condition():
            await asyncio.sleep(0)


async def test_asks_while_somebody_looks_and_tells_what_is_new() -> None:
    answers, told = [1], []
    asked = Poller(lambda: answer(), 0.0, lambda: told.append(asked.value))

    async def answer() -> int:
        return answers[0]

    assert asked.value is None
    await until(lambda: asked.value == 1)
    answers[0] = 2
    await until(lambda: asked.value == 2)
    assert told == [1, 2]
    await asked.close()


async def test_nobody_looks_nobody_asks() -> None:
    others, asking = len(asyncio.all_tasks()), list[int]()

    async def answer() -> int:
        asking.append(1)
        return 1

    asked = Poller(answer, 0.0, lambda: None)
    for _ in range(20):
        await asyncio.sleep(0)
    assert not asking
    assert asked.value is None
    await until(lambda: len(asyncio.all_tasks()) == others)
    assert 1 <= len(asking) <= 4
    count = len(asking)
    assert asked.value == 1
    await until(lambda: len(asking) > count)
    await asked.close()


async def test_says_why_there_is_no_answer() -> None:
    async def answer() -> int:
        raise ClientError("nobody there")

    asked = Poller(answer, 0.0, lambda: None)
    await until(lambda: asked.value is None and asked.problem)
    assert asked.problem == "nobody there"
    await asked.close()


async def test_what_asking_needs_is_ended_when_nobody_looks_and_when_it_is_closed() -> None:
    rests, answers = list[int](), list[int]()

    async def rest() -> None:
        rests.append(1)

    async def answer() -> int:
        answers.append(1)
        return len(answers)

    asked = Poller(answer, 0.0, lambda: None, rest)
    assert asked.value is None
    await until(lambda: rests)
    count = len(answers)
    await until(lambda: asked.value == count + 1)
    await asked.close()
    assert len(rests) == 2


async def test_a_connection_that_is_lost_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("client.pendant.polling._AGAIN_S", 0.0)
    tries, told = list[int](), list[str]()

    async def follow() -> None:
        tries.append(1)
        raise OSError("gone")

    following = asyncio.create_task(keep_following(follow, told.append))
    await until(lambda: len(tries) > 2)
    following.cancel()
    assert told[:2] == ["gone", "gone"]


async def test_registers_are_read_over_one_connection_while_they_are_looked_at() -> None:
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
    registers = PortRegisters("127.0.0.1", server.sockets[0].getsockname()[1], lambda: None)
    await until(lambda: registers.words == tuple(range(128, 256)))
    memory[130] = 7
    await until(lambda: registers.words[2] == 7)
    assert connections == [1]
    await until(lambda: sum(connections) == 0)  # nobody looks any more
    server.close()
    await until(lambda: registers.words == () and registers.problem)
    await registers.close()


async def test_of_many_wishes_the_newest_is_carried_out() -> None:
    done, go_on = list[int](), asyncio.Event()

    async def do(wish: int) -> None:
        await go_on.wait()
        done.append(wish)

    newest = Newest(do, lambda text: None)
    newest.want(1)
    await asyncio.sleep(0)
    for wish in (2, 3, 4):
        newest.want(wish)
    go_on.set()
    await newest.done()
    assert done == [1, 4]


async def test_a_wish_that_fails_is_complained_about_and_the_next_one_is_done() -> None:
    complaints, done = list[str](), list[int]()

    async def do(wish: int) -> None:
        if wish < 0:
            raise ClientError("no such thing")
        done.append(wish)

    newest = Newest(do, complaints.append)
    newest.want(-1)
    await newest.done()
    newest.want(1)
    await newest.done()
    assert (complaints, done) == (["no such thing"], [1])
