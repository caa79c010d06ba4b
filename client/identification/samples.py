"""A recorded motion prepared for comparison with a model: checked, cut at gaps, and resampled to an even grid.

If the recording has the targets (``target_q``, ``target_qd``, ``target_qdd``), they are the motion. Otherwise the
measured angles are differentiated, and all compared values first pass the same low-pass filter, so that it affects
both sides of the comparison equally (parallel filtering).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.recording.recording import Recording
from urproto.robots.drivetrain import KNOWN_BEND_RAD_S, KNOWN_COULOMB_RAD_S

Array = NDArray[np.float64]

COMPARED: Final = ("target_moment", "target_current", "actual_current")
SMOOTHING_S: Final = 0.05  # standard deviation of the low-pass (Gaussian): half the amplitude remains at 3.7 Hz
MOVES_RAD_S: Final = 0.02
RESTS_RAD_S: Final = 1e-3
_INFORMATIVE_RAD_S: Final = 0.1
_INFORMATIVE_S: Final = 2.0
_GAP: Final = 5.0  # multiple of the usual step
_MIN_PART_S: Final = 0.5
_EDGE: Final = 3.0  # widths of the low-pass that are not compared, at each end of a part
_TARGETS: Final = ("target_q", "target_qd", "target_qdd")
_MAX_STEP_S: Final = 0.05  # below 20 states per second, accelerations cannot be seen
_MAX_RAD: Final = 7.0  # joints turn once in either direction, and an e-Series simulator reports 363 degrees
_MAX_A: Final = 200.0
_MAX_PLAUSIBLE: Final = 1e6  # too large for an angle, speed, current or torque in any unit
_RATE_RANGE: Final = (0.7, 1.4)  # of recorded speeds to the rate of change of the angles


@dataclass(frozen=True, slots=True)
class Samples:
    """A prepared motion. Joint arrays are (n, 6).

    qd is unfiltered; the other arrays are low-passed if ``smoothing_s`` is not 0. fields: the recorded ones among
    `COMPARED`. raw: the same, unfiltered. parts: begin and end of each part without a gap. whole: (n,), whether the
    window of the low-pass was complete. notes: remarks for the user.
    """

    time_s: Array
    q: Array
    qd: Array
    smooth_qd: Array
    qdd: Array
    fields: dict[str, Array]
    raw: dict[str, Array]
    parts: tuple[tuple[int, int], ...]
    whole: NDArray[np.bool_]
    smoothing_s: float
    notes: tuple[str, ...]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each joint moves, among the states that can be compared (n, 6)."""
        return np.asarray((np.abs(self.qd) > MOVES_RAD_S) & self.whole[:, None])

    @property
    def resting(self) -> NDArray[np.bool_]:
        """Whether the arm is at rest throughout the window of the low-pass (n,)."""
        quiet = np.abs(self.qd).max(axis=1) < RESTS_RAD_S
        return np.asarray((self.smooth(quiet[:, None].astype(float))[:, 0] > 0.999) & self.whole)

    def moves(self, joint: int) -> bool:
        """Whether a joint (0-5) moves fast and long enough to be judged."""
        speed = np.abs(self.qd[:, joint])
        return bool((speed > _INFORMATIVE_RAD_S).mean() * (self.time_s[-1] - self.time_s[0]) > _INFORMATIVE_S)

    def smooth(self, values: Array) -> Array:
        """Apply the low-pass of the recorded values to an array (n, ...)."""
        if not self.smoothing_s:
            return values
        flat = values.reshape(len(values), -1)
        step = float(self.time_s[1] - self.time_s[0])
        parts = [_filtered(flat[begin:end], step, self.smoothing_s, 0) for begin, end in self.parts]
        return np.concatenate(parts).reshape(values.shape)

    def rows(self, count: int) -> NDArray[np.int_]:
        """At most ``count`` rows, spread evenly over those that can be compared."""
        usable = np.flatnonzero(self.whole)
        rows: NDArray[np.int_] = usable[np.unique(np.linspace(0, len(usable) - 1, min(count, len(usable))).astype(int))]
        return rows


def known_features(qd: Array) -> Array:
    """Features of the controller's friction model, which is linear in them: (n, 6, 3), Coulomb, slow and fast part."""
    slow = np.clip(qd, -KNOWN_BEND_RAD_S, KNOWN_BEND_RAD_S)
    return np.stack([np.clip(qd / KNOWN_COULOMB_RAD_S, -1.0, 1.0), slow, qd - slow], axis=-1)


