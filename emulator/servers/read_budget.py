"""Limit on the processor time that is spent on reading what clients send.

Reading and parsing costs next to nothing for an ordinary client. A client that floods a port, however, would take all
of the core, above all where this process has real-time priority. So all connections share a fraction of the time. Data
beyond that stays in the system's buffers, and TCP slows the client down.
"""

import asyncio
import time
from typing import Final, Protocol

SHARE: Final = 0.25
"""Fraction of a core (guess): what remains next to a program that computes and another that is being compiled."""


class _Stallable(Protocol):
    def stall(self, reason: object) -> None: ...

    def unstall(self, reason: object) -> None:
        """Continue: read, and serve what was read before."""


class ReadBudget:
    """The processor time that connections may use for reading. A connection that exceeds it is stalled for a while.

    period_s: time over which unused budget accumulates [s]; None for no limit. used_s: time spent since the start [s].
    deferred: how often a connection had to wait.
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._period_s = period_s
        self._left_s = 0.0
        self._looked_s = time.monotonic() - (period_s or 0.0)
        self._waiting: list[_Stallable] = []
        self.used_s = 0.0
        self.deferred = 0

    def admits(self, connection: _Stallable) -> bool:
        """Whether a connection may be served; otherwise it is stalled until it may try again. Needs an event loop."""
        if self._period_s is None:
            return True
        self._save()
        if self._left_s > 0.0:
            return True
        self._stall(connection)
        return False

    def spent(self, connection: _Stallable, seconds: float) -> None:
        """Charge the processor time of reading from a connection, and stall it if none is left. Needs an event loop."""
        self.used_s += seconds
        if self._period_s is None:
            return
        self._save()
        self._left_s -= seconds
        if self._left_s <= 0.0:
            self._stall(connection)

    def _save(self) -> None:
        assert self._period_s is not None
        now_s = time.monotonic()
        self._left_s = min(SHARE * self._period_s, self._left_s + SHARE * (now_s - self._looked_s))
        self._looked_s = now_s

    def _stall(self, connection: _Stallable) -> None:
        assert self._period_s is not None
        self.deferred += 1
        connection.stall(self)
        self._waiting.append(connection)
        if len(self._waiting) == 1:
            wait_s = self._period_s - self._left_s / SHARE
            asyncio.get_running_loop().call_later(wait_s, self._resume)

    def _resume(self) -> None:
        waiting, self._waiting = self._waiting, []
        for connection in waiting:
            connection.unstall(self)
