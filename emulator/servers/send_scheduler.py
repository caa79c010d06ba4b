"""Limit on the number of state packages that are sent in one control period.

Sending a package takes some microseconds, so a few hundred clients of the state ports would use up the whole control
period of an e-Series. They take turns instead: clients that are not served in a period come first in the next one, and
then get the newest state. As long as the limit is not reached, each package is sent immediately.
"""

from collections import OrderedDict
from collections.abc import Sequence
from typing import Final, Protocol

PACKAGES_PER_SECOND: Final = 15_000
"""For control loops (RTDE): 30 per control period of an e-Series arm, 120 of a CB3 arm, which is enough for 100 clients
at 125 Hz (guess: about a tenth of a period, a third on a slow machine)."""
STATES_PER_SECOND: Final = 7_500
"""For everybody who only watches (primary, secondary and realtime interface): 15 and 60 in a control period (guess)."""


class _Listener(Protocol):
    @property
    def takes_state(self) -> bool: ...

    def send_state(self, data: bytes) -> None: ...

    def skip_state(self) -> None: ...


_LOOKS_PER_PACKAGE: Final = 4
"""Clients that do not read may be checked this many times as often as packages may be sent: a check is cheaper by more
than that (guess: a property instead of a system call)."""


class StateFeed:
    """What a port sends to all of its clients in every control period.

    Publishing costs no more than the packages that are sent, however many clients there are: those that wait for
    their turn, or have stopped reading, are not touched, and get what is newest when their turn comes.
    """

    def __init__(self) -> None:
        self.newest: Sequence[bytes] = ()
        self.up_to_date: list[_Listener] = []  # those that got the last packages

    def remove(self, listener: _Listener) -> None:
        """Forget a client that has disconnected; `SendScheduler.forget` does so for one that waits."""
        if listener in self.up_to_date:
            self.up_to_date.remove(listener)


class SendScheduler:
    """Sends state to clients in turns.

    period_s: length of a control period [s]; None for no limit. packages_per_second: the limit.
    """

    def __init__(self, period_s: float | None = None, packages_per_second: int = PACKAGES_PER_SECOND) -> None:
        self._most = None if period_s is None else max(1, round(packages_per_second * period_s))
        self._left = 0
        self._step = -1
        # The one that waits longest comes first; a plain dict would search for its first entry again and again.
        self._waiting: OrderedDict[_Listener, Sequence[bytes] | StateFeed] = OrderedDict()

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

    def publish(self, step: int, feed: StateFeed, *packages: bytes) -> None:
        """Send all clients of a feed the packages of this control period, as far as the limit goes."""
        feed.newest = packages
        listeners, feed.up_to_date = feed.up_to_date, []  # before those that wait join them: they get this package too
        self.next_period(step)
        for listener in listeners:
            if self._most is not None and self._left <= 0:
                self._waiting[listener] = feed
            else:
                self._serve_feed(listener, feed)

    def next_period(self, step: int) -> None:
        """Serve the clients that wait, if a new control period has begun."""
        if step == self._step:
            return
        self._step = step
        checks = len(self._waiting)
        if self._most is not None:
            self._left = min(self._most, self._left + self._most)
            checks = min(checks, _LOOKS_PER_PACKAGE * self._most)
        while checks > 0 and (self._most is None or self._left > 0):
            checks -= 1
            listener, due = self._waiting.popitem(last=False)
            if isinstance(due, StateFeed):
                self._serve_feed(listener, due)
            elif listener.takes_state:
                self._left -= len(due)
                _serve(listener, due)

    def _serve_feed(self, listener: _Listener, feed: StateFeed) -> None:
        if listener.takes_state:
            self._left -= len(feed.newest)
            _serve(listener, feed.newest)
            feed.up_to_date.append(listener)
        else:
            listener.skip_state()
            self._waiting[listener] = feed

    def forget(self, listener: _Listener) -> None:
        """Drop what waits for a client that has been served otherwise, or is gone."""
        self._waiting.pop(listener, None)


def _serve(listener: _Listener, packages: Sequence[bytes]) -> None:
    for package in packages:
        listener.send_state(package)
