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
from urproto.rtde.fields import OUTPUT_FIELDS, FieldType

DEFAULT_FIELDS: Final = (
    "timestamp", "target_q", "target_qd", "target_qdd", "actual_q", "actual_qd", "actual_current",
    "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "speed_scaling",
    "target_speed_fraction", "robot_mode", "safety_mode", "runtime_state", "robot_status_bits",
    "safety_status_bits", "actual_digital_input_bits", "actual_digital_output_bits", "analog_io_types",
    "standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1"
)  # fmt: skip
"""The variables recorded by default; every version since 3.3 has them."""

ROBOT: Final = "robot"
"""Name of the robot's own controller wherever the name of a controller is expected."""

_NS: Final = 1e9

Info = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording in memory.

    values: an array (n,) for each RTDE variable, (n, 3) or (n, 6) for a vector. controllers: desired and actual values
    of trajectory controllers, by controller name.

    info, as far as the file has it: ``robot``, ``polyscope``, ``began_ns`` (since 1970), ``cut_off`` (why the file is
    incomplete) and ``left_out`` (what could not be used). Raises RecordingError without a ``timestamp``.
    """

    values: Mapping[str, NDArray[Any]]
    info: Info = field(default_factory=dict)
    controllers: Mapping[str, Tracking] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if "timestamp" not in self.values:
            raise RecordingError(
                f"the recording has no timestamp, only {', '.join(self.values) or 'no variables at all'}"
            )

    def __len__(self) -> int:
        return len(self.values["timestamp"])

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A variable over time. Raises RecordingError if it was not recorded."""
        if name not in self.values:
            raise RecordingError(
                f"{name} was not recorded (only {', '.join(self.values)}): record it with --fields default,{name}"
            )
        return self.values[name]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time since the first state (n,) [s], by the robot's clock; a reboot of the robot counts as no time."""
        steps = np.diff(self.values["timestamp"])
        steps[(steps < 0.0) | (steps > JUMP_S)] = 0.0
        return np.concatenate(([0.0], np.cumsum(steps)))[: len(self)]

    def tracking(self, controller: str | None = None) -> Tracking:
        """How the joints followed a recorded controller, or the robot's own (``robot``).

        None selects the controller with the most states, or the robot's own if none was recorded. Raises
        RecordingError.
        """
        if controller is None and self.controllers:
            return max(self.controllers.values(), key=lambda tracking: len(tracking.time_s))
        if controller in (None, ROBOT):
            return self._tracking_of_robot()
        if controller not in self.controllers:
            known = ", ".join((*self.controllers, ROBOT))
            raise RecordingError(f"{controller} is not a controller in the recording: choose one of {known}")
        return self.controllers[controller]

    def _tracking_of_robot(self) -> Tracking:
        actual_q = self["actual_q"]
        nothing = np.full_like(actual_q, np.nan)
        desired_q, desired_qd, actual_qd = (
            self.values.get(name, nothing) for name in ("target_q", "target_qd", "actual_qd")
        )
        return Tracking(ROBOT, JOINT_NAMES, self.time_s, desired_q, actual_q, desired_qd, actual_qd)

    @property
    def times_ns(self) -> list[int]:
        """Time of each state [ns], since 1970 if the file has that time, otherwise since the robot's start."""
        began_ns = self.info.get("began_ns", "")
        began = int(began_ns) if began_ns.isdecimal() else round(float(self.values["timestamp"][0]) * _NS)
        return [began + round(float(time_s) * _NS) for time_s in self.time_s]

    def states(self) -> Iterator[dict[str, Any]]:
        """Iterate over the states, in the form in which RTDE delivers them."""
        columns = {name: array.tolist() for name, array in self.values.items()}
        for index in range(len(self)):
            yield {name: _state_value(column[index]) for name, column in columns.items()}


class Columns:
    """Collects states compactly, at 8 bytes per number."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self._rows = bytearray()
        self._dtype = np.dtype([(name, *dtype_of(OUTPUT_FIELDS[name].type)) for name in names])

    def append(self, values: Mapping[str, Any]) -> None:
        """Add a state. Raises KeyError if a variable is missing."""
        self._rows += self.row(values)

    def row(self, values: Mapping[str, Any]) -> bytes:
        """A state as packed bytes. Raises KeyError if a variable is missing."""
        row = np.empty((), self._dtype)
        for name in self.names:
            row[name] = values[name]
        return row.tobytes()

    def extend(self, rows: bytes) -> int:
        """Add rows packed by `row`; return the number of bytes at the end that are not a complete row."""
        rest = len(rows) % self._dtype.itemsize
        self._rows += rows[: len(rows) - rest]
        return rest

    def __len__(self) -> int:
        return len(self._rows) // self._dtype.itemsize

    def drop_last(self) -> None:
        """Remove the last state."""
        del self._rows[-self._dtype.itemsize :]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The collected states, as `Recording.values` has them."""
        table = np.frombuffer(bytes(self._rows), self._dtype)
        return {name: np.ascontiguousarray(table[name]) for name in self.names}


def dtype_of(kind: FieldType) -> tuple[str, tuple[int, ...]]:
    """The numpy type of a variable, and the shape of one value."""
    letters = {"?": "?", "B": "u1", "I": "u4", "Q": "u8", "i": "i4", "d": "f8"}
    return letters[kind.letter], (kind.count,) if kind.count > 1 else ()


def _state_value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
