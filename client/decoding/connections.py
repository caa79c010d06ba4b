"""Assemble byte streams of TCP connections from segments captured in any order.

The bytes of a direction are returned in order, each once. Across directions, a segment waits for the bytes that its
sender had acknowledged, so a request comes before its reply regardless of the order of the packets. Missing bytes are
given up as lost when too much waits for them, and the stream continues after them.
"""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field

from client.decoding.packets import SocketAddress, TcpSegment

MAX_CONNECTIONS = 256  # tracked at the same time; beyond that, the one that was silent longest is dropped
_MAX_HELD = 256  # segments
_MAX_HELD_BYTES = 1 << 18
_MAX_WAIT_NS = 2_000_000_000  # of the capture's time; guess: a lost segment is retransmitted sooner
_START_SEGMENTS = 64  # segments without a SYN, or time, after which a connection counts as older than the capture
_START_NS = 1_000_000_000
_NUMBERS = 1 << 32


@dataclass(frozen=True, slots=True)
class Data:
    """Bytes of one direction, in order."""

    source: SocketAddress
    data: bytes
    time_ns: int | None


@dataclass(frozen=True, slots=True)
class Gap:
    """This many bytes of a direction are not in the capture."""

    source: SocketAddress
    size: int
    time_ns: int | None


@dataclass(frozen=True, slots=True)
class Closed:
    """This end sends no more data."""

    source: SocketAddress
    time_ns: int | None


Event = Data | Gap | Closed
Ends = frozenset[SocketAddress]


def opens(segment: TcpSegment) -> bool:
    """Whether a segment is the first of a connection."""
    return segment.syn and segment.ack is None


def possible_servers(segment: TcpSegment) -> list[SocketAddress]:
    """The possible servers of a segment's connection, the likeliest first."""
    if opens(segment):
        return [segment.destination]
    return sorted((segment.source, segment.destination), key=lambda end: end.port)


@dataclass(slots=True)
class _Piece:
    start: int
    segment: TcpSegment
    arrival: int

    @property
    def end(self) -> int:
        return self.start + len(self.segment.data) + self.segment.missing


