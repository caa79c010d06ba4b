"""A recording in memory: RTDE variables as arrays over time."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.recording.timestamps import JUMP_S
from client.recording.tracking import Tracking
from urproto.joints import JOINT_NAMES
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.types import FieldType

DEFAULT_FIELDS: Final = (
    "timestamp",
    "target_q",
    "target_qd",
    "target_qdd",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "target_TCP_pose",
    "speed_scaling",
    "target_speed_fraction",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "robot_status_bits",
    "safety_status_bits",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "analog_io_types",
    "standard_analog_input0",
    "standard_analog_input1",
    "standard_analog_output0",
    "standard_analog_output1",
)
"""What is recorded when nobody says what; every version since 3.3 has these."""

ROBOT: Final = "robot"
"""Stands for the robot's own controller, where names of controllers are asked for."""

_NS: Final = 1e9

Info = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Recording:
    """values: an array (n,) of each RTDE variable, (n, 3) or (n, 6) of a vector. info: what is known about it.

    controllers: what trajectory controllers wanted and what the joints did, by the controllers' names.

    info has, where the file keeps such things: ``robot``, ``polyscope``, ``began_ns`` (since
    1970), ``cut_off`` with the reason when the file has no proper end, and ``left_out``: what of it could not be used.
    """

    values: Mapping[str, NDArray[Any]]
    info: Info = field(default_factory=dict)
    controllers: Mapping[str, Tracking] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if "timestamp" not in self.values:
            raise RecordingError(
                f"there is no timestamp in the recording; it has {', '.join(self.values) or 'nothing'}"
            )

    def __len__(self) -> int:
        return len(self.values["timestamp"])

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A variable over time. Raises RecordingError for one that was not recorded."""
        if name not in self.values:
            raise RecordingError(
                f"{name} was not recorded, but {', '.join(self.values)}: record it with --fields default,{name}"
            )
        return self.values[name]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Since the first state (n,) [s], by the robot's clock; a new start of the robot takes no time."""
        steps = np.diff(self.values["timestamp"])
        steps[(steps < 0.0) | (steps > JUMP_S)] = 0.0
        return np.concatenate(([0.0], np.cumsum(steps)))[: len(self)]

    def tracking(self, controller: str | None = None) -> Tracking:
        """How the joints followed a controller of the recording, or the robot's own (``robot``).

        None is the controller that told the most, the robot's own where none was recorded. Raises RecordingError.
        """
        if controller is None and self.controllers:
            return max(self.controllers.values(), key=lambda tracking: len(tracking.time_s))
        if controller in (None, ROBOT):
            return self._robots_tracking()
        if controller not in self.controllers:
            known = ", ".join((*self.controllers, ROBOT))
            raise RecordingError(f"{controller} is not a controller of the recording, but {known}")
        return self.controllers[controller]

    def _robots_tracking(self) -> Tracking:
        actual_q = self["actual_q"]
        nothing = np.full_like(actual_q, np.nan)
        desired_q, desired_qd, actual_qd = (
            self.values.get(name, nothing) for name in ("target_q", "target_qd", "actual_qd")
        )
        return Tracking(ROBOT, JOINT_NAMES, self.time_s, desired_q, actual_q, desired_qd, actual_qd)

    @property
    def times_ns(self) -> list[int]:
        """Of each state, since 1970 where the file knows that, else since the robot's start."""
        said = self.info.get("began_ns", "")
        began = int(said) if said.isdecimal() else round(float(self.values["timestamp"][0]) * _NS)
        return [began + round(float(time_s) * _NS) for time_s in self.time_s]

    def states(self) -> Iterator[dict[str, Any]]:
        """State by state, as RTDE gave them."""
        columns = {name: array.tolist() for name, array in self.values.items()}
        for index in range(len(self)):
            yield {name: _state_value(column[index]) for name, column in columns.items()}


class Columns:
    """Collects states, small in memory: 8 bytes a number."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self._rows = bytearray()
        self._dtype = np.dtype([(name, *dtype_of(OUTPUT_FIELDS[name].type)) for name in names])

    def append(self, values: Mapping[str, Any]) -> None:
        """Add a state. Raises KeyError when a variable is missing."""
        self._rows += self.row(values)

    def row(self, values: Mapping[str, Any]) -> bytes:
        """A state as it is kept. Raises KeyError when a variable is missing."""
        row = np.empty((), self._dtype)
        for name in self.names:
            row[name] = values[name]
        return row.tobytes()

    def extend(self, rows: bytes) -> int:
        """Add what `row` has made; how many bytes at the end are no whole row."""
        rest = len(rows) % self._dtype.itemsize
        self._rows += rows[: len(rows) - rest]
        return rest

    def __len__(self) -> int:
        return len(self._rows) // self._dtype.itemsize

    def drop_last(self) -> None:
        """Forget the last state."""
        del self._rows[-self._dtype.itemsize :]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What has been collected, as `Recording.values`."""
        table = np.frombuffer(bytes(self._rows), self._dtype)
        return {name: np.ascontiguousarray(table[name]) for name in self.names}


def dtype_of(kind: FieldType) -> tuple[str, tuple[int, ...]]:
    """How numpy has a variable: the type, and the shape of one value."""
    letters = {"?": "?", "B": "u1", "I": "u4", "Q": "u8", "i": "i4", "d": "f8"}
    return letters[kind.letter], (kind.count,) if kind.count > 1 else ()


def _state_value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
