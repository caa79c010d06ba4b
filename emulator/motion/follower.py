"""One number that follows a moving one: no lag behind constant speed, bounded acceleration, no overshoot from afar."""

from math import copysign, sqrt

from emulator.motion.profile import Limits

__all__ = ["Follower"]

_BANDWIDTH = 25.0  # rad/s, where no limit is reached: critically damped (guess)
_BRAKE_SHARE = 0.8  # of the acceleration is planned with on the way to a far target; the rest corrects
_ARRIVED = 1e-9  # m or rad: nearer to a standing target, and slower, it stands on it (guess)
_ARRIVED_SPEED = 1e-6


class Follower:
    """``position`` and ``speed`` in any unit; starts at 0 with the given speed."""

    def __init__(self, speed: float = 0.0) -> None:
        self.position = 0.0
        self.speed = speed

    def follow(self, dt: float, target: float, rate: float, limits: Limits) -> None:
        """Go after a target that moves at ``rate``; the limits are those of catching up."""
        error = target - self.position - rate * dt  # at the end of the period, keeping pace
        if rate == 0.0 and abs(error) < _ARRIVED and abs(self.speed) < _ARRIVED_SPEED:
            self.position, self.speed = target, 0.0
            return
        a = limits.acceleration
        closing = min(0.5 * _BANDWIDTH * abs(error), sqrt(2.0 * _BRAKE_SHARE * a * abs(error)), limits.speed)
        change = 2.0 * _BANDWIDTH * dt * (rate + copysign(closing, error) - self.speed)
        self._move(dt, self.speed + max(-a * dt, min(a * dt, change)))

    def brake(self, dt: float, deceleration: float) -> None:
        """Come to a standstill."""
        slower = max(0.0, abs(self.speed) - deceleration * dt)
        self._move(dt, copysign(slower, self.speed) if slower else 0.0)

    def _move(self, dt: float, speed: float) -> None:
        self.position += 0.5 * (self.speed + speed) * dt
        self.speed = speed