def friction_features(qd: Array) -> Array:
    """Features of the arm's friction, which is linear in them: (n, 6, 2), Coulomb and viscous part."""
    return np.stack([np.clip(qd / KNOWN_COULOMB_RAD_S, -1.0, 1.0), qd], axis=-1)


def samples_of(recording: Recording) -> Samples:
    """Prepare a recording. Raises RecordingError if it lacks variables, has other units, or consists of gaps."""
    compared = [name for name in COMPARED if name in recording]
    targets = all(name in recording for name in _TARGETS)
    if not compared:
        raise RecordingError(f"none of {', '.join(COMPARED)} was recorded: add one with --fields default,NAME")
    if not targets and "actual_q" not in recording:
        raise RecordingError("no motion was recorded: record target_q, target_qd and target_qdd, or else actual_q")
    time_s = np.asarray(recording["timestamp"], float)
    q = np.asarray(recording["target_q" if targets else "actual_q"], float)
    _check_times(time_s, differentiated=not targets)
    names = [*compared, *(_TARGETS if targets else ("actual_q", *(("actual_qd",) if "actual_qd" in recording else ())))]
    arrays = {name: np.asarray(recording[name], float) for name in names}
    sound = np.concatenate(([True], np.diff(time_s) > 0.0))
    for array in arrays.values():
        sound &= (np.abs(array) < _MAX_PLAUSIBLE).all(axis=1)  # False for a NaN
    if damaged := int(len(sound) - sound.sum()):
        time_s, q, arrays = time_s[sound], q[sound], {name: array[sound] for name, array in arrays.items()}
    ranges, notes = _parts(time_s)
    if damaged:
        notes = (
            *notes,
            f"{damaged} states are left out: not numbers, far too large, or no later than the one before",
        )
    _check_units(time_s, q, arrays, ranges)
    prepare = _from_targets if targets else _from_angles
    return prepare(time_s, arrays, compared, ranges, notes)


def _check_times(time_s: Array, *, differentiated: bool) -> None:
    if len(time_s) < 3:
        raise RecordingError(f"{len(time_s)} states are too few to compare")
    steps = np.diff(time_s)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if usual <= 0.0:
        raise RecordingError("timestamp never rises: it must be the robot's clock in seconds")
    if usual >= 1.0 and usual < 1000.0:
        raise RecordingError(f"timestamp rises by {usual:g} per state: seconds are expected, these may be milliseconds")
    if differentiated and usual > _MAX_STEP_S:
        raise RecordingError(
            f"one state per {usual:g} s is too few without recorded targets: record at least "
            f"{1.0 / _MAX_STEP_S:g} per second"
        )


def _parts(time_s: Array) -> tuple[list[tuple[int, int]], tuple[str, ...]]:
    """The parts without gaps, and notes on the rest."""
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > _GAP * usual)
    edges = [0, *(gaps + 1).tolist(), len(time_s)]
    every = list(pairwise(edges))
    kept = [(begin, end) for begin, end in every if time_s[end - 1] - time_s[begin] >= _MIN_PART_S]
    if not kept:
        longest = max(float(time_s[end - 1] - time_s[begin]) for begin, end in every)
        raise RecordingError(
            f"no {_MIN_PART_S:g} s without a gap ({len(gaps)} gaps, at most {longest:.2f} s between them): record it "
            "again, over a cable or on a less busy machine"
        )
    if not len(gaps):
        return kept, ()
    lost = float(steps[gaps].sum())
    note = f"{len(gaps)} gaps, {lost:.2f} s in total; {len(kept)} parts between them are long enough and are used"
    return kept, (note,)


def _check_units(time_s: Array, q: Array, arrays: dict[str, Array], parts: Sequence[tuple[int, int]]) -> None:
    if (most := float(np.abs(q[:, :5]).max())) > _MAX_RAD:
        raise RecordingError(f"joint angles reach {most:.1f}: radians are expected, these may be degrees")
    for name in ("target_current", "actual_current"):
        if name in arrays and (most := float(np.abs(arrays[name]).max())) > _MAX_A:
            raise RecordingError(f"{name} reaches {most:.0f}: amperes are expected, these may be milliamperes")
    speeds = arrays.get("target_qd", arrays.get("actual_qd"))
    if speeds is None:
        return
    slopes = np.concatenate([np.gradient(q[a:b], time_s[a:b], axis=0) for a, b in parts])
    reported = np.concatenate([speeds[a:b] for a, b in parts])
    power = float((slopes**2).sum())
    if power < MOVES_RAD_S**2 * len(slopes):
        return
    ratio = float((slopes * reported).sum()) / power
    if not _RATE_RANGE[0] < ratio < _RATE_RANGE[1]:
        raise RecordingError(
            f"joint speeds are {ratio:.3g} times the change of angles per second: rad, rad/s and seconds are expected"
        )


