"""Feeds of states: kept rows, shared connections, and inheritance of rows."""

import asyncio
from collections.abc import Sequence
from typing import Any

from client.errors import ConnectionLostError
from client.pendant.feeds import Feed, Feeds
from urproto.compat_asyncio import timeout

Q = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


def state(time_s: float, **values: Any) -> dict[str, Any]:
    return {"timestamp": time_s, **values}


def test_rows_match_received_states() -> None:
    feed = Feed(("timestamp", "actual_q", "robot_mode"), keep_rows=True)
    states = [state(8.0 + i, actual_q=tuple(i + q for q in Q), robot_mode=7) for i in range(3)]
    for one in states:
        feed.append_state(one)
    assert (feed.begin, feed.end, feed.width) == (0, 3, 8)
    assert list(feed.states()) == states
    assert list(feed.states(2)) == states[2:]
    assert isinstance(next(feed.states())["robot_mode"], int)
    assert list(feed.rows(1, 2)) == [9.0, *(1 + q for q in Q), 7.0]
    assert feed.column("actual_q", 5) == 6
    assert [feed.row_at(time_s) for time_s in (0.0, 8.5, 9.0, 11.0)] == [0, 1, 1, 3]


def test_unavailable_values_are_none() -> None:
    feed = Feed(("timestamp", "actual_q", "payload", "robot_mode"), keep_rows=True)
    feed.append_state(state(1.0))
    assert next(feed.states()) == state(1.0, actual_q=(None,) * 6, payload=None, robot_mode=None)


def test_successor_inherits_common_values() -> None:
    predecessor = Feed(("timestamp", "actual_q"), keep_rows=True)
    predecessor.append_state(state(1.0, actual_q=Q))
    successor = Feed(("timestamp", "speed_scaling", "actual_q"), keep_rows=True)
    successor.inherit_rows(predecessor)
    successor.append_state(state(2.0, actual_q=Q, speed_scaling=0.5))
    assert list(successor.states()) == [
        state(1.0, actual_q=Q, speed_scaling=None),
        state(2.0, actual_q=Q, speed_scaling=0.5),
    ]


def test_oldest_rows_are_dropped(monkeypatch) -> None:
    monkeypatch.setattr("client.pendant.feeds._MAX_NUMBERS", 160)
    feed = Feed(("timestamp", "speed_scaling"), keep_rows=True)
    for i in range(1000):
        feed.append_state(state(float(i), speed_scaling=1.0))
        assert feed.end == i + 1
        assert feed.end - feed.begin <= 81
    times = [one["timestamp"] for one in feed.states()]
    assert times == [float(i) for i in range(feed.begin, 1000)]
    assert list(feed.rows(0, feed.begin + 1)) == [float(feed.begin), 1.0]
    assert next(feed.copy().states()) == next(feed.states())


class FakeClient:
    """An RTDE connection that returns the messages of the test."""

    def __init__(self, names: Sequence[str], rate_hz: float, opened: list["FakeClient"]) -> None:
        self.names, self.rate_hz = names, rate_hz
        self.core = self
        self.unavailable: frozenset[str] = frozenset()
        self.messages: asyncio.Queue[Any] = asyncio.Queue()
        self.open = False
        opened.append(self)

    async def __aenter__(self) -> "FakeClient":
        self.open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self.open = False

    async def receive(self) -> Any:
        messages = await self.messages.get()
        if isinstance(messages, Exception):
            raise messages
        return messages


async def until(condition) -> None:
    async with timeout(10):
        while not condition():
            await asyncio.sleep(0)


async def test_equal_subscriptions_share_a_connection() -> None:
    opened = list[FakeClient]()
    feeds = Feeds(lambda names, rate: FakeClient(names, rate, opened))  # type: ignore[arg-type, return-value]
    first = feeds.subscribe(["actual_q", "timestamp"], 50.0)
    second = feeds.subscribe(["timestamp", "actual_q"], 50.0)
    other = feeds.subscribe(["timestamp"], 50.0)
    await until(lambda: len(opened) == 2)
    assert first is second
    assert len(feeds) == 2
    opened[0].messages.put_nowait(state(1.0, actual_q=Q))
    await until(lambda: first.values)
    feeds.unsubscribe(first)
    await asyncio.sleep(0)
    assert opened[0].open
    feeds.unsubscribe(second)
    await until(lambda: not opened[0].open)
    assert len(feeds) == 1
    feeds.unsubscribe(other, linger_s=60.0)
    assert feeds.subscribe(["timestamp"], 50.0) is other
    feeds.unsubscribe(other, linger_s=0.001)
    await until(lambda: not opened[1].open)
    assert len(feeds) == 0


async def test_lost_connection_is_reported_and_reopened(monkeypatch) -> None:
    monkeypatch.setattr("client.pendant.polling._RETRY_PERIOD_S", 0.0)
    opened = list[FakeClient]()
    feeds = Feeds(lambda names, rate: FakeClient(names, rate, opened))  # type: ignore[arg-type, return-value]
    feed = feeds.subscribe(["timestamp"], 10.0, keep_rows=True)
    await until(lambda: opened)
    opened[0].messages.put_nowait(state(1.0))
    await until(lambda: feed.values)
    assert not feed.problem
    opened[0].messages.put_nowait(ConnectionLostError("robot", 30004))
    await until(lambda: len(opened) == 2)
    assert "30004" in feed.problem
    assert not feed.values
    opened[1].messages.put_nowait(state(2.0))
    await until(lambda: feed.end == 2)
    assert not feed.problem
    await feeds.close()
    assert not opened[1].open
