"""A recording as an episode: observations and actions at even intervals, as policies learn them.

A frame is a point in time. Its observation is the newest state at that time, and the image of each camera nearest to
it. Its action is the controller's setpoint at the next frame: at the frame itself, the setpoint is where the arm is
already, and a policy trained on that learns to stand still. The last frame of a recording has no action, so it is not
part of the episode.

The numbers of an observation or action are RTDE variables, elements of vectors, or bits of words: ``actual_q``,
``actual_digital_output_bits[0]``.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.recording import Recording
from client.recording.pictures import RecordedPictures
from client.rtde import unknown_fields
from urproto.joints import JOINT_NAMES
from urproto.rtde.fields import OUTPUT_FIELDS

_NS: Final = 1e9
_TOLERANCE_NS: Final = 1000  # times closer than this are equal: the robot's clock is a double
_GAP_S: Final = 0.1  # longest time without a state, or else two usual periods (guess)
_STALE_S: Final = 0.5  # longest time from a frame to the nearest image (guess)

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


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode of n frames.

    state (n, k), action (n, m): float32. pictures: n JPEG images of each camera. late_s: largest time between an image
    and its frame. environment (n, l): what an observation has besides the robot's own state, float32.
    """

    task: str
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    pictures: Mapping[str, Sequence[bytes]] = field(default_factory=dict)
    late_s: float = 0.0
    environment: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def __len__(self) -> int:
        return len(self.state)


def usual_rate_hz(pictures: Mapping[str, RecordedPictures]) -> float | None:
    """The rate of the slowest camera; None without images."""
    steps = [float(np.median(np.diff(taken.times_ns))) for taken in pictures.values() if len(taken.times_ns) > 1]
    return _NS / max(steps) if steps and max(steps) > 0.0 else None


def episode(
    recording: Recording,
    pictures: Mapping[str, RecordedPictures],
    task: str,
    fps: int,
    numbers: tuple[Numbers, Numbers],
) -> Episode:
    """Sample a recording ``fps`` times per second. numbers: those of observations and of actions.

    Raises RecordingError if the recording lacks data for that.
    """
    if (np.diff(recording["timestamp"]) < 0.0).any():  # the times of images and states would not match
        raise RecordingError("the robot rebooted during the recording: record it again")
    times = np.array(recording.times_ns, np.int64)
    seen, done = (part.of(recording) for part in numbers)
    begin = max([times[0], *(taken.times_ns[0] for taken in pictures.values())])
    end = min([times[-1], *(taken.times_ns[-1] for taken in pictures.values())])
    count = int((end - begin + _TOLERANCE_NS) * fps // _NS) + 1 if end >= begin else 0
    if count < 2:
        reason = "its states and images overlap for too short a time" if pictures else "it is too short"
        raise RecordingError(f"{reason} for a frame at {fps} frames per second")
    _check_rate(times, fps)
    moments = begin + np.round(np.arange(count) * (_NS / fps)).astype(np.int64)
    rows = np.searchsorted(times, moments + _TOLERANCE_NS, side="right") - 1
    _check_gaps(times, moments, rows)
    frames = moments[:-1]
    chosen = {camera: _nearest(taken.times_ns, frames) for camera, taken in pictures.items()}
    late_s = 0.0
    for camera, places in chosen.items():
        away = np.abs(pictures[camera].times_ns[places] - frames) / _NS
        if away.max() > _STALE_S:
            at_s = (frames[int(away.argmax())] - times[0]) / _NS
            raise RecordingError(f"{camera} has no image within {_STALE_S:g} s of {at_s:.2f} s: record it again")
        late_s = max(late_s, float(away.max()))
    return Episode(
        task,
        seen[rows[:-1]].astype(np.float32),
        done[rows[1:]].astype(np.float32),
        {camera: [pictures[camera].data[place] for place in places.tolist()] for camera, places in chosen.items()},
        late_s,
    )


def _check_rate(times: NDArray[np.int64], fps: int) -> None:
    recorded_hz = _NS / max(1.0, float(np.median(np.diff(times))))
    if recorded_hz < 0.99 * fps:
        raise RecordingError(
            f"it has {recorded_hz:.3g} states per second, fewer than the {fps} frames: give a lower --fps"
        )


def _check_gaps(times: NDArray[np.int64], moments: NDArray[np.int64], rows: NDArray[np.intp]) -> None:
    """Check that states are recent enough. rows: index of the newest state at each moment."""
    away, usual = moments - times[rows], float(np.median(np.diff(times)))
    worst = int(away.argmax())
    if away[worst] > max(_GAP_S * _NS, 2.0 * usual):
        raise RecordingError(
            f"states are missing for {away[worst] / _NS:.2f} s before {(moments[worst] - times[0]) / _NS:.2f} s, in "
            "which the motion of the arm is unknown: record it again"
        )


def _nearest(times: NDArray[np.int64], moments: NDArray[np.int64]) -> NDArray[np.intp]:
    after = np.clip(np.searchsorted(times, moments), 1, max(1, len(times) - 1))
    if len(times) < 2:
        return np.zeros(len(moments), np.intp)
    nearer_before = moments - times[after - 1] <= times[after] - moments
    return np.asarray(after - nearer_before, np.intp)
