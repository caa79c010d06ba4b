"""Limit on the number of state packages that are sent in one control period.

Sending a package takes some microseconds, so a few hundred clients of the state ports would use up the whole control
period of an e-Series. They take turns instead: clients that are not served in a period come first in the next one, and
then get the newest state. As long as the limit is not reached, each package is sent immediately.
"""

from collections.abc import Sequence
from typing import Final, Protocol

PACKAGES_PER_SECOND: Final = 15_000
"""30 per control period of an e-Series arm, 120 of a CB3 arm: they take about a tenth of it (guess), and are enough for
100 clients at 125 Hz."""


class _Listener(Protocol):
    @property
    def takes_state(self) -> bool: ...

    def send_state(self, data: bytes) -> None: ...

    def skip_state(self) -> None: ...


class SendScheduler:
    """Sends state to clients in turns.

    period_s: length of a control period [s]; None for no limit.
    """

    def __init__(self, period_s: float | None = None) -> None:
        self._most = None if period_s is None else max(1, round(PACKAGES_PER_SECOND * period_s))
        self._left = 0
        self._step = -1
        self._waiting: dict[_Listener, Sequence[bytes]] = {}  # the one that waits longest comes first

    def send(self, step: int, listener: _Listener, *packages: bytes) -> None:
        """Send a client the packages of this control period, now or in a later one unless newer ones supersede them."""
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
        """Serve the clients that wait, if a new control period has begun."""
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
        """Drop what waits for a client that has been served otherwise, or is gone."""
        self._waiting.pop(listener, None)


def _serve(listener: _Listener, packages: Sequence[bytes]) -> None:
    for package in packages:
        listener.send_state(package)
