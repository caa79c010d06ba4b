"""Time parameterisation of a path: as fast as the limits of speed and acceleration allow, then slower for the jerk.

The first step is the time-optimal path parameterisation by reachability analysis of Pham and Pham (TOPP-RA, IEEE T-RO
2018). With x = (ds/dt)^2 and u = d2s/dt2, each limit is linear in u and x at each place s of the path. The backward
pass finds the largest x from which the end can be reached; the forward pass takes the largest u that stays below it.
For a single path, the limits of all joints are inequalities in two unknowns, so no solver is needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from client.errors import PlanningError
from urproto.text import quoted

Array: TypeAlias = npt.NDArray[np.float64]
PathFunction = Callable[[Array], tuple[Array, Array, Array]]
"""From places s (n,) to q, dq/ds and d2q/ds2, each (n, columns)."""

Scalings = Callable[[Array], Array]
"""From places s (n,) to the shares of the velocity and acceleration limits that may be used there (n, 2)."""

_EPSILON: Final = 1e-9
_SAFETY_FACTOR: Final = 1.0 - 1e-9
_MAX_ITERATIONS: Final = 12


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of each joint (6,): speed [rad/s], acceleration [rad/s2], jerk [rad/s3]."""

    velocity: Array
    acceleration: Array
    jerk: Array

    def __post_init__(self) -> None:
        for value in (self.velocity, self.acceleration, self.jerk):
            if not (
                isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind == "f" and (value > 0).all()
            ):
                raise PlanningError(f"limits are arrays of one number above 0 for each joint, not {quoted(value)}")

    def scaled(self, velocity: float, acceleration: float) -> "Limits":
        """Reduced limits. velocity, acceleration: shares above 0 and up to 1; the jerk scales with the acceleration.

        Raises PlanningError.
        """
        for name, share in (("velocity", velocity), ("acceleration", acceleration)):
            if not 0.0 < share <= 1.0:
                raise PlanningError(f"the {name} scaling must be above 0 and at most 1, not {share}")
        return Limits(self.velocity * velocity, self.acceleration * acceleration, self.jerk * acceleration)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples of a motion: times [s] (n,), q [rad], qd [rad/s], qdd [rad/s2], each (n, 6).

    Samples are equidistant in time from one rest to the next.
    """

    times_s: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def duration_s(self) -> float:
        """Time from start to end."""
        return float(self.times_s[-1])

    @classmethod
    def at_rest(cls, q_rad: Sequence[float]) -> "Trajectory":
        """An arm that does not move."""
        return cls(np.zeros(1), np.array([q_rad], dtype=float), np.zeros((1, 6)), np.zeros((1, 6)))

    def joint_columns(self) -> "Trajectory":
        """The same trajectory without the columns that are not joints."""
        return Trajectory(self.times_s, self.q[:, :6], self.qd[:, :6], self.qdd[:, :6])

    def followed_by(self, other: "Trajectory") -> "Trajectory":
        """This trajectory continued by another one, which begins where this one ends."""
        return Trajectory(
            np.concatenate((self.times_s, self.duration_s + other.times_s[1:])),
            np.concatenate((self.q, other.q[1:])),
            np.concatenate((self.qd, other.qd[1:])),
            np.concatenate((self.qdd, other.qdd[1:])),
        )


def parameterise(
    path: PathFunction, gridpoints: Array, limits: Limits, *, step_s: float, scalings: Scalings | None = None
) -> Trajectory:
    """Follow a path as fast as the limits allow, from rest to rest.

    limits: of each column of the path. gridpoints: ascending, from start to end of the path, dense where it bends.
    step_s: time between samples. scalings: shares of the limits that may be used; where they change, the larger ones
    apply while the acceleration changes.
    """
    scalings = scalings or _unit_scalings
    speeds = _velocity_profile(path, gridpoints, limits, scalings(gridpoints))
    when = _times(gridpoints, speeds)
    smooth_s = float(np.max(limits.acceleration / limits.jerk))
    stretch = 1.0
    for _ in range(_MAX_ITERATIONS):
        trajectory, behind, ahead = _sampled(path, gridpoints, speeds, when, smooth_s, stretch, step_s)
        excess = _time_stretch(trajectory, limits, np.maximum(scalings(behind), scalings(ahead)))
        if excess <= 1.0 + 1e-6:
            break
        stretch *= excess * 1.001
    return trajectory


def _unit_scalings(s: Array) -> Array:
    return np.ones((len(s), 2))


def _velocity_profile(path: PathFunction, s: Array, limits: Limits, scalings: Array) -> Array:
    """The largest ds/dt at each gridpoint."""
    _, first, second = path(s)
    with np.errstate(divide="ignore"):
        largest = np.min((limits.velocity * scalings[:, :1] / np.maximum(abs(first), _EPSILON)) ** 2, axis=1)
    steps = np.diff(s)
    a, b, c = first, second, limits.acceleration * scalings[:, 1:]
    x = np.empty(len(s))
    x[-1] = 0.0
    for i in range(len(s) - 2, -1, -1):
        x[i] = _controllable(a[i], b[i], c[i], float(largest[i]), float(x[i + 1]), float(steps[i]))
    x[0] = 0.0
    for i in range(len(steps)):
        highest = _accelerations(a[i], b[i] * x[i], c[i])[1]
        x[i + 1] = max(0.0, min(float(x[i + 1]), x[i] + 2.0 * float(steps[i]) * highest))
    return np.sqrt(x)


def _accelerations(a: Array, bx: Array, c: Array) -> tuple[float, float]:
    """The smallest and the largest u for which |a u + bx| <= c in all joints."""
    moving = abs(a) > _EPSILON
    a, bx, c = a[moving], bx[moving], c[moving]
    one, other = (-c - bx) / a, (c - bx) / a
    return float(np.minimum(one, other).max(initial=-np.inf)), float(np.maximum(one, other).min(initial=np.inf))


def _controllable(a: Array, b: Array, c: Array, largest: float, after: float, step: float) -> float:
    """The largest x from which some u leads to 0 <= x + 2 step u <= after.

    Each joint bounds u from below and above by lines in x; so do the two ends of the next interval. A valid u exists
    where the highest lower line is below the lowest upper one.
    """
    moving = abs(a) > _EPSILON
    still = ~moving & (b != 0.0)
    if still.any():
        largest = min(largest, float(np.min(c[still] / abs(b[still]))))
    am, bm, cm = a[moving], b[moving], c[moving]
    slope, half = -bm / am, abs(cm / am)
    low0, low1 = np.append(-half, 0.0), np.append(slope, -0.5 / step)
    high0, high1 = np.append(half, 0.5 * after / step), np.append(slope, -0.5 / step)
    # low0 + low1 x <= high0 + high1 x for each pair
    rise, room = low1[:, None] - high1[None, :], high0[None, :] - low0[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.where(rise > _EPSILON, room / rise, np.inf)
    return max(0.0, min(largest, float(bounds.min()))) * _SAFETY_FACTOR


def _times(s: Array, speed: Array) -> Array:
    """When each gridpoint is reached, with constant acceleration between gridpoints."""
    mean = 0.5 * (speed[1:] + speed[:-1])
    return np.concatenate(((0.0,), np.cumsum(np.diff(s) / np.maximum(mean, _EPSILON))))


def _sampled(
    path: PathFunction, s: Array, speed: Array, when: Array, smooth_s: float, stretch: float, step_s: float
) -> tuple[Trajectory, Array, Array]:
    """Sample the path over time, with its place averaged over ``smooth_s``, which bounds the jerk, and slowed down.

    Also returns the places between which each average is taken.
    """
    total = float(when[-1]) + smooth_s
    times = np.linspace(0.0, total, max(2, int(np.ceil(total * stretch / step_s)) + 1))
    ahead, behind = _profile(when, s, speed, times), _profile(when, s, speed, times - smooth_s)
    # the mean of a function over a window is the difference of its integral
    place, rate, gain = ((one - other) / smooth_s for one, other in zip(ahead, behind, strict=True))
    q, first, second = path(np.clip(place, s[0], s[-1]))
    qd = first * rate[:, None] / stretch
    qdd = (first * gain[:, None] + second * (rate**2)[:, None]) / stretch**2
    return Trajectory(times * stretch, q, qd, qdd), behind[1], ahead[1]


def _profile(when: Array, s: Array, speed: Array, times: Array) -> tuple[Array, Array, Array]:
    """The integral of the place over time, the place, and the speed at these times; at rest before and after."""
    spans = np.diff(when)
    acceleration = np.diff(speed) / np.maximum(spans, _EPSILON)
    areas = s[:-1] * spans + 0.5 * speed[:-1] * spans**2 + acceleration * spans**3 / 6.0
    whole = np.concatenate(((0.0,), np.cumsum(areas)))
    inside = np.clip(times, 0.0, when[-1])
    i = np.clip(np.searchsorted(when, inside, side="right") - 1, 0, len(spans) - 1)
    t = inside - when[i]
    place = s[i] + speed[i] * t + 0.5 * acceleration[i] * t**2
    area = whole[i] + s[i] * t + 0.5 * speed[i] * t**2 + acceleration[i] * t**3 / 6.0
    area += np.minimum(times, 0.0) * s[0] + np.maximum(times - when[-1], 0.0) * s[-1]
    moving = (times > 0.0) & (times < when[-1])
    return area, place, np.where(moving, speed[i] + acceleration[i] * t, 0.0)


def _time_stretch(trajectory: Trajectory, limits: Limits, allowed: Array) -> float:
    """The factor by which the trajectory is too fast for its limits; at most 1 if it respects them all."""
    step = float(trajectory.times_s[1] - trajectory.times_s[0])
    jerk = np.diff(trajectory.qdd, axis=0) / step
    fast, quick = allowed[:, :1], allowed[:, 1:]
    used = (
        trajectory.qd / (limits.velocity * fast),
        trajectory.qdd / (limits.acceleration * quick),
        jerk / (limits.jerk * np.maximum(quick[:-1], quick[1:])),
    )
    excess: float = max(float(np.max(abs(share))) ** (1.0 / order) for order, share in enumerate(used, 1))
    return excess


def subdivide(lengths: Sequence[float], finest: int) -> Array:
    """Gridpoints along pieces of these lengths, each divided into ``finest`` intervals."""
    ends = np.concatenate(((0.0,), np.cumsum(lengths)))
    parts = [np.linspace(low, high, finest, endpoint=False) for low, high in pairwise(ends)]
    return np.concatenate([*parts, ends[-1:]])
