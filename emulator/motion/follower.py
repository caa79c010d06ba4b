"""Following what moves: no lag behind constant speed, bounded acceleration, no overshoot from afar."""

from math import copysign, hypot, sqrt

from emulator.motion.profile import Limits
from emulator.motion.vectors import Vec3, norm3

__all__ = ["Follower", "braked", "pursuit"]

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
        change = 2.0 * _BANDWIDTH * dt * (rate + copysign(_closing(abs(error), limits), error) - self.speed)
        self._move(dt, self.speed + max(-a * dt, min(a * dt, change)))

    def brake(self, dt: float, deceleration: float) -> None:
        """Come to a standstill."""
        slower = max(0.0, abs(self.speed) - deceleration * dt)
        self._move(dt, copysign(slower, self.speed) if slower else 0.0)

    def _move(self, dt: float, speed: float) -> None:
        self.position += 0.5 * (self.speed + speed) * dt
        self.speed = speed


def pursuit(dt: float, missing: Vec3, velocity: Vec3, limits: Limits) -> Vec3:
    """A period later, the velocity of what is to go the way ``missing``; both are relative to what it follows."""
    far = hypot(*missing)
    share = _closing(far, limits) / far if far else 0.0
    gain = 2.0 * _BANDWIDTH * dt
    x, y, z = (gain * (share * way - speed) for way, speed in zip(missing, velocity, strict=True))
    size = norm3(x, y, z)
    cut = limits.acceleration * dt / size if size > limits.acceleration * dt else 1.0
    return (velocity[0] + cut * x, velocity[1] + cut * y, velocity[2] + cut * z)


def braked(dt: float, velocity: Vec3, deceleration: float) -> Vec3:
    """A period later, the velocity of what comes to a standstill."""
    size = norm3(*velocity)
    left = 1.0 - deceleration * dt / size if size > deceleration * dt else 0.0
    return (velocity[0] * left, velocity[1] * left, velocity[2] * left)


def _closing(far: float, limits: Limits) -> float:
    """How fast to go when the target is so far away."""
    return min(0.5 * _BANDWIDTH * far, sqrt(2.0 * _BRAKE_SHARE * limits.acceleration * far), limits.speed)
