"""Admission of clients to the ports.

A robot must keep its control period, however many clients connect. So each port accepts a limited number of clients,
and fewer from one address. The last file descriptors of the process are not for clients; otherwise the robot could not
open a program. All ports together accept one connection at a time, at intervals, so that a storm of connections leaves
time for the control period. Clients beyond the limits are accepted and closed, which they notice immediately. They are
counted, and logged: the first one, and then one line per minute.
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

_SPARE_DESCRIPTORS: Final = 32  # reserved for files, scripts and clients' programs (guess)
_SPARE_SHARE: Final = 8  # but at most this fraction of all (guess)
_BETWEEN_CLIENTS_S: Final = 0.002  # a client takes 0.1 to 0.4 ms (measured), and a control period may be 2 ms
_PAUSE_S: Final = 0.5  # before the next attempt if clients cannot even be turned away (guess)
_EXHAUSTED: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_NOTHING_THERE: Final = (BlockingIOError, InterruptedError, ConnectionAbortedError)

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ClientLimits:
    """Maximum number of clients of a port at a time: in total, and from one address.

    Both are far beyond what a cell needs; the limits of a real controller are not known. The difference leaves room for
    others if the program of one client opens connections and never closes them.
    """

    port: int = 256
    address: int = 128

    def broken_by(self, clients: int, from_address: int) -> "Reason | None":
        """The limit that another client would exceed, if any."""
        if clients >= self.port:
            return Reason.PORT_FULL
        return Reason.ADDRESS_FULL if from_address >= self.address else None


class Reason(StrEnum):
    """Reason for turning a client away."""

    HTTP = "http"
    TLS = "tls"
    PORT_FULL = "port full"
    ADDRESS_FULL = "address full"
    NO_DESCRIPTORS = "no descriptors"
    INVALID = "invalid data"
    NOT_READING = "not reading"
    NO_MEMORY = "no memory"
    WRONG_TOKEN = "wrong token"


def _log_once_a_minute(error: OSError) -> None:
    more = _descriptors.throttle.due()
    if more is not None:
        _logger.warning("no client can be accepted: %s%s", error.strerror, more)


class RejectedClients:
    """Counts and logs clients of a port that were turned away, by reason."""

    def __init__(self, port_name: str) -> None:
        self._name = port_name
        self._counts: Counter[Reason] = Counter()
        self._lines: dict[Reason, LogThrottle] = {}

    @property
    def counts(self) -> dict[str, int]:
        """Number of clients for each reason that occurred."""
        return {str(reason): count for reason, count in self._counts.items()}

    def count(self, reason: Reason, peer: str, text: str, throttle: LogThrottle | None = None) -> None:
        """Count a client. text: what happened, and what to do; throttle: limits log lines, by default per reason."""
        self._counts[reason] += 1
        more = (throttle or self._lines.setdefault(reason, LogThrottle(time.monotonic))).due()
        if more is not None:
            _logger.warning("%s: %s %s%s", self._name, peer, text, more)


class _Descriptors:
    """File descriptors of the process, one of them in reserve for turning clients away when no other is left."""

    def __init__(self) -> None:
        self.throttle = LogThrottle(time.monotonic)
        self._users = 0
        self._reserve: int | None = None

    def register(self) -> None:
        self._users += 1
        self._fill()

    def unregister(self) -> None:
        self._users -= 1
        if not self._users:
            self._empty()

    def short(self, newest: int) -> bool:
        """Whether this descriptor, the lowest free one, is one of the last."""
        limit = _most_descriptors()
        return limit is not None and newest >= limit - min(_SPARE_DESCRIPTORS, limit // _SPARE_SHARE)

    def accept_without(self, listening: socket.socket) -> bool:
        """Accept a client with the reserve descriptor and close the connection; return whether that was possible."""
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
    """Schedules the acceptors of the process, so that they accept one after the other."""

    def __init__(self) -> None:
        self._free_s = 0.0

    def next(self, now_s: float) -> float:
        """The time of the next turn, now if possible."""
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
    """Accepts the clients of a listening socket, and closes the socket at the end.

    admit: takes an address and returns why a client is rejected, None to accept it. welcome: takes over a client.
    asyncio's own servers are not used: they accept a hundred clients one after the other, and spin at the limit of
    descriptors.
    """

    def __init__(
        self,
        listening: socket.socket,
        admit: Callable[[str], tuple[Reason, str] | None],
        welcome: Callable[[socket.socket, str], None],
        turned_away: RejectedClients,
    ) -> None:
        listening.setblocking(False)
        self._listening = listening
        self._admit = admit
        self._welcome = welcome
        self._turned_away = turned_away
        self._loop = asyncio.get_running_loop()
        self._accepting: asyncio.Task[None] | None = None
        self._pause: asyncio.TimerHandle | None = None
        _descriptors.register()
        self._watch()

    @property
    def address(self) -> tuple[str, int]:
        """Numeric address and port of the socket."""
        host, port, *_ = self._listening.getsockname()
        return host, port

    def close(self) -> None:
        """Stop accepting: the system refuses new clients."""
        if self._pause is not None:
            self._pause.cancel()
        elif self._accepting is not None:
            self._accepting.cancel()
        else:
            self._loop.remove_reader(self._listening)
        self._listening.close()
        _descriptors.unregister()

    def _watch(self) -> None:
        self._pause = None
        try:
            self._loop.add_reader(self._listening, self._on_client)
        except NotImplementedError:  # the event loop of Windows cannot watch sockets
            self._accepting = self._loop.create_task(self._accept_all())

    def _on_client(self) -> None:
        """Accept a waiting client, now or when it is this port's turn."""
        now_s = self._loop.time()
        turn_s = _turns.next(now_s)
        if turn_s > now_s:
            self._wait(turn_s)
        else:
            self._accept()

    def _wait(self, until_s: float) -> None:
        self._loop.remove_reader(self._listening)
        self._pause = self._loop.call_at(until_s, self._resume)

    def _resume(self) -> None:
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
                _log_once_a_minute(error)
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
        """Turn the client away or wait: otherwise it would make the event loop spin."""
        if error.errno in _EXHAUSTED and _descriptors.accept_without(self._listening):
            self._no_descriptors("a client")
            return
        _log_once_a_minute(error)
        self._wait(self._loop.time() + _PAUSE_S)

    def _no_descriptors(self, peer: str) -> None:
        self._turned_away.count(
            Reason.NO_DESCRIPTORS,
            peer,
            f"was turned away: the process may have {_most_descriptors()} files and connections, and the last ones are "
            "reserved for the robot. Close clients that are not needed, or raise the limit (ulimit -n)",
            _descriptors.throttle,
        )
