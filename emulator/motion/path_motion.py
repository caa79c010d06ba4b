"""The generator of movej, movel, movep and movec: an optional blend, then the leg under its speed profile."""

from emulator.motion.blends import Blend, LegEnd
from emulator.motion.generator import Clock
from emulator.motion.legs import JointLeg, Leg, mark_before_end
from emulator.motion.profile import Profile
from urproto.robots.model import Joints
from urproto.robots.pose import Pose

_TIME_TOLERANCE = 1e-9  # s: rounding errors of summed periods must not cost a whole period


class PathMotion:
    """Follows one leg; its time may run slower than real time without leaving the path.

    ``ready`` as soon as the TCP is within ``radius_m`` of the goal: from then on, the next move may blend in.
    """

    clock = Clock.SCALED

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
        """Whether the joints' speeds are not known from the profile alone, unlike on a line in joint space."""
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
        """Let the next move blend in from here; False if this move has no blend radius and has to be stopped.

        Does nothing while this move itself is blending in.
        """
        if self.radius_m <= 0.0:
            return False
        if self._blend is None:
            self._exit_s = min(self._exit_s, self.profile.position(self._t))
        return True

    @property
    def remaining_s(self) -> float:
        """Remaining time, in the movement's own time."""
        on_leg = self.profile.duration - self._t
        return on_leg if self._blend is None else self.profile.duration + self._blend.duration - self._t

    def goal(self) -> Pose:
        return self.leg.goal()

    def leg_end(self, q: Joints) -> LegEnd | None:
        """The end of the leg for a blend when the arm is at q; None before the blend radius, and without one."""
        if not self.ready or self.done or self.radius_m <= 0.0:
            return None
        speed = self.profile.speed(self._t)
        s = self.profile.position(self._t)
        return LegEnd(self.leg, s, speed, q) if speed > 0.0 and s < self.leg.length else None
