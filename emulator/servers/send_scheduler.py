"""Limits the number of state packages that are sent in one control period.

Sending a package takes some microseconds, so a few hundred clients of the state ports would use up the whole control
period of an e-Series. They take turns instead: clients that are not served in a period come first in the next one, and
then get the newest state. As long as the limit is not reached, each package is sent immediately.
"""

from collections import OrderedDict, deque
from collections.abc import Sequence
from typing import Final, Protocol

PACKAGES_PER_SECOND: Final = 15_000
"""For control loops (RTDE): 30 per control period of an e-Series arm, 120 of a CB3 arm, which is enough for 100 clients
at 125 Hz (guess: about a tenth of a period, a third on a slow machine)."""
STATES_PER_SECOND: Final = 7_500
"""For clients that only monitor (primary, secondary and realtime interface): 15 per control period of an e-Series arm,
60 of a CB3 arm (guess)."""

_CHECKS_PER_PACKAGE: Final = 4
"""Per period, this many times as many waiting clients may be checked as packages may be sent: a check (of a property)
costs less than a quarter of a package (a system call), which is a guess."""


class _Client(Protocol):
    @property
    def takes_state(self) -> bool: ...

    def send_state(self, data: bytes) -> None: ...

    def skip_state(self) -> None: ...


class StateFeed:
    """The packages that a port sends to all of its clients in every control period.

    The cost of publishing depends on the number of packages that are sent, not on the number of clients. Clients that
    wait for their turn or have stopped reading cost nothing; when their turn comes, they get the newest packages.
    """

    def __init__(self) -> None:
        self.newest: Sequence[bytes] = ()
        self.up_to_date: list[_Client] = []  # clients that got the last packages

    def remove(self, client: _Client) -> None:
        """Remove a client that has disconnected; `SendScheduler.remove` does the same for a waiting one."""
        if client in self.up_to_date:
            self.up_to_date.remove(client)


class SendScheduler:
    """Sends state to clients in turns.

    period_s: length of a control period [s]; None for no limit. packages_per_second: the limit.
    """

    def __init__(self, period_s: float | None = None, packages_per_second: int = PACKAGES_PER_SECOND) -> None:
        self._most = None if period_s is None else max(1, round(packages_per_second * period_s))
        self._left = 0
        self._step = -1
        # The client that has waited longest comes first. In a plain dict, each removal of the first entry would have to
        # skip the entries that were removed before.
        self._waiting: OrderedDict[_Client, Sequence[bytes] | StateFeed] = OrderedDict()

    def send(self, step: int, client: _Client, *packages: bytes) -> None:
        """Send a client the packages of this control period, now or later; newer packages replace waiting ones."""
        if self._most is None:
            _serve(client, packages)
            return
        self.next_period(step)
        if not client.takes_state:
            self._waiting.pop(client, None)
            client.skip_state()
        elif client in self._waiting or self._left <= 0:
            self._waiting[client] = packages
        else:
            self._left -= len(packages)
            _serve(client, packages)

    def publish(self, step: int, feed: StateFeed, *packages: bytes) -> None:
        """Send all clients of a feed the packages of this control period, up to the limit."""
        feed.newest = packages
        # taken before `next_period` adds the clients that waited: they get these packages there
        clients, feed.up_to_date = deque(feed.up_to_date), []
        try:
            self.next_period(step)
            while clients:
                client = clients.popleft()
                if self._most is not None and self._left <= 0:
                    self._waiting[client] = feed
                else:
                    self._serve_feed(client, feed)
        finally:
            feed.up_to_date.extend(clients)  # if one client raised an error, the others are served in the next period

    def next_period(self, step: int) -> None:
        """Serve the waiting clients if a new control period has begun."""
        if step == self._step:
            return
        self._step = step
        checks = len(self._waiting)
        if self._most is not None:
            self._left = min(self._most, self._left + self._most)
            checks = min(checks, _CHECKS_PER_PACKAGE * self._most)
        while checks > 0 and (self._most is None or self._left > 0):
            checks -= 1
            client, due = self._waiting.popitem(last=False)
            if isinstance(due, StateFeed):
                self._serve_feed(client, due)
            elif client.takes_state:
                self._left -= len(due)
                _serve(client, due)

    def _serve_feed(self, client: _Client, feed: StateFeed) -> None:
        if client.takes_state:
            self._left -= len(feed.newest)
            feed.up_to_date.append(client)  # before it is served, so that it stays even if that fails
            _serve(client, feed.newest)
        else:
            client.skip_state()
            self._waiting[client] = feed

    def remove(self, client: _Client) -> None:
        """Drop the waiting packages of a client that was served in another way or has disconnected."""
        self._waiting.pop(client, None)


def _serve(client: _Client, packages: Sequence[bytes]) -> None:
    for package in packages:
        client.send_state(package)