def _from_targets(
    time_s: Array, arrays: dict[str, Array], compared: list[str], parts: list[tuple[int, int]], notes: tuple[str, ...]
) -> Samples:
    rows = np.concatenate([np.arange(begin, end) for begin, end in parts])
    fields = {name: arrays[name][rows] for name in compared}
    q, qd, qdd = (arrays[name][rows] for name in _TARGETS)
    return Samples(time_s[rows], q, qd, qd, qdd, fields, fields, _lengths(parts), np.ones(len(rows), bool), 0.0, notes)


def _from_angles(
    time_s: Array, arrays: dict[str, Array], compared: list[str], parts: list[tuple[int, int]], notes: tuple[str, ...]
) -> Samples:
    step = float(np.median(np.diff(time_s)))
    columns: dict[str, list[Array]] = {name: [] for name in ("time", "q", "qd", "smooth_qd", "qdd", *compared)}
    raw: dict[str, list[Array]] = {name: [] for name in compared}
    places, whole_parts, end_at = [], [], 0
    lost = round(_EDGE * SMOOTHING_S / step)
    for begin, end in parts:
        grid = np.arange(time_s[begin], time_s[end - 1], step)
        even = {name: _resampled(grid, time_s[begin:end], array[begin:end]) for name, array in arrays.items()}
        q = even["actual_q"]
        columns["time"].append(grid)
        for name, order in (("q", 0), ("smooth_qd", 1), ("qdd", 2)):
            columns[name].append(_filtered(q, step, SMOOTHING_S, order))
        columns["qd"].append(even.get("actual_qd", columns["smooth_qd"][-1]))
        for name in compared:
            columns[name].append(_filtered(even[name], step, SMOOTHING_S, 0))
            raw[name].append(even[name])
        places.append((end_at, end_at := end_at + len(grid)))
        inside = np.arange(len(grid))
        whole_parts.append((inside >= lost) & (inside < len(grid) - lost))
    whole = {name: np.concatenate(every) for name, every in columns.items()}
    standing = np.abs(whole["qd"]).max(axis=1) < RESTS_RAD_S
    for name in ("smooth_qd", "qdd"):
        whole[name][standing] = 0.0  # anything else there is noise of the encoders
    note = f"it has no targets: measured angles are differentiated, all values low-passed by {SMOOTHING_S * 1e3:.0f} ms"
    return Samples(
        whole["time"],
        whole["q"],
        whole["qd"],
        whole["smooth_qd"],
        whole["qdd"],
        {name: whole[name] for name in compared},
        {name: np.concatenate(every) for name, every in raw.items()},
        tuple(places),
        np.concatenate(whole_parts),
        SMOOTHING_S,
        (*notes, note),
    )


def _lengths(parts: list[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    ends = np.cumsum([end - begin for begin, end in parts]).tolist()
    return tuple(zip([0, *ends[:-1]], ends, strict=True))


def _resampled(grid: Array, time_s: Array, values: Array) -> Array:
    return np.stack([np.interp(grid, time_s, column) for column in values.T], axis=1)


def _filtered(values: Array, step_s: float, width_s: float, order: int) -> Array:
    """Filter (n, k) with a Gaussian, or its first or second derivative; the first and last values are repeated."""
    kernel = _kernel(step_s, width_s, order)
    half = len(kernel) // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel, "valid") for column in padded.T], axis=1)


def _kernel(step_s: float, width_s: float, order: int) -> Any:
    """A kernel with exactly unit gain for constants, slopes or parabolas on the grid."""
    half = int(np.ceil(4.0 * width_s / step_s))
    x = np.arange(-half, half + 1) * step_s
    bell = np.exp(-0.5 * (x / width_s) ** 2)
    bell /= bell.sum()
    if order == 0:
        return bell
    if order == 1:
        return -x * bell / (bell * x * x).sum()
    curve = (x * x / width_s**2 - 1.0) * bell
    curve -= curve.mean()
    return 2.0 * curve / (curve * x * x).sum()
