"""Circular tool paths: movec."""

from math import atan2, cos, pi, sin

from emulator.motion.legs import ToolLeg
from emulator.motion.profile import Limits
from emulator.motion.reach import Reach
from emulator.motion.tool_moves import path_length
from emulator.motion.vectors import Joints, Vec3, norm3
from urproto.robots.pose import Pose, pose_add, pose_sub

__all__ = ["ArcLeg", "Circle", "circle_through"]

_STRAIGHT = 1e-9  # m2: three points that span less than this area are taken as a line


class Circle:
    """An arc from a start point: centre, the two in-plane half axes (both ``radius`` long), angle to the end."""

    def __init__(self, centre: Vec3, first: Vec3, second: Vec3, axis: Vec3, angle: float) -> None:
        self.centre = centre
        self.first = first
        self.second = second
        self.axis = axis
        self.angle = angle
        self.radius = norm3(*first)


def circle_through(start: Vec3, via: Vec3, end: Vec3) -> Circle | None:
    """The arc from start over via to end; None when the three lie on a line (a full circle has no plane either)."""
    to_via, to_end = _minus(via, start), _minus(end, start)
    normal = _cross(to_via, to_end)
    area = norm3(*normal)
    if area < _STRAIGHT:
        return None
    axis = _times(normal, 1.0 / area)
    vv, ee = _dot(to_via, to_via), _dot(to_end, to_end)
    towards_end = _times(_cross(to_end, normal), vv)
    towards_via = _times(_cross(normal, to_via), ee)
    offset = _times(_plus(towards_end, towards_via), 0.5 / (area * area))
    centre = _plus(start, offset)
    first = _times(offset, -1.0)
    second = _cross(axis, first)
    arm = _minus(end, centre)
    angle = atan2(_dot(arm, second), _dot(arm, first)) % (2.0 * pi)
    return Circle(centre, first, second, axis, angle)


class ArcLeg(ToolLeg):
    """The TCP on a circular arc over a via point.

    ``fixed`` keeps the orientation constant relative to the arc (mode 1 of movec); otherwise it turns from the start's
    to the goal's orientation in step.
    """

    def __init__(
        self, reach: Reach, q_start: Joints, circle: Circle, goal: Pose, wanted: Limits, *, fixed: bool = False
    ) -> None:
        start = reach.pose(q_start)
        self._circle = circle
        self._orientation: Pose = (0.0, 0.0, 0.0, *start[3:])
        turn = _times(circle.axis, circle.angle) if fixed else pose_sub(goal, start)[3:]
        self._turn = turn
        self._goal = pose_add((*goal[:3], *turn), self._orientation) if fixed else goal
        # an arc in fixed mode turns the tool by its own angle: that costs nothing extra
        angle = 0.0 if fixed else norm3(*turn)
        length = path_length(circle.radius * circle.angle, angle, reach.model.eq_radius)
        super().__init__(reach, length, wanted)

    def pose(self, s: float) -> Pose:
        if s >= self.length:
            return self._goal
        f = s / self.length
        circle = self._circle
        angle = f * circle.angle
        position = _plus(circle.centre, _plus(_times(circle.first, cos(angle)), _times(circle.second, sin(angle))))
        return pose_add((*position, *_times(self._turn, f)), self._orientation)


def _plus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _times(a: Vec3, factor: float) -> Vec3:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def _dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vec3, b: Vec3) -> Vec3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
