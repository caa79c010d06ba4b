"""Align two recordings in time: find the offset of their clocks from what moved.

Both clocks count from the start of their controllers, so only the values show how they correspond. There are three
candidates: the motions start at the same time, the programs start at the same time, or the recordings as a whole are
most similar. The candidate with which the recordings agree longest wins.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.traffic.tracks import Track, base_name

Numbers = NDArray[np.float64]

# The smoothest fields, which depend least on the arm, come first.
_PREFERRED: Final = ("target_q", "actual_q", "actual_TCP_pose", "target_TCP_pose", "joints")
_MAX_COLUMNS: Final = 12
_MAX_SAMPLES: Final = 1 << 17
_MIN_CHANGE: Final = 1e-3  # smallest change of a column that counts as motion; mostly rad (guess)
_EXACT: Final = "target_"  # prefix of fields without sensor noise
_STILL: Final = 1e-6  # the same for those
_PROGRAM: Final = ("runtime_state",)
_FINER: Final = 40  # steps per sample in the final search
_MIN_OVERLAP: Final = 0.5  # of the shorter recording
_EQUALLY_GOOD: Final = 1e-9  # of mean squares of columns that have variance 1


@dataclass(frozen=True, slots=True)
class Offset:
    """seconds: to add to the first recording's time to get the second's. by: the fields that determined it.

    If nothing moved, by is empty, and the first states of both are taken as simultaneous.
    """

    seconds: float
    by: tuple[str, ...]


def numbers(values: Any) -> Numbers:
    """A numpy array that shares the memory of the values."""
    return np.asarray(values, dtype=np.float64)


def find_offset(first: Track, second: Track) -> Offset:
    """Find the offset at which the two tracks agree longest."""
    columns = _informative_columns(first, second)
    if not columns:
        return Offset(second.times_s[0] - first.times_s[0], ())
    step_s = _grid_step_s(first, second)
    candidates = [_most_similar(first, second, columns, step_s)]
    for names in (columns, [name for name in _PROGRAM if name in first.columns and name in second.columns]):
        begins = [_first_change(track, names) for track in (first, second)]
        if begins[0] is not None and begins[1] is not None:
            candidates.append(begins[1] - begins[0])
    best = max(candidates, key=lambda seconds: _agreement_s(first, second, columns, seconds))
    return Offset(best, tuple(dict.fromkeys(map(base_name, columns))))


def _first_change(track: Track, names: list[str]) -> float | None:
    """Time at which the first of these columns leaves its initial value; None if none does."""
    times = numbers(track.times_s)
    changes = [np.flatnonzero(np.abs(values - values[0]) > (_STILL if name.startswith(_EXACT) else _MIN_CHANGE))
               for name in names for values in [numbers(track.columns[name])]]  # fmt: skip
    return min((float(times[change[0]]) for change in changes if len(change)), default=None)


def _agreement_s(first: Track, second: Track, columns: list[str], offset_s: float) -> float:
    """How long these columns agree, from the first moment that both recordings cover."""
    times, other_times = numbers(first.times_s), numbers(second.times_s)
    inside = (times + offset_s >= other_times[0]) & (times + offset_s <= other_times[-1])
    common = times[inside]
    if not len(common):
        return -1.0
    apart = np.zeros(len(common), dtype=bool)
    for name in columns:
        other = np.interp(common + offset_s, other_times, numbers(second.columns[name]))
        apart |= np.abs(numbers(first.columns[name])[inside] - other) > _MIN_CHANGE
    ends = int(np.argmax(apart)) if apart.any() else len(common) - 1
    return float(common[ends] - common[0])


def _informative_columns(first: Track, second: Track) -> list[str]:
    moving = [
        name
        for name in first.columns
        if name in second.columns and _is_moving(first, name) and _is_moving(second, name)
    ]
    for base in _PREFERRED:
        if preferred := [name for name in moving if base_name(name).split(".")[0] == base]:
            return preferred[:_MAX_COLUMNS]
    return moving[:_MAX_COLUMNS]


def _is_moving(track: Track, name: str) -> bool:
    column = numbers(track.columns[name])
    return bool(np.isfinite(column).all() and np.ptp(column) > _MIN_CHANGE)


def _grid_step_s(first: Track, second: Track) -> float:
    """Step of the grid on which both are compared [s]."""
    periods = [float(np.median(np.diff(numbers(track.times_s)))) for track in (first, second)]
    longest = max(track.times_s[-1] - track.times_s[0] for track in (first, second))
    return max(*periods, longest / _MAX_SAMPLES)


def _most_similar(first: Track, second: Track, columns: list[str], step_s: float) -> float:
    a, b = ([_sampled(track, name, step_s) for name in columns] for track in (first, second))
    coarse = second.times_s[0] - first.times_s[0] + _best_lag(a, b) * step_s
    return _refine(first, second, columns, coarse, step_s)


def _sampled(track: Track, name: str, step_s: float) -> Numbers:
    times = numbers(track.times_s)
    grid = np.arange(times[0], times[-1], step_s)
    return np.interp(grid, times, numbers(track.columns[name]))


def _best_lag(a: list[Numbers], b: list[Numbers]) -> int:
    """Lag of b, in samples, with the smallest mean square difference."""
    sizes = len(a[0]), len(b[0])
    lags = np.arange(-sizes[0] + 1, sizes[1])
    overlap = np.minimum(sizes[0], sizes[1] - lags) - np.maximum(0, -lags)
    squares = np.zeros(len(lags))
    for one, other in zip(a, b, strict=True):
        middle, scale = float(other.mean()), float(other.std()) or 1.0
        squares += _squared_differences((one - middle) / scale, (other - middle) / scale, lags)
    cost = np.where(overlap >= _MIN_OVERLAP * min(sizes), squares / np.maximum(overlap, 1), np.inf)
    good = np.flatnonzero(cost <= cost.min() + _EQUALLY_GOOD)
    return int(lags[good[np.argmax(overlap[good])]])


def _squared_differences(a: Numbers, b: Numbers, lags: NDArray[np.int64]) -> Numbers:
    """The sum of (a[i] - b[i + lag])^2 over the overlap, for each lag."""
    size = 1 << (len(a) + len(b)).bit_length()
    products = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size)[lags]
    sums_a, sums_b = (np.concatenate(([0.0], np.cumsum(values**2))) for values in (a, b))
    start, end = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    squares: Numbers = sums_a[end] - sums_a[start] + sums_b[end + lags] - sums_b[start + lags] - 2 * products
    return squares


def _refine(first: Track, second: Track, columns: list[str], coarse_s: float, step_s: float) -> float:
    """The best offset within a sample of the coarse one."""
    tries = coarse_s + np.linspace(-step_s, step_s, 2 * _FINER + 1)
    times, other_times = numbers(first.times_s), numbers(second.times_s)
    cost = np.zeros(len(tries))
    for name in columns:
        column, other = numbers(first.columns[name]), numbers(second.columns[name])
        scale = float(other.std()) or 1.0
        for index, offset_s in enumerate(tries):
            inside = (times + offset_s >= other_times[0]) & (times + offset_s <= other_times[-1])
            if inside.any():
                gap = (column[inside] - np.interp(times[inside] + offset_s, other_times, other)) / scale
                cost[index] += float(np.mean(gap**2))
    best = np.flatnonzero(cost <= cost.min() + _EQUALLY_GOOD)
    return float(tries[best[len(best) // 2]])
