"""Geometry of one move: where the arm is at a path length s, and how fast it may move there.

A leg is planned once, from a standstill at its start to a standstill at its end. Its path unit is m for tool paths
and rad of the leading joint for joint paths.
"""

from math import atan2, cos, pi, sin
from typing import Protocol

from emulator.motion.faults import MotionFault, path_out_of_reach
from emulator.motion.profile import Limits, Profile, choose_limits
from emulator.motion.reach import Reach
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, adder_to, pose_sub
from urproto.vectors import Vector3, add3, cross, dot, largest, lerp, norm3, scaled, scaled3, sub, sub3

# Upper bounds of a tool path's speed and acceleration [m/s, m/s2]. 1.5 m/s is the default tool speed limit of the
# safety configuration; the acceleration is a guess (the joints' 40 rad/s2 at a lever of 0.375 m).
TOOL_LIMITS = Limits(1.5, 15.0)

_BISECTIONS = 20  # 2**-20 of half a leg
_NO_WAY_M = 1e-9  # a shorter tool path counts as no movement: it is a rounding error of the present pose
_STRAIGHT = 1e-9  # m2: three points that span less than this area count as a line


class Leg(Protocol):
    """Geometry and limits of one move."""

    length: float
    limits: Limits
    profile: Profile

    def joints(self, s: float, near: Joints) -> Joints:
        """Joint configuration at path length s, nearest to ``near``. Raises MotionFault if there is none."""

    def pose(self, s: float) -> Pose:
        """TCP pose at path length s, in the base frame."""

    def point(self, s: float) -> Vector3:
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

    def point(self, s: float) -> Vector3:
        pose = self.pose(s)
        return (pose[0], pose[1], pose[2])

    def goal(self) -> Pose:
        return self._reach.pose(self._end)


class ToolLeg:
    """A path of the TCP. Subclasses define the pose; the joints follow by continuity, so query them along the path."""

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

    def point(self, s: float) -> Vector3:
        pose = self.pose(s)
        return (pose[0], pose[1], pose[2])

    def goal(self) -> Pose:
        return self.pose(self.length)


def mark_before_end(leg: Leg, radius_m: float) -> float:
    """Path length, in the second half, at which the TCP comes within a radius of the leg's end."""
    return _mark(leg, radius_m, leg.length, 0.5 * leg.length)


def mark_after_start(leg: Leg, radius_m: float) -> float:
    """Path length, in the first half, at which the TCP leaves a radius around the leg's start."""
    return _mark(leg, radius_m, 0.0, 0.5 * leg.length)


def _mark(leg: Leg, radius_m: float, centre_s: float, far_s: float) -> float:
    """Path length between centre_s and far_s at which the TCP is at this distance from its position at centre_s."""
    if radius_m <= 0.0:
        return centre_s
    centre = leg.point(centre_s)
    if norm3(*sub3(leg.point(far_s), centre)) <= radius_m:
        return far_s
    inside, outside = centre_s, far_s
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        if norm3(*sub3(leg.point(middle), centre)) < radius_m:
            inside = middle
        else:
            outside = middle
    return inside


def path_length(distance_m: float, angle_rad: float, equivalent_radius_m: float) -> float:
    """Length of a tool path: its distance, or its rotation at the equivalent radius if that is longer (guess)."""
    return max(distance_m, angle_rad * equivalent_radius_m)


class LineLeg(ToolLeg):
    """The TCP moves on a straight line while its orientation turns about one axis in proportion."""

    def __init__(
        self,
        reach: Reach,
        q_start: Joints,
        goal: Pose,
        wanted: Limits,
        duration_s: float = 0.0,
        *,
        process: bool = False,
    ) -> None:
        self._start = reach.pose(q_start)
        self._goal = goal
        self._beyond_start = adder_to(self._start)
        self.change = pose_sub(goal, self._start)
        self.process = process  # movep: rounds corners at constant speed
        distance = norm3(*self.change[:3])
        length = path_length(distance, norm3(*self.change[3:]), reach.model.eq_radius)
        # path length is the TCP's distance, unless turning takes longer
        self.is_translation = 0.0 < length == distance
        super().__init__(reach, length, wanted, duration_s)

    def pose(self, s: float) -> Pose:
        if s >= self.length:
            return self._goal
        return self._beyond_start(scaled(self.change, s / self.length))


class Circle:
    """An arc from a start point: centre, the two in-plane half axes (both ``radius`` long), angle to the end."""

    def __init__(self, centre: Vector3, first: Vector3, second: Vector3, axis: Vector3, angle: float) -> None:
        self.centre = centre
        self.first = first
        self.second = second
        self.axis = axis
        self.angle = angle
        self.radius = norm3(*first)


def circle_through(start: Vector3, via: Vector3, end: Vector3) -> Circle | None:
    """The arc from start through via to end; None if the three lie on a line (a full circle has no plane either)."""
    to_via, to_end = sub3(via, start), sub3(end, start)
    normal = cross(to_via, to_end)
    area = norm3(*normal)
    if area < _STRAIGHT:
        return None
    axis = scaled3(normal, 1.0 / area)
    vv, ee = dot(to_via, to_via), dot(to_end, to_end)
    towards_end = scaled3(cross(to_end, normal), vv)
    towards_via = scaled3(cross(normal, to_via), ee)
    offset = scaled3(add3(towards_end, towards_via), 0.5 / (area * area))
    centre = add3(start, offset)
    first = scaled3(offset, -1.0)
    second = cross(axis, first)
    arm = sub3(end, centre)
    angle = atan2(dot(arm, second), dot(arm, first)) % (2.0 * pi)
    return Circle(centre, first, second, axis, angle)


class ArcLeg(ToolLeg):
    """The TCP moves on a circular arc through a via point.

    ``fixed`` keeps the orientation constant relative to the arc (mode 1 of movec); otherwise it turns from the start's
    to the goal's orientation in proportion.
    """

    def __init__(
        self, reach: Reach, q_start: Joints, circle: Circle, goal: Pose, wanted: Limits, *, fixed: bool = False
    ) -> None:
        start = reach.pose(q_start)
        self._circle = circle
        self._turned = adder_to((0.0, 0.0, 0.0, *start[3:]))
        turn = scaled3(circle.axis, circle.angle) if fixed else pose_sub(goal, start)[3:]
        self._turn = turn
        self._goal = self._turned((*goal[:3], *turn)) if fixed else goal
        # in fixed mode, the arc itself turns the tool: that takes no extra time
        angle = 0.0 if fixed else norm3(*turn)
        length = path_length(circle.radius * circle.angle, angle, reach.model.eq_radius)
        super().__init__(reach, length, wanted)

    def pose(self, s: float) -> Pose:
        if s >= self.length:
            return self._goal
        f = s / self.length
        circle = self._circle
        angle = f * circle.angle
        position = add3(circle.centre, add3(scaled3(circle.first, cos(angle)), scaled3(circle.second, sin(angle))))
        return self._turned((*position, *scaled3(self._turn, f)))
