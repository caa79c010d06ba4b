"""What is added to the path of a movement: path offsets, a tracked frame, a conveyor.

The movement runs on its nominal path and knows nothing of this. Once a period each source says where it takes a pose
of that path, in the order: path offset, frame, conveyor. Sources move on by the clock, whatever the speed slider says;
while the movement is held (pause, protective stop) they stand still too, and go on from there afterwards.

A new source needs three things: ``step`` to move on, ``apply`` to displace a pose, ``undo`` to take that back.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import exp, pi, radians
from typing import Protocol

from emulator.motion.faults import conveyor_too_fast, sudden_jump
from emulator.motion.legs import TOOL_LIMITS
from emulator.motion.path_motion import Follower
from emulator.motion.profile import Limits
from emulator.motion.reach import Reach
from emulator.motion.vectors import (
    ZERO,
    Axes,
    Joints,
    Vec3,
    as_six,
    cross,
    into6,
    largest,
    lerp,
    norm3,
    of_rotation,
    out_of6,
    scaled,
    sub,
    unit,
)
from urproto.robots.pose import Pose, pose_add, pose_inv, pose_sub, pose_trans

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


_SUDDEN = 5.0  # times a joint's acceleration limit: a displacement that asks for more is a jump (guess)
_TOLERANCE = 1e-6


class Kind(IntEnum):
    """There is one source of each kind at most; they apply in this order."""

    PATH_OFFSET = 0
    FRAME = 1
    CONVEYOR = 2


class Source(Protocol):
    """One thing added to the path."""

    def step(self, dt: float, path: Pose, shift: Joints, ramp: float | None) -> None:
        """One period: the path's pose, and how that changed in this period (pose_sub).

        ``ramp``: None while running, else come to a standstill, as a leading joint would with this deceleration
        [rad/s2]. Raises MotionFault when it cannot be.
        """

    def apply(self, pose: Pose) -> Pose:
        """Where this takes a pose of the path, in the base frame."""

    def undo(self, pose: Pose) -> Pose:
        """The pose of the path that is taken to this one."""


class Superposition:
    """The sources in force, and the joints they lead to.

    ``q`` and ``qd``: where the nominal path is taken to, and the speed of that [rad, rad/s].
    """

    def __init__(self, period_s: float, q: Joints, qd: Joints) -> None:
        self.sources: dict[Kind, Source] = {}
        self.q, self.qd = q, qd
        self._period = period_s
        self._path: tuple[Reach, Joints, Pose] | None = None  # the last period's TCP, path joints and path pose
        self._pose: Pose | None = None  # the last displaced pose

    def add(self, kind: Kind, source: Source) -> None:
        """Begin to apply a source, in place of one of its kind."""
        self.sources[kind] = source
        self.sources = dict(sorted(self.sources.items()))

    def path_pose(self, reach: Reach, path: Joints) -> Pose:
        """TCP on the nominal path."""
        if self._path is not None and self._path[0] is reach and self._path[1] == path:
            return self._path[2]
        return reach.pose(path)

    def advance(self, reach: Reach, path: Joints, ramp: float | None) -> Joints:
        """One period, at the end of which the movement is at ``path``; where the sources take that.

        Raises MotionFault when a joint cannot follow.
        """
        pose = self.path_pose(reach, path)
        before = self._path
        shift = pose_sub(pose, before[2]) if before is not None and before[0] is reach else ZERO
        self._path = (reach, path, pose)
        for source in self.sources.values():
            source.step(self._period, pose, shift, ramp)
            pose = source.apply(pose)
        q = self.q if pose == self._pose else reach.joints(pose, self.q)
        self._pose = pose
        self._judge(reach, q)
        return q

    def path_for(self, reach: Reach, q: Joints, path_near: Joints) -> Joints:
        """The path joints that are taken to q. Raises MotionFault when they are out of reach."""
        pose = reach.pose(q)
        for source in reversed(self.sources.values()):
            pose = source.undo(pose)
        self._path, self._pose = None, None
        return reach.joints(pose, path_near)

    def _judge(self, reach: Reach, q: Joints) -> None:
        qd = ZERO if q == self.q else scaled(sub(q, self.q), 1.0 / self._period)
        model = reach.model
        limits = zip(qd, self.qd, model.qd_max, model.qdd_max, strict=True)
        for joint, (now, before, most, acceleration) in enumerate(limits):
            sudden = abs(now - before) > _SUDDEN * acceleration * self._period
            if sudden or abs(now) > most * (1.0 + _TOLERANCE):
                raise sudden_jump(joint, now - before, now)
        self.q, self.qd = q, qd
