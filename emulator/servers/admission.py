"""Who is let in at a port, and who is turned away.

A robot has to keep its pace whoever knocks. So each port takes a number of clients, and a smaller number from one
address. The last descriptors of the process are not for clients, or the robot could not open a program any more. One
connection is accepted a millisecond, at whichever port, so that a storm of them leaves the tick its time. Those beyond
are accepted and closed, which they notice at once. Whoever is turned away is counted, and told in the log: the first
one, and then a line a minute.
"""

import asyncio
import errno
import logging
import os
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from urproto.compat import StrEnum
from urproto.log_throttle import LogThrottle

_SPARE_DESCRIPTORS: Final = 32  # for files, scripts and clients' programs: not given to clients (guess)
_SPARE_SHARE: Final = 8  # but no more than this part of all (guess)
_BETWEEN_CLIENTS_S: Final = 0.001  # a client costs 0.1 to 0.2 ms (measured), and a period may have 2 ms
_PAUSE_S: Final = 0.5  # before the next attempt when nobody can even be turned away (guess)
_EXHAUSTED: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_NOTHING_THERE: Final = (BlockingIOError, InterruptedError, ConnectionAbortedError)

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ClientLimits:
    """How many clients one port has at a time: in all, and from one address.

    Both are far beyond what a cell needs; what a controller takes is not known. The difference is for others than the
    one whose program opens connections and never closes them.
    """

    port: int = 256
    address: int = 128

    def broken_by(self, clients: int, from_address: int) -> "Reason | None":
        """Why one more does not come in when there are so many."""
        if clients >= self.port:
            return Reason.PORT_FULL
        return Reason.ADDRESS_FULL if from_address >= self.address else None


class Reason(StrEnum):
    """Why a client was turned away."""

    HTTP = "http"
    TLS = "tls"
    PORT_FULL = "port full"
    ADDRESS_FULL = "address full"
    NO_DESCRIPTORS = "no descriptors"


def _tell_once_a_minute(error: OSError) -> None:
    more = _descriptors.throttle.due()
    if more is not None:
        _logger.warning("no client can be accepted: %s%s", error.strerror, more)


class TurnedAway:
    """Clients of one port that were turned away, by reason."""

    def __init__(self, port_name: str) -> None:
        self._name = port_name
        self._counts: Counter[Reason] = Counter()
        self._lines: dict[Reason, LogThrottle] = {}

    @property
    def counts(self) -> dict[str, int]:
        """How many for each reason there was."""
        return {str(reason): count for reason, count in self._counts.items()}

    def count(self, reason: Reason, peer: str, text: str, throttle: LogThrottle | None = None) -> None:
        """One more. text: what happened and what to do about it; throttle: who logs it, if not each port and reason."""
        self._counts[reason] += 1
        more = (throttle or self._lines.setdefault(reason, LogThrottle(time.monotonic))).due()
        if more is not None:
            _logger.warning("%s: %s %s%s", self._name, peer, text, more)


