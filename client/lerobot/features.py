"""Selects the numbers of an observation or action in a recording: ``actual_q``, ``actual_digital_output_bits[0]``."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.recording import Recording
from client.rtde import unknown_fields
from urproto.joints import JOINT_NAMES
from urproto.rtde.fields import OUTPUT_FIELDS

DEFAULT_STATE: Final = ("actual_q",)
DEFAULT_ACTION: Final = ("target_q",)

_SERIES: Final = re.compile(r"(?P<name>\w+)(\[(?P<index>\d+)\])?")
_BITS: Final = {"B": 8, "I": 32, "Q": 64}
_OF_JOINTS: Final = {"_q": "pos", "_qd": "vel"}  # LeRobot's suffixes for motors, as in shoulder_pan.pos


@dataclass(frozen=True, slots=True)
class _Series:
    """One RTDE variable, one number of a vector, or one bit of a word."""

    name: str
    index: int | None

    @classmethod
    def parse(cls, text: str) -> "_Series":
        match = _SERIES.fullmatch(text)
        if match is None:
            raise RecordingError(
                f"{text!r} is neither an RTDE variable, such as actual_q, nor an element of one, such as actual_q[0]"
            )
        name, index = match["name"], match["index"]
        if problem := unknown_fields([name]):
            raise RecordingError(problem)
        kind = OUTPUT_FIELDS[name].type
        if index is not None:
            unit_name, parts = ("numbers", kind.count) if kind.count > 1 else ("bits", _BITS.get(kind.letter, 0))
            if not parts:
                raise RecordingError(f"{text}: {name} is a single number: leave out [{index}]")
            if int(index) >= parts:
                raise RecordingError(f"{text}: {name} has {parts} {unit_name}, 0 to {parts - 1}")
        return cls(name, None if index is None else int(index))

    @property
    def labels(self) -> Iterator[str]:
        count = OUTPUT_FIELDS[self.name].type.count
        places = [self.index] if self.index is not None else range(count) if count > 1 else [None]
        kind = next((kind for ending, kind in _OF_JOINTS.items() if self.name.endswith(ending)), None)
        for place in places:
            if place is None:
                yield self.name
            else:
                yield f"{JOINT_NAMES[place]}.{kind}" if kind else f"{self.name}[{place}]"

    def of(self, recording: Recording) -> NDArray[np.float64]:
        """The numbers of each state (n, k). Raises RecordingError if the variable was not recorded."""
        values: NDArray[Any] = recording[self.name]
        if values.ndim == 1:
            values = values[:, None]
            if self.index is not None:
                values = values.astype(np.uint64) >> np.uint64(self.index) & np.uint64(1)
        elif self.index is not None:
            values = values[:, self.index, None]
        return np.asarray(values, np.float64)


class Numbers:
    """The elements of an observation or action, in order. Raises RecordingError for unknown RTDE variables."""

    def __init__(self, names: Iterable[str]) -> None:
        self._series = tuple(_Series.parse(name) for name in names)
        self.labels = tuple(label for series in self._series for label in series.labels)
        if not self.labels:
            raise RecordingError("an observation and an action need at least one number each")

    def of(self, recording: Recording) -> NDArray[np.float64]:
        """The numbers of each state (n, k). Raises RecordingError for missing variables, NaN and infinity."""
        values = np.concatenate([series.of(recording) for series in self._series], axis=1)
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0].tolist()
            raise RecordingError(f"{self.labels[column]} is not a number {recording.time_s[row]:.2f} s after the start")
        return values
