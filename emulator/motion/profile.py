"""Trapezoidal speed profiles along a path: speed up, cruise, slow down to rest at the end."""

from dataclasses import dataclass
from math import sqrt

_SHARE = 3.0  # a timed move accelerates for a third of its time and decelerates for a third (guess)
_LONGEST_S = 1e9  # longer moves are planned as 30 years, because their acceleration would round to 0


@dataclass(frozen=True, slots=True)
class Limits:
    """Speed and acceleration along a path, in path units (m or rad) per s and s2; both positive."""

    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Profile:
    """Distance over time from ``start`` to ``end`` on a path, ending at rest.

    Begins with ``start_speed`` and never exceeds ``limits``. Create it with `Profile.plan`.
    """

    start: float
    end: float
    start_speed: float
    peak_speed: float
    acceleration: float
    t_cruise: float
    t_brake: float
    duration: float

    @classmethod
    def plan(cls, start: float, end: float, limits: Limits, start_speed: float = 0.0) -> "Profile":
        """The fastest trapezoid within the limits. ``start_speed`` must allow stopping before ``end``."""
        length = end - start
        if length <= 0.0:
            return cls(end, end, 0.0, 0.0, limits.acceleration, 0.0, 0.0, 0.0)
        a = limits.acceleration
        start_speed = min(start_speed, limits.speed, sqrt(2.0 * a * length))
        peak = max(start_speed, min(limits.speed, sqrt(a * length + 0.5 * start_speed**2)))
        cruise = max(0.0, length - (2.0 * peak**2 - start_speed**2) / (2.0 * a))
        t_cruise = (peak - start_speed) / a
        t_brake = t_cruise + cruise / peak
        return cls(start, end, start_speed, peak, a, t_cruise, t_brake, t_brake + peak / a)

    def position(self, t: float) -> float:
        """Position on the path after t seconds; exactly ``end`` from ``duration`` on."""
        if t >= self.duration:
            return self.end
        if t < self.t_cruise:
            return self.start + t * (self.start_speed + 0.5 * self.acceleration * t)
        if t >= self.t_brake:
            return self.end - 0.5 * self.acceleration * (self.duration - t) ** 2
        ramp = 0.5 * (self.start_speed + self.peak_speed) * self.t_cruise
        return self.start + ramp + self.peak_speed * (t - self.t_cruise)

    def speed(self, t: float) -> float:
        """Speed along the path after t seconds."""
        if t >= self.duration:
            return 0.0
        if t < self.t_cruise:
            return self.start_speed + self.acceleration * t
        if t >= self.t_brake:
            return self.acceleration * (self.duration - t)
        return self.peak_speed


def limits_for_duration(length: float, duration_s: float, most: Limits) -> Limits:
    """Limits with which `Profile.plan` takes exactly ``duration_s`` for ``length`` from rest to rest.

    If that is faster than ``most`` allows, ``most`` is returned: the move takes longer than requested.
    """
    if length <= 0.0:
        return most
    duration_s = min(duration_s, _LONGEST_S)
    speed = min(length / duration_s * _SHARE / (_SHARE - 1.0), most.speed)
    spare = speed * duration_s - length
    if spare > 0.0 and speed**2 / spare <= most.acceleration:
        return Limits(speed, speed**2 / spare)
    a = most.acceleration
    root = (a * duration_s) ** 2 - 4.0 * a * length
    if root < 0.0:
        return most
    speed = 0.5 * (a * duration_s - sqrt(root))
    return Limits(speed, a) if speed <= most.speed else most


def choose_limits(length: float, wanted: Limits, most: Limits, duration_s: float) -> Limits:
    """Limits for a leg: from the duration if it is positive, else the requested ones; never above ``most``."""
    if duration_s > 0.0:
        return limits_for_duration(length, duration_s, most)
    return Limits(min(wanted.speed, most.speed), min(wanted.acceleration, most.acceleration))