class _Descriptors:
    """Those of the process: how many are left, and one in reserve for turning clients away when none is."""

    def __init__(self) -> None:
        self.throttle = LogThrottle(time.monotonic)
        self._users = 0
        self._reserve: int | None = None

    def take_part(self) -> None:
        """Somebody listens: there has to be a reserve."""
        self._users += 1
        self._fill()

    def leave(self) -> None:
        """Somebody listens no longer."""
        self._users -= 1
        if not self._users:
            self._empty()

    def short(self, newest: int) -> bool:
        """Whether this descriptor, the lowest that was free, is one of the last."""
        limit = _most_descriptors()
        return limit is not None and newest >= limit - min(_SPARE_DESCRIPTORS, limit // _SPARE_SHARE)

    def accept_without(self, listening: socket.socket) -> bool:
        """Accept one client in the place of the reserve and close the connection. Whether that was possible."""
        self._empty()
        try:
            client, _ = listening.accept()
            client.close()
        except _NOTHING_THERE:
            pass
        except OSError:
            return False
        finally:
            self._fill()
        return True

    def _fill(self) -> None:
        if self._reserve is None:
            with suppress(OSError):
                self._reserve = os.open(os.devnull, os.O_RDONLY)

    def _empty(self) -> None:
        if self._reserve is not None:
            os.close(self._reserve)
            self._reserve = None


class _Turns:
    """When the acceptors of the process accept, one after the other."""

    def __init__(self) -> None:
        self._free_s = 0.0

    def next(self, now_s: float) -> float:
        """The time of the next turn, now if that is possible."""
        turn_s = max(now_s, self._free_s)
        self._free_s = turn_s + _BETWEEN_CLIENTS_S
        return turn_s


_descriptors: Final = _Descriptors()
_turns: Final = _Turns()


def _most_descriptors() -> int | None:
    if sys.platform == "win32":
        return None
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if limit == resource.RLIM_INFINITY else limit


class Acceptor:
    """Accepts the clients of one listening socket, which it closes in the end.

    admit: gets the address and says what keeps a client out, None for nothing. welcome: takes one over.
    asyncio's own servers accept a hundred clients in a row, and spin at the limit of descriptors.
    """

    def __init__(
        self,
        listening: socket.socket,
        admit: Callable[[str], tuple[Reason, str] | None],
        welcome: Callable[[socket.socket, str], None],
        turned_away: TurnedAway,
    ) -> None:
        listening.setblocking(False)
        self._listening = listening
        self._admit = admit
        self._welcome = welcome
        self._turned_away = turned_away
        self._loop = asyncio.get_running_loop()
        self._accepting: asyncio.Task[None] | None = None
        self._pause: asyncio.TimerHandle | None = None
        _descriptors.take_part()
        self._watch()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: numeric address and port."""
        host, port, *_ = self._listening.getsockname()
        return host, port

    def close(self) -> None:
        """Let nobody in any more; the system refuses who comes."""
        if self._pause is not None:
            self._pause.cancel()
        elif self._accepting is not None:
            self._accepting.cancel()
        else:
            self._loop.remove_reader(self._listening)
        self._listening.close()
        _descriptors.leave()

    def _watch(self) -> None:
        self._pause = None
        try:
            self._loop.add_reader(self._listening, self._knock)
        except NotImplementedError:  # the event loop of Windows watches no sockets
            self._accepting = self._loop.create_task(self._accept_all())

    def _knock(self) -> None:
        """Somebody waits: accept one, now or when it is this port's turn."""
        now_s = self._loop.time()
        turn_s = _turns.next(now_s)
        if turn_s > now_s:
            self._wait(turn_s)
        else:
            self._accept()

    def _wait(self, until_s: float) -> None:
        self._loop.remove_reader(self._listening)
        self._pause = self._loop.call_at(until_s, self._go_on)

    def _go_on(self) -> None:
        self._watch()
        self._accept()

    def _accept(self) -> None:
        try:
            client, address = self._listening.accept()
        except _NOTHING_THERE:
            return
        except OSError as error:
            self._failed(error)
            return
        self._take(client, address)

    async def _accept_all(self) -> None:
        while True:
            await asyncio.sleep(_turns.next(self._loop.time()) - self._loop.time())
            try:
                self._take(*await self._loop.sock_accept(self._listening))
            except OSError as error:
                _tell_once_a_minute(error)
                await asyncio.sleep(_PAUSE_S)

    def _take(self, client: socket.socket, address: tuple[str, int]) -> None:
        host, port, *_ = address
        if _descriptors.short(client.fileno()):
            client.close()
            self._no_descriptors(f"{host}:{port}")
        elif (refusal := self._admit(host)) is not None:
            client.close()
            self._turned_away.count(refusal[0], f"{host}:{port}", refusal[1])
        else:
            client.setblocking(False)
            self._welcome(client, host)

    def _failed(self, error: OSError) -> None:
        """Whoever waits there would make the event loop spin."""
        if error.errno in _EXHAUSTED and _descriptors.accept_without(self._listening):
            self._no_descriptors("a client")
            return
        _tell_once_a_minute(error)
        self._wait(self._loop.time() + _PAUSE_S)

    def _no_descriptors(self, peer: str) -> None:
        self._turned_away.count(
            Reason.NO_DESCRIPTORS,
            peer,
            f"was turned away: the process may have {_most_descriptors()} files and connections, and the last ones are "
            "the robot's. Close clients that are not needed, or raise the limit (ulimit -n)",
            _descriptors.throttle,
        )
