"""Realtime interface (TCP 30003, read-only 30013): one fixed packet every control period.

A packet has ``int32 size`` followed by 8-byte columns, nearly all doubles, big-endian. Newer versions append columns,
so the size identifies the layout. Columns have the names of RTDE; internal ones are sent as zeros.

Source of the layout: the realtime columns in the vendor's client interface manual, which add up to the sizes known to
public clients. That digital bits are sent as 64-bit integers instead of doubles follows from a remark in the manual and
one client; another client reads doubles.
"""

import csv
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

from urproto._wire import SizedMessageDecoder
from urproto.errors import RemoteProtocolError
from urproto.versions import Availability, PolyscopeVersion

RealtimeState = dict[str, Any]

_SIZE = struct.Struct(">i")
_MAX_SIZE = 65536  # bytes; guess: ample, since the longest known packet has 1220


@dataclass(frozen=True, slots=True)
class Column:
    """``count`` consecutive 8-byte numbers. name: attribute of the snapshot, None for an internal column."""

    name: str | None
    count: int
    since: Availability
    letter: str

    @property
    def layout(self) -> str:
        """Struct layout, without byte order."""
        return f"{self.count}{self.letter}"


def _read_columns() -> Iterator[Column]:
    for row in csv.DictReader(files("urproto").joinpath("realtime.csv").read_text("utf-8").splitlines()):
        since = Availability.since(row["cb3"] or None, row["e"] or None)
        yield Column(row["name"] or None, int(row["count"]), since, row["letter"])


COLUMNS = tuple(_read_columns())
"""The columns of the newest packet, in their order; each is a row of ``realtime.csv``."""


def _columns(version: PolyscopeVersion) -> tuple[Column, ...]:
    return tuple(column for column in COLUMNS if column.since.covers(version))


def _packer(columns: tuple[Column, ...]) -> struct.Struct:
    return struct.Struct(">" + "".join(column.layout for column in columns))


def packet_size(version: PolyscopeVersion) -> int:
    """Bytes of a packet of this version, including the size field."""
    return _SIZE.size + _packer(_columns(version)).size


def _expression(column: Column) -> str:
    if column.name is None:
        return ", ".join(["0.0"] * column.count)
    return f"*s.{column.name}" if column.count > 1 else f"s.{column.name}"


@lru_cache(maxsize=32)
def realtime_packer(version: PolyscopeVersion) -> Callable[[Any], bytes]:
    """A function that converts a snapshot to a complete packet, for use in every control period.

    A single generated expression reads all attributes; the names come from COLUMNS.
    """
    columns = _columns(version)
    arguments = ", ".join(map(_expression, columns))
    names = {"head": _SIZE.pack(packet_size(version)), "pack": _packer(columns).pack}
    pack: Callable[[Any], bytes] = eval(f"lambda s: head + pack({arguments})", names)
    return pack


def _columns_by_size() -> dict[int, tuple[Column, ...]]:
    """All layouts by packet size."""
    layouts = {}
    for end in range(1, len(COLUMNS) + 1):
        if end == len(COLUMNS) or COLUMNS[end].since != COLUMNS[end - 1].since:
            layouts[_SIZE.size + _packer(COLUMNS[:end]).size] = COLUMNS[:end]
    return layouts


_LAYOUTS = _columns_by_size()
_NEWEST = max(_LAYOUTS)


def decode_realtime(packet: bytes) -> RealtimeState:
    """Values by column name; vectors as tuples, bits as int.

    If a packet is longer than any known one, the excess is ignored. Raises RemoteProtocolError for a size that no 3.x
    or 5.x version sends.
    """
    columns = _LAYOUTS.get(min(len(packet), _NEWEST))
    if columns is None:
        known = ", ".join(map(str, sorted(_LAYOUTS)))
        raise RemoteProtocolError(f"a realtime packet has {len(packet)} bytes; known sizes are {known}")
    values = _packer(columns).unpack_from(packet, _SIZE.size)
    state: RealtimeState = {}
    offset = 0
    for column in columns:
        if column.name is not None:
            state[column.name] = values[offset] if column.count == 1 else values[offset : offset + column.count]
        offset += column.count
    return state


class RealtimeDecoder(SizedMessageDecoder[RealtimeState]):
    """Splits a stream into packets and decodes them."""

    header = _SIZE

    def _size(self, *header: int) -> int:
        size = header[0]
        if not _SIZE.size < size <= _MAX_SIZE:
            raise RemoteProtocolError(f"a realtime packet cannot have {size} bytes")
        return size

    def _decode(self, message: bytes) -> RealtimeState:
        return decode_realtime(message)
