"""How far two values may be apart and still count as the same: by the unit of their field."""

import re
from collections.abc import Iterable, Mapping
from typing import Final

from client.traffic.tracks import base_name
from urproto.errors import LocalProtocolError
from urproto.rtde.fields import OUTPUT_FIELDS

__all__ = ["IGNORED", "TOLERANCES", "Tolerances", "unit_of"]

# All guesses: several times what an encoder or a sensor of an arm resolves, far less than a user would notice.
TOLERANCES: Final[Mapping[str, float]] = {
    "rad": 1e-3,
    "rad/s": 1e-2,
    "rad/s2": 0.2,
    "m": 1e-3,
    "m/s": 5e-3,
    "m/s2": 0.5,
    "N": 5.0,
    "Nm": 1.0,
    "A": 0.3,
    "V": 1.0,
    "degC": 5.0,
    "J": 10.0,
    "kg": 1e-3,
    "kg m/s": 0.5,
    "kg m2": 1e-4,
    "s": 1e-3,
    "ms": 1.0,
    "": 1e-3,
}
# what counts, or tells of the controller's computer and not of the robot
IGNORED: Final = frozenset({"timestamp", "control_step", "actual_execution_time", "target_execution_time"})

_VECTORS: Final[Mapping[str, tuple[str, str]]] = {  # units of six numbers: the first three, the last three
    "m rad": ("m", "rad"),
    "m/s rad/s": ("m/s", "rad/s"),
    "m/s2 rad/s2": ("m/s2", "rad/s2"),
    "N Nm": ("N", "Nm"),
}
_EITHER: Final[Mapping[str, str]] = {"A or V": "V"}
_ELEMENT = re.compile(r"\[(\d+)\]$")
# of the primary interface, by the last part of the name
_PRIMARY: Final[Mapping[str, str]] = {
    "q_actual": "rad", "q_target": "rad", "qd_actual": "rad/s", "current": "A", "voltage": "V",
    "motor_temperature": "degC", "micro_temperature": "degC", "board_temperature": "degC", "tool_temperature": "degC",
    "pose_base_tcp": "m rad", "tcp_offset": "m rad", "frame": "m rad", "elbow_position": "m", "wrench": "N Nm",
    "robot_current": "A", "io_current": "A", "tool_current": "A", "robot_voltage_48V": "V", "tool_voltage_48V": "V",
    "analog_input0": "V", "analog_input1": "V", "analog_output0": "V", "analog_output1": "V",
}  # fmt: skip


class Tolerances:
    """The usual ones, and what the caller knows better: ``rad=0.01`` for a unit, ``actual_q=0.01`` for a field."""

    def __init__(self, wanted: Iterable[str] = ()) -> None:
        self._wanted = dict(map(_parse, wanted))

    def of(self, column: str, *, integers: bool = False) -> float:
        """For a column of a track, in its unit. integers: its values are, and without a unit each is another thing."""
        unit = unit_of(column)
        for key in (column, base_name(column), unit):
            if key in self._wanted:
                return self._wanted[key]
        return 0.0 if integers and not unit else TOLERANCES.get(unit, TOLERANCES[""])


def _parse(text: str) -> tuple[str, float]:
    key, _, number = text.rpartition("=")
    try:
        tolerance = float(number)
    except ValueError:
        tolerance = -1.0
    if not key.strip() or not tolerance >= 0:
        raise LocalProtocolError(f"{text!r} is no tolerance: give a field or unit and a number, as rad=0.01")
    return key.strip(), tolerance


def unit_of(column: str) -> str:
    """Of a column of a track; empty when it has none."""
    base = base_name(column)
    unit = OUTPUT_FIELDS[base].unit if base in OUTPUT_FIELDS else _PRIMARY.get(base.rpartition(".")[2], "")
    if unit in _VECTORS and (element := _ELEMENT.search(column)):
        return _VECTORS[unit][int(element[1]) >= 3]
    return _EITHER.get(unit, unit)
