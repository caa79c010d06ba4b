"""How much of its core the clients of an emulator may take by what they send.

Reading, cutting into messages and handing over costs so little for a client of any use that nobody notices, and so
much for one that floods a port that nothing else would happen any more, least of all on a core where this process runs
before all others. So all connections share a part of the time; what would take more of it stays with the system, and
the client is slowed down by its own TCP.
"""

import asyncio
import time
from typing import Final, Protocol

SHARE: Final = 0.25
"""Of a core (guess): as much as is left beside a program that computes and one that is compiled."""


class _Stallable(Protocol):
    def stall(self, reason: object) -> None: ...

    def unstall(self, reason: object) -> None: ...


class Intake:
    """The processor time that connections may use for reading: a share of all time; who overdraws it waits.

    period_s: how much time may be saved up [s]; None: nothing is limited.
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._period_s = period_s
        self._left_s = 0.0
        self._looked_s = time.monotonic() - (period_s or 0.0)
        self._waiting: list[_Stallable] = []

    def spent(self, connection: _Stallable, seconds: float) -> None:
        """Reading from a connection took so much processor time; when nothing is left, it waits. In an event loop."""
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
            asyncio.get_running_loop().call_later(wait_s, self._go_on)

    def _go_on(self) -> None:
        waiting, self._waiting = self._waiting, []
        for connection in waiting:
            connection.unstall(self)
