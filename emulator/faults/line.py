"""Faults of bytes in transit. Bytes of a connection never overtake each other."""

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal

from msgspec import Meta

from emulator.faults.fault import Act, Share, Site, Strikes, added, register
from emulator.faults.network import ClientFault, NotNegative
from emulator.servers.connection import Connection
from emulator.servers.hooks import Direction

Positive = Annotated[float, Meta(gt=0.0)]
_MAX_KEPT: Final = 256 * 1024  # bytes held back of a client, beyond which no more are read from it
_PACKAGE: Final = "each package: bytes sent, or received, at one time"


class Link:
    """The bytes that a fault holds back in one direction of a connection, with the period in which they are due."""

    def __init__(self, connection: Connection, direction: Direction) -> None:
        self.connection = connection
        self.direction = direction
        self.waiting: deque[tuple[int, bytes]] = deque()
        self.size = 0
        self.credit = 0.0  # bytes that a line with limited bandwidth may carry now

    def keep(self, due: int, data: bytes) -> None:
        """Hold bytes back, behind those that already wait."""
        self.waiting.append((max(due, self.waiting[-1][0]) if self.waiting else due, data))
        self._count(len(data))
        self.connection.keep(self.direction, len(data))

    def take(self, now: int) -> bytes:
        data = b""
        while self.waiting and self.waiting[0][0] <= now:
            data += self.waiting.popleft()[1]
        return data

    def take_bytes(self, most: int) -> bytes:
        """Take the oldest bytes, due or not."""
        data = b"".join(data for _, data in self.waiting)
        self.waiting = deque([(0, data[most:])] if data[most:] else [])
        return data[:most]

    def release(self, data: bytes, line: "Line") -> None:
        self._count(-len(data))
        self.connection.pass_on(self.direction, data, line.hook)

    def _count(self, change: int) -> None:
        self.size += change
        if self.direction is Direction.RECEIVED:
            self.connection.stall(self) if self.size > _MAX_KEPT else self.connection.unstall(self)


class Line:
    """A fault in force, with the links in which bytes wait."""

    def __init__(self, fault: "LineFault", site: Site, strikes: Strikes) -> None:
        self.now = 0
        self.strikes = strikes
        self.periods: Callable[[float], int] = site.periods
        self.period_s = site.controller.period_s
        self._fault = fault
        self._ending = False
        self._links: dict[tuple[Connection, Direction], Link] = {}

    @property
    def empty(self) -> bool:
        return not any(link.waiting for link in self._links.values())

    def hook(self, connection: Connection, direction: Direction, data: bytes) -> bytes:
        """The bytes that pass immediately."""
        if self._fault.direction not in (direction.value, "both") or not self._fault.concerns(connection):
            return data
        link = self._links.get((connection, direction))
        if self._ending:
            return self._queue_behind(link, data)
        if link is None:
            link = self._links[connection, direction] = Link(connection, direction)
        return self._fault.change(self, link, data)

    def step(self) -> None:
        """Forward what is due, at the end of a control period."""
        self.now += 1
        for key, link in tuple(self._links.items()):
            if not link.connection.is_open:
                del self._links[key]
            elif link.waiting and (data := self._fault.due(self, link)):
                link.release(data, self)

    def flush(self) -> None:
        """Forward everything that waits; answers to it stay behind what already waits in their direction."""
        self._ending = True
        while self._links:
            _, link = self._links.popitem()
            if data := link.take_bytes(link.size):
                link.release(data, self)
            link.connection.unstall(link)

    def _queue_behind(self, link: Link | None, data: bytes) -> bytes:
        if link is None or not link.waiting:
            return data
        link.keep(0, data)
        return b""


