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

    def unstall(self, reason: object) -> None: ...


class ReadBudget:
    """The processor time that connections may use for reading. A connection that exceeds it is stalled for a while.

    period_s: time over which unused budget accumulates [s]; None for no limit.
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._period_s = period_s
        self._left_s = 0.0
        self._looked_s = time.monotonic() - (period_s or 0.0)
        self._waiting: list[_Stallable] = []

    def spent(self, connection: _Stallable, seconds: float) -> None:
        """Charge the processor time of reading from a connection, and stall it if none is left. Needs an event loop."""
        if self._period_s is None:
            return
        now_s = time.monotonic()
        saved_s = self._left_s + SHARE * (now_s - self._looked_s)
        self._left_s, self._looked_s = min(SHARE * self._period_s, saved_s) - seconds, now_s
        if self._left_s > 0.0:
            return
        connection.stall(self)
        self._waiting.append(connection)
        if len(self._waiting) == 1:
            wait_s = self._period_s - self._left_s / SHARE
            asyncio.get_running_loop().call_later(wait_s, self._resume)

    def _resume(self) -> None:
        waiting, self._waiting = self._waiting, []
        for connection in waiting:
            connection.unstall(self)