@dataclass(slots=True)
class _Direction:
    """One direction. Positions count from the first known byte; ``next`` is the position to be returned next."""

    source: SocketAddress
    base: int | None = None  # sequence number of position 0
    syn: int | None = None
    next: int = 0
    started: bool = False
    ended: bool = False
    held: list[_Piece] = field(default_factory=list)

    def position(self, sequence: int) -> int:
        """Position of a sequence number, assuming that it is near the next one."""
        if self.base is None:
            self.base = sequence
        ahead = (sequence - self.base - self.next) % _NUMBERS
        return self.next + (ahead if ahead < _NUMBERS // 2 else ahead - _NUMBERS)

    def begin(self, sequence: int) -> None:
        """Start after a SYN: the first position after it is 0."""
        self.syn = sequence
        if self.started:
            return
        shift = self.position((sequence + 1) % _NUMBERS)
        self.base = (sequence + 1) % _NUMBERS
        for piece in self.held:
            piece.start -= shift
        self.started = True

    def begin_anywhere(self) -> None:
        """Start without a SYN, at the first available byte."""
        self.next = min((piece.start for piece in self.held), default=0)
        self.started = True

    @property
    def first(self) -> _Piece | None:
        """The first of the held pieces."""
        return min(self.held, key=lambda piece: (piece.start, piece.end), default=None)


class Reassembly:
    """Both directions of the connections between two ends, one connection after the other."""

    def __init__(self, ends: tuple[SocketAddress, SocketAddress]) -> None:
        self._ends = ends
        self._reset()

    def _reset(self) -> None:
        self._directions = {end: _Direction(end) for end in self._ends}
        self._started = False
        self._arrivals = 0
        self._now: int | None = None
        self._first_ns: int | None = None

    def add(self, segment: TcpSegment) -> Iterator[Event]:
        """Take a segment; return the events it completes."""
        direction = self._directions[segment.source]
        if segment.syn:
            if self._is_new_connection(direction, segment):
                yield from self.finish()
                self._reset()
                direction = self._directions[segment.source]
            direction.begin(segment.sequence)
        self._now = segment.time_ns if segment.time_ns is not None else self._now
        self._first_ns = self._now if self._first_ns is None else self._first_ns
        self._hold(direction, segment)
        yield from self._drain()
        while self._overdue():
            yield from self._give_up()
            yield from self._drain()
        if segment.rst:
            yield from self.finish()

    def finish(self) -> Iterator[Event]:
        """Finish: return all remaining events."""
        self._start_directions()
        yield from self._drain()
        while any(direction.held for direction in self._directions.values()):
            yield from self._give_up()
            yield from self._drain()
        for direction in self._directions.values():
            if not direction.ended:
                direction.ended = True
                yield Closed(direction.source, self._now)

    def _is_new_connection(self, direction: _Direction, segment: TcpSegment) -> bool:
        """Whether a SYN opens a new connection between the same ports."""
        if direction.syn is not None:
            return direction.syn != segment.sequence
        if not direction.started:
            return direction.ended
        return not 0 <= direction.next - direction.position((segment.sequence + 1) % _NUMBERS) < _NUMBERS // 4

    def _hold(self, direction: _Direction, segment: TcpSegment) -> None:
        if direction.ended or not (segment.data or segment.missing or segment.fin):
            return
        start = direction.position((segment.sequence + segment.syn) % _NUMBERS)
        piece = _Piece(start, segment, self._arrivals)
        if piece.end > direction.next or segment.fin or not direction.started:
            direction.held.append(piece)
            self._arrivals += 1

    # returning events

    def _drain(self) -> Iterator[Event]:
        if not self._started and not self._can_start():
            return
        self._start_directions()
        while (direction := next(filter(self._is_ready, self._directions.values()), None)) is not None:
            yield from self._emit(direction)

    def _can_start(self) -> bool:
        directions = self._directions.values()
        if all(direction.started for direction in directions):
            return True
        waited = (self._now or 0) - (self._first_ns or 0)
        return sum(len(direction.held) for direction in directions) >= _START_SEGMENTS or waited > _START_NS

    def _start_directions(self) -> None:
        self._started = True
        for direction in self._directions.values():
            if not direction.started and direction.held:
                direction.begin_anywhere()

    def _is_ready(self, direction: _Direction) -> bool:
        first = direction.first
        return first is not None and first.start <= direction.next and not self._missing_before(direction, first)

    def _missing_before(self, direction: _Direction, piece: _Piece) -> int:
        """Number of missing bytes of the other direction that the sender of a piece had already received."""
        other = self._other(direction)
        if piece.segment.ack is None or not other.started or other.ended:
            return 0
        return max(0, other.position(piece.segment.ack) - other.next)

    def _other(self, direction: _Direction) -> _Direction:
        first, second = self._ends
        return self._directions[second if direction.source == first else first]

    def _emit(self, direction: _Direction) -> Iterator[Event]:
        piece = direction.first
        assert piece is not None
        direction.held.remove(piece)
        segment, source = piece.segment, direction.source
        if data := segment.data[max(0, direction.next - piece.start) :]:
            direction.next += len(data)
            yield Data(source, data, segment.time_ns)
        if piece.end > direction.next:
            yield Gap(source, piece.end - direction.next, segment.time_ns)
            direction.next = piece.end
        if segment.fin and piece.end == direction.next:
            direction.next += 1  # a FIN is counted
            direction.ended = True
            direction.held.clear()
            yield Closed(source, segment.time_ns)

    # giving up

    def _overdue(self) -> bool:
        held = [piece for direction in self._directions.values() for piece in direction.held]
        if not held or not self._started:
            return False
        if len(held) > _MAX_HELD or sum(len(piece.segment.data) for piece in held) > _MAX_HELD_BYTES:
            return True
        oldest = min(held, key=lambda piece: piece.arrival).segment.time_ns
        return oldest is not None and self._now is not None and self._now - oldest > _MAX_WAIT_NS

    def _give_up(self) -> Iterator[Event]:
        """Stop waiting for the bytes that block the oldest piece."""
        waiting = [direction for direction in self._directions.values() if direction.held]
        direction = min(waiting, key=lambda one: min(piece.arrival for piece in one.held))
        piece = direction.first
        assert piece is not None
        if piece.start > direction.next:
            yield Gap(direction.source, piece.start - direction.next, piece.segment.time_ns)
            direction.next = piece.start
        other, unheard = self._other(direction), self._missing_before(direction, piece)
        if unheard and not other.held:
            yield Gap(other.source, unheard, piece.segment.time_ns)
            other.next += unheard
        yield from self._emit(direction)


class Reassemblies:
    """All connections of a capture; each event comes with the two ends of its connection."""

    def __init__(self) -> None:
        self._known: OrderedDict[Ends, Reassembly] = OrderedDict()

    def add(self, segment: TcpSegment) -> Iterator[tuple[Ends, Event]]:
        """Take a segment; return the events it completes."""
        ends = frozenset((segment.source, segment.destination))
        if ends not in self._known:
            self._known[ends] = Reassembly((segment.source, segment.destination))
        self._known.move_to_end(ends)
        for event in self._known[ends].add(segment):
            yield ends, event
        if len(self._known) > MAX_CONNECTIONS:
            oldest_ends, oldest_connection = self._known.popitem(last=False)
            for event in oldest_connection.finish():
                yield oldest_ends, event

    def finish(self) -> Iterator[tuple[Ends, Event]]:
        """The capture has ended."""
        for ends, connection in self._known.items():
            for event in connection.finish():
                yield ends, event
        self._known.clear()
