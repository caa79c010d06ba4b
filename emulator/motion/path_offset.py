"""path_offset_*: a Cartesian offset that a program gives anew in each period, added to the path.

While the movement is held (pause, protective stop) the offset coasts to a standstill; how far it went fades away once
the movement goes on. How a real controller does this is not known.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import exp, radians

from emulator.motion.axes import Axes, cross, into6, of_rotation, out_of6, unit
from emulator.motion.vectors import ZERO, Joints, Vec3, as_six, largest, lerp, norm3, scaled, sub
from urproto.robots.pose import Pose, pose_add, pose_inv, pose_sub, pose_trans

__all__ = ["LEVER_M", "OffsetFrame", "OffsetSettings", "PathOffset"]

LEVER_M = 0.25  # from a leading joint to the tool: turns a deceleration of joints into one of the tool (guess)
_SAME = 1e-9  # m, rad: a filtered offset nearer to the given one than this is that one (guess)
_STANDING_M = 1e-9  # a shorter way in one period has no direction
_FADE_S = 0.05  # how soon the coasted way is taken back (guess)


class OffsetFrame(IntEnum):
    """path_offset_set's type: what the offset is given in."""

    BASE = 1  # axes of the base; turns about the TCP
    TCP = 2
    MOTION = 3  # x along the path, y = x cross the tool's z, z = x cross y
    WORLD = 4  # the offset is the base in the world, and the path is meant in the world


@dataclass(slots=True)
class OffsetSettings:
    """What outlives path_offset_disable: the filter's share of the new value, and limits a axis [m, rad]."""

    alpha: float = 1.0
    translation_limit: float = 0.1  # Script Manual, path_offset_set_max_offset
    rotation_limit: float = radians(30.0)

    def limited(self, offset: Joints) -> Joints:
        """The offset, each component within its limit."""
        far, turned = self.translation_limit, self.rotation_limit
        bounds = (far, far, far, turned, turned, turned)
        return as_six(max(-bound, min(bound, value)) for value, bound in zip(offset, bounds, strict=True))


class PathOffset:
    """The offset in force; zero until one is set."""

    def __init__(self, settings: OffsetSettings) -> None:
        self._settings = settings
        self._frame = OffsetFrame.BASE
        self._target: Joints = ZERO
        self._filtered: Joints = ZERO
        self._coasted: Joints = ZERO
        self._speed: Joints = ZERO  # of the applied offset
        self._applied: Joints = ZERO
        self._path: Pose | None = None
        self._axes: Axes | None = None  # of the MOTION frame

    def set(self, offset: Joints, frame: OffsetFrame) -> None:
        """Another offset [m, rotation vector], from the next period on."""
        if frame is not self._frame:
            self._filtered = self.get(frame)  # the filter goes on from what is applied now
            self._coasted, self._frame = ZERO, frame
        self._target = self._settings.limited(offset)

    def get(self, frame: OffsetFrame) -> Pose:
        """The offset applied now, as one of this frame."""
        if frame is self._frame or self._path is None:
            return self._applied
        path, there = self._path, self.apply(self._path)
        if frame is OffsetFrame.BASE:
            return pose_sub(there, path)
        if frame is OffsetFrame.TCP:
            return pose_trans(pose_inv(path), there)
        if frame is OffsetFrame.WORLD:
            return pose_trans(path, pose_inv(there))
        return into6(self._axes or _motion_axes(path, None), pose_sub(there, path))

    def step(self, dt: float, path: Pose, shift: Joints, ramp: float | None) -> None:
        self._path = path
        if self._axes is None or norm3(*shift[:3]) > _STANDING_M:
            self._axes = _motion_axes(path, self._axes, shift[:3])
        if ramp is None:
            self._follow(dt)
        else:
            self._coast(dt, ramp)

    def _follow(self, dt: float) -> None:
        before, missing = self._applied, sub(self._target, self._filtered)
        near = largest(missing) <= _SAME
        self._filtered = self._target if near else lerp(self._filtered, missing, self._settings.alpha)
        if self._coasted != ZERO:
            self._coasted = scaled(self._coasted, exp(-dt / _FADE_S)) if largest(self._coasted) > _SAME else ZERO
        self._applied = lerp(self._filtered, self._coasted, 1.0)
        self._speed = scaled(sub(self._applied, before), 1.0 / dt)

    def _coast(self, dt: float, ramp: float) -> None:
        size = max(norm3(*self._speed[:3]) / LEVER_M, norm3(*self._speed[3:]))
        self._speed = scaled(self._speed, 1.0 - ramp * dt / size) if size > ramp * dt else ZERO
        self._coasted = lerp(self._coasted, self._speed, dt)
        self._applied = lerp(self._filtered, self._coasted, 1.0)

    def apply(self, pose: Pose) -> Pose:
        offset = self._applied
        if offset == ZERO:
            return pose
        if self._frame is OffsetFrame.TCP:
            return pose_trans(pose, offset)
        if self._frame is OffsetFrame.WORLD:
            return pose_trans(pose_inv(offset), pose)
        return pose_add(self._in_base(), pose)

    def undo(self, pose: Pose) -> Pose:
        offset = self._applied
        if self._frame is OffsetFrame.TCP:
            return pose_trans(pose, pose_inv(offset))
        if self._frame is OffsetFrame.WORLD:
            return pose_trans(offset, pose)
        return pose_add(scaled(self._in_base(), -1.0), pose)

    def _in_base(self) -> Joints:
        if self._frame is OffsetFrame.MOTION and self._axes is not None:
            return out_of6(self._axes, self._applied)
        return self._applied


def _motion_axes(path: Pose, before: Axes | None, along: Vec3 | None = None) -> Axes:
    """Axes of the MOTION frame; the last ones where there is no direction, the tool's x before there was any."""
    tool_x, _, tool_z = of_rotation(path)
    x = unit(along, tool_x) if along is not None else tool_x
    aside = cross(x, tool_z)
    if norm3(*aside) < 1e-6:
        return before if before is not None else of_rotation(path)
    y = unit(aside, tool_x)
    return x, y, cross(x, y)
