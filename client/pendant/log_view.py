"""What one browser shows of the log: those lines that its filter lets through, sent once each."""

import csv
import io
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from itertools import islice
from typing import Any, Final

from client.pendant.events import SEVERITIES, Event, EventLog

__all__ = ["SHOWN", "LogView", "as_csv", "as_text"]

SHOWN: Final = 500  # lines a browser keeps
_LONGEST: Final = 2000  # characters of a line; downloads have all of it


class LogView:
    """severities, words: what passes the filter; words are looked for in text, code and source. paused: nothing new."""

    def __init__(self, log: EventLog) -> None:
        self.severities = set(SEVERITIES)
        self.words = ""
        self.paused = False
        self._log = log
        self._cleared = 0  # number of the last event that is not shown any more
        self._seen = 0
        self._state: object = None

    def clear(self) -> None:
        """Show only what comes from now on; the log itself stays."""
        self._cleared = self._log.count

    @property
    def waiting(self) -> int:
        """How many events came since it was paused."""
        return self._log.count - self._seen if self.paused else 0

    def matching(self) -> list[Event]:
        """All kept events that pass the filter, oldest first, also those cleared from view."""
        return [event for event in self._log.events if self._passes(event)]

    def take(self, fresh: bool) -> list[Any] | None:
        """[whether what is shown goes, lines to add] since this was last asked, None for nothing.

        fresh: the browser has nothing yet.
        """
        state = (self._cleared, self.words, frozenset(self.severities))
        if fresh or state != self._state:
            self._state, self._seen = state, self._log.count
            return [True, [_row(event) for event in self._newest()]]
        if self.paused or self._seen == self._log.count:
            return None
        rows = [_row(event) for event in self._log.since(self._seen) if self._passes(event)]
        self._seen = self._log.count
        return [len(rows) >= SHOWN, rows[-SHOWN:]] if rows else None

    def _newest(self) -> list[Event]:
        shown = (event for event in self._log.latest() if self._passes(event) and event.number > self._cleared)
        return list(islice(shown, SHOWN))[::-1]

    def _passes(self, event: Event) -> bool:
        if event.severity not in self.severities:
            return False
        line = f"{event.source} {event.code} {event.text}".lower()
        return all(word in line for word in self.words.lower().split())


def _row(event: Event) -> list[Any]:
    uptime = "" if event.uptime_s is None else f"{event.uptime_s:.3f}"
    return [round(event.time_s * 1000), uptime, event.severity, event.source, event.code, event.text[:_LONGEST]]


_TITLES: Final = ("time", "uptime_s", "severity", "source", "code", "text")


def as_csv(events: Iterable[Event]) -> str:
    """A table with a head; times are UTC."""
    file = io.StringIO()
    writer = csv.writer(file)
    writer.writerow(_TITLES)
    writer.writerows(_cells(events))
    return file.getvalue()


def as_text(events: Iterable[Event]) -> str:
    """Lines for people; times are UTC."""
    return "".join(
        f"{time} {uptime:>12} {severity:<8}{source:<11}{code:<9}{' '.join(text.splitlines())}\n"
        for time, uptime, severity, source, code, text in _cells(events)
    )


def _cells(events: Iterable[Event]) -> Iterator[tuple[str, ...]]:
    for event in events:
        when = datetime.fromtimestamp(event.time_s, UTC).isoformat(timespec="milliseconds")
        uptime = "" if event.uptime_s is None else f"{event.uptime_s:.3f}"
        yield when, uptime, event.severity, event.source, event.code, event.text
