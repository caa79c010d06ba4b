"""Streams of RTDE states for the pages: any recipe at any rate, in addition to the pendant's own.

Browsers that show the same data share a connection, which is closed when no browser shows it any more.
"""

import asyncio
import math
from array import array
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Final

from client.pendant.polling import follow_forever
from client.rtde import RTDEClient
from urproto.rtde.fields import OUTPUT_FIELDS

_MAX_NUMBERS: Final = 2_000_000  # kept of one feed: 16 MB, half an hour of twelve numbers at 90 Hz

OpenClient = Callable[[Sequence[str], float], RTDEClient]


class Feed:
    """The states of one recipe, collected as rows of numbers; texts and missing values are NaN.

    names: the RTDE outputs. values: the newest state, empty before the first one and after a loss. rate_hz: the actual
    rate. problem: why no states arrive. end: number of rows received so far; rows before ``begin`` have been dropped.
    """

    def __init__(self, names: Sequence[str], keep_rows: bool) -> None:
        self.names = tuple(names)
        self.values: Mapping[str, Any] = {}
        self.rate_hz = 0.0
        self.problem = "connecting"
        self.unavailable: frozenset[str] = frozenset()
        self.begin = 0
        self.width = sum(OUTPUT_FIELDS[name].type.count for name in names)
        self._keep_rows = keep_rows
        self._rows = array("d")
        self._first_columns = dict[str, int]()  # field -> its first column
        column = 0
        for name in names:
            self._first_columns[name] = column
            column += OUTPUT_FIELDS[name].type.count

    @property
    def end(self) -> int:
        """Number of the next row."""
        return self.begin + len(self._rows) // self.width

    def column(self, name: str, index: int = 0) -> int:
        """The column of an element of a variable. Raises KeyError."""
        return self._first_columns[name] + index

    def rows(self, begin: int, end: int) -> "array[float]":
        """The numbers of these rows, one row after the other, as far as they are kept."""
        first = max(begin - self.begin, 0) * self.width
        return self._rows[first : max(end - self.begin, 0) * self.width]

    def row_at(self, time_s: float) -> int:
        """The first row that is not older than this robot time; after a clock was set back, rows count as older."""
        column, count = self._first_columns["timestamp"], self.end - self.begin
        return self.begin + bisect_left(range(count), time_s, key=lambda i: self._rows[i * self.width + column])

    def states(self, begin: int = 0) -> Iterator[dict[str, Any]]:
        """All kept states from a row on, as received over RTDE; None for values not requested at that time."""
        for row in range(max(self.begin, begin), self.end):
            yield self._state(self.rows(row, row + 1))

    def copy(self) -> "Feed":
        """A copy of the present rows, for a reader that takes longer."""
        other = Feed(self.names, True)
        other.begin, other._rows = self.begin, self._rows[:]
        return other

    def append_state(self, values: Mapping[str, Any]) -> None:
        self.values = values
        self.problem = ""
        if not self._keep_rows:
            return
        for name in self.names:
            value = values.get(name)
            if isinstance(value, tuple):
                self._rows.extend(value)
            elif value is None:
                self._rows.extend([math.nan] * OUTPUT_FIELDS[name].type.count)
            else:
                self._rows.append(value)
        if len(self._rows) > _MAX_NUMBERS:
            self._drop(len(self._rows) // self.width // 8)

    def inherit_rows(self, other: "Feed") -> None:
        """Take over the rows of another feed, with the values that both have."""
        count = other.end - other.begin
        self.begin = other.begin
        self._rows = array("d", [math.nan]) * (count * self.width)
        for name in set(self.names) & set(other.names):
            for index in range(OUTPUT_FIELDS[name].type.count):
                own_column, other_column = self.column(name, index), other.column(name, index)
                self._rows[own_column :: self.width] = other._rows[other_column :: other.width]
        if len(self._rows) > _MAX_NUMBERS:
            self._drop((len(self._rows) - _MAX_NUMBERS) // self.width + 1)

    def mark_lost(self, problem: str) -> None:
        """The connection to the robot was lost."""
        self.values = {}
        self.problem = problem

    def _drop(self, count: int) -> None:
        del self._rows[: count * self.width]
        self.begin += count

    def _state(self, row: "array[float]") -> dict[str, Any]:
        state = dict[str, Any]()
        for name, first in self._first_columns.items():
            kind = OUTPUT_FIELDS[name].type
            numbers = [_convert(value, kind.letter) for value in row[first : first + kind.count]]
            state[name] = tuple(numbers) if kind.count > 1 else numbers[0]
        return state


def _convert(value: float, letter: str) -> Any:
    if math.isnan(value):
        return None
    return value if letter == "d" else bool(value) if letter == "?" else int(value)


class Feeds:
    """The feeds of one robot."""

    def __init__(self, open_client: OpenClient) -> None:
        self._open_client = open_client
        self._feeds = dict[tuple[Any, ...], Feed]()
        self._subscriber_counts = dict[int, int]()  # by id of a feed
        self._tasks = dict[int, asyncio.Task[None]]()
        self._lingering = dict[int, asyncio.TimerHandle]()

    def subscribe(
        self, names: Collection[str], rate_hz: float, keep_rows: bool = False, predecessor: Feed | None = None
    ) -> Feed:
        """Subscribe to these RTDE outputs, until ``unsubscribe``.

        keep_rows: collect rows, too. predecessor: a feed whose rows a new feed takes over.
        """
        ordered = tuple(name for name in OUTPUT_FIELDS if name in names)
        key = (ordered, rate_hz, keep_rows)
        feed = self._feeds.get(key)
        if feed is None:
            feed = self._feeds[key] = Feed(ordered, keep_rows)
            if predecessor is not None:
                feed.inherit_rows(predecessor)
            self._tasks[id(feed)] = asyncio.create_task(self._follow(feed, rate_hz))
        self._subscriber_counts[id(feed)] = self._subscriber_counts.get(id(feed), 0) + 1
        if (timer := self._lingering.pop(id(feed), None)) is not None:
            timer.cancel()
        return feed

    def unsubscribe(self, feed: Feed, linger_s: float = 0.0) -> None:
        """End a subscription. The last one closes the connection, after ``linger_s``."""
        self._subscriber_counts[id(feed)] -= 1
        if self._subscriber_counts[id(feed)]:
            return
        if linger_s:
            self._lingering[id(feed)] = asyncio.get_running_loop().call_later(linger_s, self._stop, feed)
        else:
            self._stop(feed)

    def __len__(self) -> int:
        return len(self._feeds)

    async def close(self) -> None:
        tasks = list(self._tasks.values())
        for feed in list(self._feeds.values()):
            self._stop(feed)
        await asyncio.gather(*tasks, return_exceptions=True)

    def _stop(self, feed: Feed) -> None:
        if (timer := self._lingering.pop(id(feed), None)) is not None:
            timer.cancel()
        self._tasks.pop(id(feed)).cancel()
        del self._subscriber_counts[id(feed)]
        self._feeds = {key: other for key, other in self._feeds.items() if other is not feed}

    async def _follow(self, feed: Feed, rate_hz: float) -> None:
        async def follow() -> None:
            async with self._open_client(feed.names, rate_hz) as client:
                feed.rate_hz, feed.unavailable = client.core.rate_hz, client.core.unavailable
                while True:
                    feed.append_state(await client.receive())

        await follow_forever(follow, feed.mark_lost)
