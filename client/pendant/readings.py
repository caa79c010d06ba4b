"""Texts for what a robot reports, which screens bind with `Live.text`, and poses as screens show them."""

from collections.abc import Callable, Sequence
from math import degrees, radians
from typing import Any, Final

from client.pendant.station import Station
from urproto.compat import IntEnum
from urproto.modes import mode_name
from urproto.robots.pose import Pose, rotvec_to_rpy, rpy_to_rotvec

UNKNOWN: Final = "\N{EN DASH}"
_MM: Final = 1e3

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


def rotation_names(as_rpy: bool) -> tuple[str, str, str]:
    return ("Roll", "Pitch", "Yaw") if as_rpy else ("RX", "RY", "RZ")


def shown_pose(pose: Sequence[float], as_rpy: bool) -> tuple[float, ...]:
    """A pose in mm, with its rotation as RPY in degrees or as a rotation vector in rad."""
    x, y, z, *turn = pose
    rotation = map(degrees, rotvec_to_rpy(*turn)) if as_rpy else turn
    return (_MM * x, _MM * y, _MM * z, *rotation)


def entered_pose(numbers: Sequence[float], as_rpy: bool) -> Pose:
    """The pose that `shown_pose` shows as these numbers."""
    x, y, z, *turn = numbers
    rx, ry, rz = rpy_to_rotvec(*map(radians, turn)) if as_rpy else turn
    return (x / _MM, y / _MM, z / _MM, rx, ry, rz)
