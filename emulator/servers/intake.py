"""How much of a control period the clients of an emulator may take by what they send.

Reading, cutting into messages and handing over costs so little for a client of any use that nobody notices, and so
much for one that floods a port that nothing else would happen any more, least of all on a core where this process runs
before all others. So all connections share a part of each control period; what they would take beyond that stays with
the system, and the client is slowed down by its own TCP.
"""

import math
from typing import Final, Protocol

__all__ = ["SHARE", "Intake"]

SHARE: Final = 0.25
"""Of a control period, in processor time (guess): as much as is left beside a busy program and one being compiled."""


class _Stallable(Protocol):
    def stall(self, reason: object) -> None: ...

    def unstall(self, reason: object) -> None: ...


class Intake:
    """The part of one control period after the other that connections may use up; one more is paid back first.

    budget_s: processor time a period [s]; without one, nothing is limited.
    """

    def __init__(self, budget_s: float = math.inf) -> None:
        self._budget_s = self._left_s = budget_s
        self._waiting: list[_Stallable] = []

    def spent(self, connection: _Stallable, seconds: float) -> None:
        """Reading from a connection took so long; when nothing is left, it waits for another period."""
        self._left_s -= seconds
        if self._left_s <= 0.0:
            connection.stall(self)
            self._waiting.append(connection)

    def new_period(self) -> None:
        """Another control period, another share."""
        self._left_s = min(self._budget_s, self._left_s + self._budget_s)
        if self._waiting and self._left_s > 0.0:
            waiting, self._waiting = self._waiting, []
            for connection in waiting:
                connection.unstall(self)
