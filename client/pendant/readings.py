"""Texts for what a robot reports, which screens bind with `client.pendant.live.Live.text`."""

from collections.abc import Callable
from typing import Any, Final

from client.pendant.station import Station
from urproto.compat import IntEnum
from urproto.modes import mode_name

UNKNOWN: Final = "\N{EN DASH}"

ReadText = Callable[[Station], str]


def field_value(station: Station, field: str, index: int | None = None) -> Any:
    """The value of an RTDE output, or an element of it; None while unknown."""
    value = station.values.get(field)
    return value if index is None or value is None else value[index]


def field_text(
    field: str, format_: str, index: int | None = None, convert: Callable[[float], float] | None = None
) -> ReadText:
    """A number with its unit. format_: as for ``str.format``. convert: to the unit of the screen."""

    def read(station: Station) -> str:
        value = field_value(station, field, index)
        if value is None:
            return UNKNOWN
        text = format_.format(value if convert is None else convert(value))
        zero = text.startswith("-0") and not text.strip("-0. °/sAVC")
        return text.removeprefix("-") if zero else text

    return read


def mode_text(field: str, modes: type[IntEnum], index: int | None = None) -> ReadText:
    def read(station: Station) -> str:
        value = field_value(station, field, index)
        return UNKNOWN if value is None else mode_name(modes, value).replace("_", " ").capitalize()

    return read


def board_text(read: Callable[[Any], str]) -> ReadText:
    """What ``read`` returns for the masterboard's data of the primary interface."""

    def read_board(station: Station) -> str:
        state = station.primary_state
        return UNKNOWN if state is None or state.masterboard is None else read(state.masterboard)

    return read_board
