"""One move's geometry: where the arm is at a path length s, and how fast it may go there.

A leg is planned once, from a standstill at its start to a standstill at its end. Its path unit is m for tool paths
and rad of the leading joint for joint paths.
"""

from typing import Protocol

from emulator.motion.faults import MotionFault, path_out_of_reach
from emulator.motion.profile import Limits, Profile, choose_limits
from emulator.motion.reach import Reach
from emulator.motion.vectors import Joints, Vec3, largest, lerp, norm3, sub
from urproto.robots.pose import Pose

__all__ = ["TOOL_LIMITS", "JointLeg", "Leg", "ToolLeg", "mark_after_start", "mark_before_end"]

# Bounds of what a program may ask of a tool path [m/s, m/s2]. 1.5 m/s is the default tool speed limit of the safety
# configuration; the acceleration is a guess (the joints' 40 rad/s2 at a lever of 0.375 m).
TOOL_LIMITS = Limits(1.5, 15.0)

_BISECTIONS = 20  # 2**-20 of half a leg
_NO_WAY_M = 1e-9  # a tool path shorter than this leads nowhere: rounding of the pose that the arm has already


class Leg(Protocol):
    """Geometry and limits of one move."""

    length: float
    limits: Limits
    profile: Profile

    def joints(self, s: float, near: Joints) -> Joints:
        """Joint configuration at path length s, the one nearest to ``near``. Raises MotionFault when there is none."""

    def pose(self, s: float) -> Pose:
        """TCP pose at path length s, in the base frame."""

    def point(self, s: float) -> Vec3:
        """TCP position at path length s, in the base frame."""

    def goal(self) -> Pose:
        """TCP pose at the end, in the base frame."""


class JointLeg:
    """A straight line in joint space; all joints start and arrive together."""

    def __init__(self, reach: Reach, start: Joints, end: Joints, wanted: Limits, duration_s: float = 0.0) -> None:
        self._reach = reach
        self._start = start
        self._end = end
        self._change = sub(end, start)
        self.length = largest(self._change)
        self.limits = choose_limits(self.length, wanted, self._most(), duration_s)
        self.profile = Profile.plan(0.0, self.length, self.limits)

    def _most(self) -> Limits:
        """Speed and acceleration of the leading joint at which the first joint reaches its own limit."""
        model = self._reach.model
        shares = [max(abs(change) / self.length, 1e-9) for change in self._change] if self.length else [1.0] * 6
        return Limits(
            min(most / share for most, share in zip(model.qd_max, shares, strict=True)),
            min(most / share for most, share in zip(model.qdd_max, shares, strict=True)),
        )

    def joints(self, s: float, near: Joints | None = None) -> Joints:
        if s >= self.length:
            return self._end
        return lerp(self._start, self._change, s / self.length)

    def pose(self, s: float) -> Pose:
        return self._reach.pose(self.joints(s))

    def point(self, s: float) -> Vec3:
        pose = self.pose(s)
        return (pose[0], pose[1], pose[2])

    def goal(self) -> Pose:
        return self._reach.pose(self._end)


class ToolLeg:
    """A path of the TCP. A subclass says where the tool is; the joints follow by continuity: ask along the path."""

    def __init__(self, reach: Reach, length: float, wanted: Limits, duration_s: float = 0.0) -> None:
        self.reach = reach
        self.length = length = length if length > _NO_WAY_M else 0.0
        self.limits = choose_limits(length, wanted, TOOL_LIMITS, duration_s)
        self.profile = Profile.plan(0.0, length, self.limits)

    def pose(self, s: float) -> Pose:
        """TCP pose at path length s, in the base frame."""
        raise NotImplementedError

    def joints(self, s: float, near: Joints) -> Joints:
        pose = self.pose(s)
        try:
            return self.reach.joints(pose, near)
        except MotionFault:
            raise path_out_of_reach(pose, self.goal()) from None

    def point(self, s: float) -> Vec3:
        pose = self.pose(s)
        return (pose[0], pose[1], pose[2])

    def goal(self) -> Pose:
        return self.pose(self.length)


def mark_before_end(leg: Leg, radius_m: float) -> float:
    """Path length, in the second half, where the TCP comes within radius of the leg's end."""
    return _mark(leg, radius_m, leg.length, 0.5 * leg.length)


def mark_after_start(leg: Leg, radius_m: float) -> float:
    """Path length, in the first half, where the TCP gets out of radius of the leg's start."""
    return _mark(leg, radius_m, 0.0, 0.5 * leg.length)


def _mark(leg: Leg, radius_m: float, centre_s: float, far_s: float) -> float:
    """Between centre_s and far_s, where the TCP is at radius from its place at centre_s."""
    if radius_m <= 0.0:
        return centre_s
    centre = leg.point(centre_s)
    if _distance(leg.point(far_s), centre) <= radius_m:
        return far_s
    inside, outside = centre_s, far_s
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        if _distance(leg.point(middle), centre) < radius_m:
            inside = middle
        else:
            outside = middle
    return inside


def _distance(a: Vec3, b: Vec3) -> float:
    return norm3(a[0] - b[0], a[1] - b[1], a[2] - b[2])
