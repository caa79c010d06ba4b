"""Blends between two moves, and the hand-over from an arm in motion.

A blend adds two motions around their common waypoint W: leaving leg A, whose last r0 of path is run with linearly
decreasing speed, and entering leg B, whose first r1 of path is run with linearly increasing speed:

    position(u) = A(L - r0 (1-u)^2) + B(r1 u^2) - W,   u = t / T from 0 to 1

so the speed is always a convex combination of A's speed at the beginning (2 r0 / T) and B's at the end (2 r1 / T), and
cannot exceed the larger one. The blend starts at the speed that A's own profile has there, from which A could still
stop at W, so nothing is lost if no next move follows. Between two tool paths, positions and orientations are composed;
every other pair is added in joint space. A hand-over is the same with A = "coast to a standstill".
"""

from math import acos, cos, dist, sin, sqrt, tan
from typing import Protocol

from emulator.motion.faults import MotionWarning, blend_cut, waypoint_skipped
from emulator.motion.legs import ArcLeg, JointLeg, Leg, LineLeg, ToolLeg, mark_after_start
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, pose_add, pose_sub
from urproto.vectors import Vector3, as_six, lerp, norm3, scaled_sum3, sub

_TOUCHING_M = 1e-5  # blends that overlap by less only touch: programs often use radii of half a leg (guess)
_CORNERS_ROUNDED = (0.01, 2.8)  # rad: movep rounds corners with a turn in this range; others are blended by addition


class Leaving(Protocol):
    """The end of a motion: r0 of path, run with linearly decreasing speed."""

    duration: float
    corner: Joints

    def joints(self, u: float) -> Joints:
        """Configuration at 0 <= u <= 1; ``corner`` at u = 1."""


class LegEnd:
    """The rest of a leg from path length s, where the joints are at q, starting with the speed it has there."""

    def __init__(self, leg: Leg, s: float, speed: float, q: Joints) -> None:
        self.leg = leg
        self.rest = leg.length - s
        self.speed = speed
        self.duration = 2.0 * self.rest / speed
        self.corner = leg.joints(leg.length, q)
        self._way = sub(q, self.corner)

    def path(self, u: float) -> float:
        """Path length on the leg."""
        return self.leg.length - self.rest * (1.0 - u) ** 2

    def joints(self, u: float) -> Joints:
        near = lerp(self.corner, self._way, (1.0 - u) ** 2)
        return self.leg.joints(self.path(u), near)


class Coast:
    """An arm in motion brakes evenly: all joints come to rest together, on a straight line in joint space."""

    def __init__(self, q: Joints, qd: Joints, duration: float) -> None:
        self.duration = duration
        self._distance = as_six(0.5 * speed * duration for speed in qd)
        self.corner = lerp(q, self._distance, 1.0)

    def joints(self, u: float) -> Joints:
        return lerp(self.corner, self._distance, -((1.0 - u) ** 2))


class Blend:
    """Blend by addition in joint space. ``exit_s``, ``exit_speed``: where and how fast leg B continues after it."""

    def __init__(self, leaving: Leaving, entering: Leg, exit_speed: float) -> None:
        self.duration = leaving.duration
        self.exit_speed = exit_speed
        self.exit_s = 0.5 * exit_speed * self.duration
        self._leaving = leaving
        self._entering = entering

    def joints(self, t: float, q: Joints) -> Joints:
        """Configuration t seconds into the blend, coming from q."""
        u = t / self.duration
        left = sub(self._leaving.joints(u), self._leaving.corner)
        entered = self._entering.joints(self.exit_s * u * u, sub(q, left))
        return lerp(entered, left, 1.0)


class ToolBlend(Blend):
    """Blend of two tool paths: positions are added, orientations composed."""

    def __init__(self, leaving: LegEnd, before: ToolLeg, after: ToolLeg, exit_speed: float) -> None:
        super().__init__(leaving, after, exit_speed)
        self.before, self.after, self.leg_end = before, after, leaving
        self._corner = after.pose(0.0)

    def joints(self, t: float, q: Joints) -> Joints:
        return self.after.reach.follow(self.pose(t / self.duration), q)

    def pose(self, u: float) -> Pose:
        """TCP pose at 0 <= u <= 1."""
        entered = pose_sub(self.after.pose(self.exit_s * u * u), self._corner)
        return pose_add(entered, self.before.pose(self.leg_end.path(u)))


