"""What is asked again and again, and what is done again and again."""

import asyncio
from collections.abc import Callable

from client.errors import ClientError
from client.pendant.polling import Asked, Newest


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(20.0):
        while not condition():
            await asyncio.sleep(0)


async def test_asks_while_somebody_looks_and_tells_what_is_new() -> None:
    answers, told = [1], []
    asked = Asked(lambda: answer(), 0.0, lambda: told.append(asked.value))

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

    asked = Asked(answer, 0.0, lambda: None)
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

    asked = Asked(answer, 0.0, lambda: None)
    await until(lambda: asked.value is None and asked.trouble)
    assert asked.trouble == "nobody there"
    await asked.close()


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
