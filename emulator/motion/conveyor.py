"""Conveyor tracking: the path moves along with a conveyor from the moment tracking begins.

The displacement follows the conveyor with bounded acceleration: it takes off without a jerk, catches up, and then is
where the conveyor is. Held (pause, protective stop) the arm stands, and catches up afterwards. That a real controller
does the same, and the bounds, are guesses.
"""

from math import pi
from typing import Protocol

from emulator.motion.axes import cross, of_rotation, unit
from emulator.motion.faults import conveyor_too_fast
from emulator.motion.follower import Follower
from emulator.motion.legs import TOOL_LIMITS
from emulator.motion.path_offset import LEVER_M
from emulator.motion.profile import Limits
from emulator.motion.vectors import Joints, Vec3, norm3
from urproto.robots.pose import Pose, pose_add, pose_inv, pose_trans

__all__ = ["Belt", "CircularConveyor", "LinearConveyor"]

_CATCHING_UP = Limits(0.25, 2.0)  # m/s beyond the conveyor's own speed, m/s2 (guess)
_SHORTEST_RADIUS_M = 0.05  # nearer to the centre a turning conveyor is followed as it is here


class Belt(Protocol):
    """What tells how far a conveyor went."""

    travel: float
    """Ticks, interpolated, never wrapped."""
    speed: float
    """Ticks/s."""


class _Conveyor:
    """``position``: how far the path has been taken along, in m or rad."""

    def __init__(self, belt: Belt, ticks_per_unit: float) -> None:
        self._belt = belt
        self._origin = belt.travel
        self._ticks = ticks_per_unit
        self._follower = Follower()

    @property
    def position(self) -> float:
        """How far the path has been taken along [m or rad]."""
        return self._follower.position

    def _advance(self, dt: float, radius: float, ramp: float | None) -> None:
        """``radius``: metres a unit of position moves the tool."""
        rate = self._belt.speed / self._ticks
        if ramp is not None:
            self._follower.brake(dt, ramp * LEVER_M / radius)
            return
        if abs(rate) * radius > TOOL_LIMITS.speed:
            raise conveyor_too_fast(rate * radius, TOOL_LIMITS.speed)
        bounds = Limits(_CATCHING_UP.speed / radius, _CATCHING_UP.acceleration / radius)
        self._follower.follow(dt, (self._belt.travel - self._origin) / self._ticks, rate, bounds)


class LinearConveyor(_Conveyor):
    """Moves along ``direction``, in the base frame, whose length does not count."""

    def __init__(self, belt: Belt, direction: Vec3, ticks_per_meter: float) -> None:
        super().__init__(belt, ticks_per_meter)
        self._direction = unit(direction, (1.0, 0.0, 0.0))

    def step(self, dt: float, path: Pose, shift: Joints, ramp: float | None) -> None:
        self._advance(dt, 1.0, ramp)

    def apply(self, pose: Pose) -> Pose:
        return pose_add(self._shift(self.position), pose)

    def undo(self, pose: Pose) -> Pose:
        return pose_add(self._shift(-self.position), pose)

    def _shift(self, length: float) -> Pose:
        x, y, z = self._direction
        return (length * x, length * y, length * z, 0.0, 0.0, 0.0)


class CircularConveyor(_Conveyor):
    """Turns about the z axis of ``center``, a pose in the base frame; positive ticks counter-clockwise (guess)."""

    def __init__(self, belt: Belt, center: Pose, ticks_per_revolution: float, *, rotate_tool: bool) -> None:
        super().__init__(belt, ticks_per_revolution / (2.0 * pi))
        self._center, self._inverse = center, pose_inv(center)
        self._axis = of_rotation(center)[2]
        self._rotate_tool = rotate_tool

    def step(self, dt: float, path: Pose, shift: Joints, ramp: float | None) -> None:
        self._advance(dt, max(self._radius(path), _SHORTEST_RADIUS_M), ramp)

    def _radius(self, pose: Pose) -> float:
        out = (pose[0] - self._center[0], pose[1] - self._center[1], pose[2] - self._center[2])
        return norm3(*cross(out, self._axis))

    def apply(self, pose: Pose) -> Pose:
        return self._turned(pose, self.position)

    def undo(self, pose: Pose) -> Pose:
        return self._turned(pose, -self.position)

    def _turned(self, pose: Pose, angle: float) -> Pose:
        turn = pose_trans(pose_trans(self._center, (0.0, 0.0, 0.0, 0.0, 0.0, angle)), self._inverse)
        there = pose_trans(turn, pose)
        return there if self._rotate_tool else (*there[:3], *pose[3:])