@dataclass(frozen=True, kw_only=True)
class LineFault(ClientFault):
    """A fault of bytes. direction: of bytes that the robot sends, receives, or both."""

    direction: Literal["sent", "received", "both"] = "sent"

    @abstractmethod
    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        """The bytes of a package that pass immediately."""

    def due(self, line: Line, link: Link) -> bytes:
        """The bytes held back that pass now."""
        return link.take(line.now)

    def act(self, site: Site, strikes: Strikes) -> Act:
        line = Line(self, site, strikes)
        with ExitStack() as hooks:
            for server in self.servers(site):
                hooks.enter_context(added(server.hooks.on_bytes, line.hook))
            hooks.callback(line.flush)
            while not (strikes.spent and line.empty):
                yield
                line.step()


@register
class Stall(LineFault):
    """The cable is unplugged: nothing passes and no connection ends; when the fault ends, what waited arrives."""

    direction: Literal["sent", "received", "both"] = "both"

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        link.keep(0, data)
        return b""

    def due(self, line: Line, link: Link) -> bytes:
        return b""

    def act(self, site: Site, strikes: Strikes) -> Act:
        unread: set[Connection] = set()
        line = super().act(site, strikes)
        try:
            for _ in line:
                if self.direction != "sent":
                    unread = set(self.connections(site))
                for connection in unread:
                    connection.stall(strikes)
                yield
        finally:
            for connection in unread:
                connection.unstall(strikes)
            line.close()


@register
class Delay(LineFault):
    """Bytes arrive ``delay_s`` late, plus a random delay of up to ``jitter_s``, in whole control periods."""

    occasion: ClassVar[str] = _PACKAGE
    delay_s: NotNegative
    jitter_s: NotNegative = 0.0

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        struck = line.strikes()
        if not struck and not link.waiting:
            return data
        late_s = self.delay_s + line.strikes.random.random() * self.jitter_s if struck else 0.0
        link.keep(line.now + line.periods(late_s), data)
        return b""


@register
class LimitBandwidth(LineFault):
    """The line carries at most ``bytes_per_s`` for each client."""

    bytes_per_s: Positive

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        link.keep(0, data)
        return b""

    def due(self, line: Line, link: Link) -> bytes:
        link.credit = min(link.credit, 1.0) + self.bytes_per_s * line.period_s
        data = link.take_bytes(int(link.credit))
        link.credit -= len(data)
        return data


@register
class Split(LineFault):
    """A package arrives in two parts, split at a random place, one control period apart."""

    occasion: ClassVar[str] = _PACKAGE

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        if link.waiting:
            link.keep(line.now + 1, data)
            return b""
        if len(data) < len("ab") or not line.strikes():
            return data
        place = line.strikes.random.randrange(1, len(data))
        link.keep(line.now + 1, data[place:])
        return data[:place]


@register
class Coalesce(LineFault):
    """All packages of a time ``wait_s`` arrive together."""

    occasion: ClassVar[str] = "each package before which none waits"
    wait_s: Positive = 0.1

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        if not link.waiting and not line.strikes():
            return data
        link.keep(line.now + line.periods(self.wait_s) if not link.waiting else 0, data)
        return b""


@register
class Duplicate(LineFault):
    """A package arrives twice."""

    occasion: ClassVar[str] = _PACKAGE

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        return data + data if line.strikes() else data


@register
class Garble(LineFault):
    """Bits flip: each byte of a package is wrong with probability ``rate``, and at least one byte is."""

    occasion: ClassVar[str] = _PACKAGE
    rate: Share = 0.001

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        if not line.strikes():
            return data
        chance = line.strikes.random
        wrong = {place for place in range(len(data)) if chance.random() < self.rate} or {chance.randrange(len(data))}
        return bytes(byte ^ 1 << chance.randrange(8) if place in wrong else byte for place, byte in enumerate(data))


@register
class Truncate(LineFault):
    """The last bytes of a package are lost; the next bytes follow in their place."""

    occasion: ClassVar[str] = _PACKAGE
    lost_bytes: Annotated[int, Meta(ge=1)] = 1

    def change(self, line: Line, link: Link, data: bytes) -> bytes:
        return data[: -self.lost_bytes] if line.strikes() else data
