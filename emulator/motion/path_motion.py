"""The generator of movej, movel, movep and movec: an optional blend, then the leg under its speed profile."""

from math import copysign, hypot, sqrt
from typing import Protocol

from emulator.motion.blends import Blend, LegEnd
from emulator.motion.legs import JointLeg, Leg, mark_before_end
from emulator.motion.profile import Limits, Profile
from emulator.motion.vectors import Joints, Vec3, norm3
from urproto.robots.pose import Pose

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


class Generator(Protocol):
    """One movement in progress.

    Each control period asks for a proposal, perhaps several times with ever shorter steps, and commits the last one.
    ``scaled`` generators run in stretched time (speed slider, pause, joint speed limits); the others, which bring the
    arm to rest, run by the clock.
    """

    scaled: bool

    def propose(self, h: float, q: Joints) -> Joints:
        """Configuration h seconds after the last commit, coming from q. Raises MotionFault when there is none."""

    def commit(self) -> None:
        """The last proposal came true."""

    @property
    def done(self) -> bool:
        """The arm has arrived and stands."""

    @property
    def ready(self) -> bool:
        """The program may go on."""

    def goal(self) -> Pose | None:
        """The TCP pose moved to, in the base frame; None when the movement has no goal."""


_TIME_TOLERANCE = 1e-9  # s: rounding of summed periods must not cost a whole period


class PathMotion:
    """Follows one leg; its time may run slower than the clock without leaving the path.

    ``ready`` as soon as the TCP is within ``radius_m`` of the goal: from then on a next move may blend in.
    """

    scaled = True

    def __init__(self, leg: Leg, radius_m: float = 0.0, blend: Blend | None = None) -> None:
        self.leg = leg
        self.radius_m = radius_m
        self._blend = blend
        self._t = 0.0  # in the blend while there is one, else on the leg's profile
        self._proposed: tuple[float, Blend | None] = (0.0, blend)
        self._exit_s = mark_before_end(leg, radius_m)
        self.profile = leg.profile
        if blend is not None:
            self.profile = Profile.plan(blend.exit_s, leg.length, leg.limits, blend.exit_speed)

    @property
    def uneven(self) -> bool:
        """The joints' speeds and accelerations are not known from the profile alone, as on a line in joint space."""
        return self._blend is not None or (self.profile.duration > 0.0 and not isinstance(self.leg, JointLeg))

    def propose(self, h: float, q: Joints) -> Joints:
        t, blend = self._t + h, self._blend
        if blend is not None:
            if t < blend.duration:
                self._proposed = (t, blend)
                return blend.joints(t, q)
            t -= blend.duration
        if t >= self.profile.duration - _TIME_TOLERANCE:
            t = self.profile.duration
        self._proposed = (t, None)
        return self.leg.joints(self.profile.position(t), q)

    def commit(self) -> None:
        self._t, self._blend = self._proposed

    @property
    def done(self) -> bool:
        return self._blend is None and self._t >= self.profile.duration

    @property
    def ready(self) -> bool:
        return self._blend is None and (self.done or self.profile.position(self._t) >= self._exit_s)

    def abort(self) -> bool:
        """Let the next move blend in from here; False when this move was not to be blended, and has to be stopped.

        Does nothing while this move is being blended into.
        """
        if self.radius_m <= 0.0:
            return False
        if self._blend is None:
            self._exit_s = min(self._exit_s, self.profile.position(self._t))
        return True

    @property
    def remaining_s(self) -> float:
        """Its own time until it has arrived."""
        on_leg = self.profile.duration - self._t
        return on_leg if self._blend is None else self.profile.duration + self._blend.duration - self._t

    def goal(self) -> Pose:
        return self.leg.goal()

    def leg_end(self, q: Joints) -> LegEnd | None:
        """What the next move can blend with when the arm is at q; None before the blend radius, and without one."""
        if not self.ready or self.done or self.radius_m <= 0.0:
            return None
        speed = self.profile.speed(self._t)
        s = self.profile.position(self._t)
        return LegEnd(self.leg, s, speed, q) if speed > 0.0 and s < self.leg.length else None