class RoundedCorner(ToolBlend):
    """Blend of two movep: a circular arc, run at constant tool speed."""

    def __init__(self, leaving: LegEnd, before: LineLeg, after: LineLeg, turn_rad: float) -> None:
        self._turn = turn_rad
        self._radius = leaving.rest / tan(0.5 * turn_rad)
        leaving.duration = self._radius * turn_rad / leaving.speed
        super().__init__(leaving, before, after, leaving.speed)
        self.exit_s = leaving.rest
        start = before.pose(leaving.path(0.0))
        self._start = (start[0], start[1], start[2])
        self._ahead = _unit(before)
        along = cos(turn_rad)
        self._aside = scaled_sum3(_unit(after), 1.0 / sin(turn_rad), self._ahead, -along / sin(turn_rad))

    def pose(self, u: float) -> Pose:
        angle = u * self._turn
        offset = scaled_sum3(self._ahead, self._radius * sin(angle), self._aside, self._radius * (1.0 - cos(angle)))
        position = scaled_sum3(self._start, 1.0, offset, 1.0)
        return (*position, *super().pose(u)[3:])


def blend_into(leaving: Leaving, entering: Leg, radius_m: float | None) -> Blend:
    """The blend from the end of a motion into a leg that starts at its corner.

    ``radius_m`` keeps the exit within this distance of the corner; None for a hand-over, which has no radius.
    """
    exit_speed = _exit_speed(leaving.duration, entering)
    if radius_m is not None:
        exit_speed = min(exit_speed, 2.0 * mark_after_start(entering, radius_m) / leaving.duration)
    if not isinstance(leaving, LegEnd):
        return Blend(leaving, entering, exit_speed)
    before = leaving.leg
    if not _same_tool(before, entering):
        return Blend(leaving, entering, exit_speed)
    if isinstance(before, LineLeg) and isinstance(entering, LineLeg) and before.process and entering.process:
        turn = _corner_to_round(leaving, before, entering)
        if turn is not None:
            return RoundedCorner(leaving, before, entering, turn)
    if isinstance(before, ToolLeg) and isinstance(entering, ToolLeg):
        return ToolBlend(leaving, before, entering, exit_speed)
    return Blend(leaving, entering, exit_speed)


def overlap(leg: Leg, radius_m: float, before_m: float) -> MotionWarning | None:
    """Warning about the blends at a leg's ends: ``before_m`` is the radius at its start, ``radius_m`` at its goal.

    C171: the waypoint at the goal has to be skipped, because both blends do not fit into the leg (Script Manual).
    If only one end has a blend, there is no overlap; a blend that is longer than the leg is cut (guess).
    """
    if radius_m <= 0.0 and before_m <= 0.0:
        return None
    distance = dist(leg.point(0.0), leg.point(leg.length))
    if radius_m + before_m <= distance + _TOUCHING_M:
        return None
    if radius_m > 0.0 and before_m > 0.0:
        return waypoint_skipped(_skipped(leg), radius_m, before_m, distance)
    return blend_cut(radius_m + before_m, distance) if leg.length > 0.0 else None


def _skipped(leg: Leg) -> int:
    """Argument of C171. There are four for movej and movel; their assignment is a guess."""
    if isinstance(leg, ArcLeg):
        return 0
    if isinstance(leg, JointLeg):
        return 4
    return 9 if isinstance(leg, LineLeg) and leg.process else 11


def _same_tool(before: Leg, after: Leg) -> bool:
    """False if the TCP was changed between two tool paths: their poses cannot be added then."""
    if isinstance(before, ToolLeg) and isinstance(after, ToolLeg):
        return before.reach.tcp_offset == after.reach.tcp_offset
    return True


def _exit_speed(duration: float, leg: Leg) -> float:
    """The highest speed reachable in this time within the leg's first half, from which the arm can still stop."""
    a = leg.limits.acceleration
    return min(leg.limits.speed, leg.length / duration, a * duration, sqrt(a * leg.length))


def _corner_to_round(leaving: LegEnd, before: LineLeg, after: LineLeg) -> float | None:
    """Angle by which the path turns, if an arc at constant speed fits into the corner; else None."""
    speed, rest = leaving.speed, leaving.rest
    straight_enough = before.is_translation and after.is_translation
    if not straight_enough or rest > 0.5 * after.length or speed > after.limits.speed:
        return None
    ahead, then = _unit(before), _unit(after)
    turn = acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(ahead, then, strict=True)))))
    if not _CORNERS_ROUNDED[0] < turn < _CORNERS_ROUNDED[1]:
        return None
    sideways = speed**2 * tan(0.5 * turn) / rest
    can_stop = speed**2 <= 2.0 * after.limits.acceleration * (after.length - rest)
    return turn if can_stop and sideways <= after.limits.acceleration else None


def _unit(leg: LineLeg) -> Vector3:
    x, y, z = leg.change[:3]
    size = norm3(x, y, z)
    return (x / size, y / size, z / size)
