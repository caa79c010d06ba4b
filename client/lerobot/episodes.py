"""A recording as an episode: what was seen and done at even times, as policies learn it.

A frame is a moment. Its observation is the newest state at that moment, and of each camera the picture nearest to it.
Its action is what the controller wanted of the arm at the next frame: at its own moment a setpoint is where the arm is
already, and who learns that learns to stand still. The recording's last frame has no action, so it is none of the
episode's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.lerobot.features import Numbers
from client.recording import Recording
from client.recording.recorded_pictures import RecordedPictures

_NS: Final = 1e9
_SAME_NS: Final = 1000  # a robot's clock is a double: what is so near is the same moment
_GAP_S: Final = 0.1  # without a state, longer than two usual periods: nobody knows what was in between (guess)
_STALE_S: Final = 0.5  # from a frame to the nearest picture (guess)


@dataclass(frozen=True, slots=True)
class Episode:
    """state (n, k), action (n, m): float32. pictures: of each camera n, JPEG. late_s: the farthest from its frame."""

    task: str
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    pictures: Mapping[str, Sequence[bytes]]
    late_s: float

    def __len__(self) -> int:
        return len(self.state)


def usual_rate_hz(pictures: Mapping[str, RecordedPictures]) -> float | None:
    """How often the camera that was slowest gave a picture; None without one."""
    steps = [float(np.median(np.diff(taken.times_ns))) for taken in pictures.values() if len(taken.times_ns) > 1]
    return _NS / max(steps) if steps and max(steps) > 0.0 else None


def episode(
    recording: Recording,
    pictures: Mapping[str, RecordedPictures],
    task: str,
    fps: int,
    numbers: tuple[Numbers, Numbers],
) -> Episode:
    """What a recording shows, ``fps`` times a second. numbers: of observations and of actions.

    Raises RecordingError where it does not show that.
    """
    if (np.diff(recording["timestamp"]) < 0.0).any():  # pictures would be at other times than states
        raise RecordingError("the robot's clock began anew in it: record it again")
    times = np.array(recording.times_ns, np.int64)
    seen, done = (part.of(recording) for part in numbers)
    begin = max([times[0], *(taken.times_ns[0] for taken in pictures.values())])
    end = min([times[-1], *(taken.times_ns[-1] for taken in pictures.values())])
    count = int((end - begin + _SAME_NS) * fps // _NS) + 1 if end >= begin else 0
    if count < 2:
        both = " and pictures together" if pictures else ""
        raise RecordingError(f"its states{both} are too short for a frame at {fps} a second")
    _check_rate(times, fps)
    moments = begin + np.round(np.arange(count) * (_NS / fps)).astype(np.int64)
    rows = np.searchsorted(times, moments + _SAME_NS, side="right") - 1
    _check_gaps(times, moments, rows)
    frames = moments[:-1]
    chosen = {camera: _nearest(taken.times_ns, frames) for camera, taken in pictures.items()}
    late_s = 0.0
    for camera, places in chosen.items():
        away = np.abs(pictures[camera].times_ns[places] - frames) / _NS
        if away.max() > _STALE_S:
            at_s = (frames[int(away.argmax())] - times[0]) / _NS
            raise RecordingError(f"{camera} has no picture within {_STALE_S:g} s of {at_s:.2f} s: record it again")
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
            f"it has {recorded_hz:.3g} states a second, fewer than the {fps} frames: give a lower --fps"
        )


def _check_gaps(times: NDArray[np.int64], moments: NDArray[np.int64], rows: NDArray[np.intp]) -> None:
    """rows: of the newest state at each moment."""
    away, usual = moments - times[rows], float(np.median(np.diff(times)))
    worst = int(away.argmax())
    if away[worst] > max(_GAP_S * _NS, 2.0 * usual):
        raise RecordingError(
            f"{away[worst] / _NS:.2f} s of states are missing before {(moments[worst] - times[0]) / _NS:.2f} s: nobody "
            "knows what the arm did in them, so record it again"
        )


def _nearest(times: NDArray[np.int64], moments: NDArray[np.int64]) -> NDArray[np.intp]:
    after = np.clip(np.searchsorted(times, moments), 1, max(1, len(times) - 1))
    if len(times) < 2:
        return np.zeros(len(moments), np.intp)
    nearer_before = moments - times[after - 1] <= times[after] - moments
    return np.asarray(after - nearer_before, np.intp)
