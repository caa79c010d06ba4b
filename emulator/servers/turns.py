"""How many packages of state leave in one control period, whoever listens.

Sending one costs some microseconds, so that a few hundred clients of the state ports would take all of an e-Series'
period. They take turns instead: who is not served in a period is the first in the next, and gets what is newest then.
As long as there are no more packages than a period bears, each is sent at once.
"""

from collections.abc import Sequence
from typing import Final, Protocol

PACKAGES_PER_SECOND: Final = 15_000
"""30 in a period of an e-Series arm, 120 in one of a CB3 arm: about a tenth of it (guess), and enough for 100 clients
at 125 Hz."""


class _Listener(Protocol):
    @property
    def takes_state(self) -> bool: ...

    def send_state(self, data: bytes) -> None: ...

    def skip_state(self) -> None: ...


class Turns:
    """Sends state to clients in turns.

    period_s: length of a control period [s]; None: everybody is served at once.
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._most = None if period_s is None else max(1, round(PACKAGES_PER_SECOND * period_s))
        self._left = 0
        self._step = -1
        self._waiting: dict[_Listener, Sequence[bytes]] = {}  # who waits longest is first

    def send(self, step: int, listener: _Listener, *packages: bytes) -> None:
        """Send what a client is to see in this control period, now or in one of the next, unless it is superseded."""
        if self._most is None:
            _serve(listener, packages)
            return
        self.next_period(step)
        if not listener.takes_state:
            self._waiting.pop(listener, None)
            listener.skip_state()
        elif listener in self._waiting or self._left <= 0:
            self._waiting[listener] = packages
        else:
            self._left -= len(packages)
            _serve(listener, packages)

    def next_period(self, step: int) -> None:
        """Serve those who waited, if this is another control period."""
        if self._most is None or step == self._step:
            return
        self._step, self._left = step, min(self._most, self._left + self._most)
        while self._waiting and self._left > 0:
            listener = next(iter(self._waiting))
            packages = self._waiting.pop(listener)
            if listener.takes_state:
                self._left -= len(packages)
                _serve(listener, packages)

    def forget(self, listener: _Listener) -> None:
        """A client got what it is to see in another way, or is gone."""
        self._waiting.pop(listener, None)


def _serve(listener: _Listener, packages: Sequence[bytes]) -> None:
    for package in packages:
        listener.send_state(package)
