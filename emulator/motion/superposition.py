"""What is added to the path of a movement: path offsets, a tracked frame, a conveyor.

The movement runs on its nominal path and knows nothing of this. Once a period each source says where it takes a pose
of that path, in the order: path offset, frame, conveyor. Sources move on by the clock, whatever the speed slider says;
while the movement is held (pause, protective stop) they stand still too, and go on from there afterwards.

A new source needs three things: ``step`` to move on, ``apply`` to displace a pose, ``undo`` to take that back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, radians
from typing import Protocol

from emulator.motion.faults import MotionFault, sudden_jump
from emulator.motion.movement import ActiveMovement
from emulator.motion.reach import Reach
from emulator.motion.target import ArmTarget
from emulator.motion.tracking import LEVER_M, FrameTracking
from urproto.compat import IntEnum
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, axes_of, pose_add, pose_inv, pose_sub, pose_trans
from urproto.vectors import ZERO6, Axes, Vector3, as_six, cross, into6, largest, lerp, norm3, out_of6, scaled, sub, unit

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
        self._target: Joints = ZERO6
        self._filtered: Joints = ZERO6
        self._coasted: Joints = ZERO6
        self._speed: Joints = ZERO6  # of the applied offset
        self._applied: Joints = ZERO6
        self._path: Pose | None = None
        self._axes: Axes | None = None  # of the MOTION frame

    def set(self, offset: Joints, frame: OffsetFrame) -> None:
        """Another offset [m, rotation vector], from the next period on."""
        if frame is not self._frame:
            self._filtered = self.get(frame)  # the filter goes on from what is applied now
            self._coasted, self._frame = ZERO6, frame
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
        if self._coasted != ZERO6:
            self._coasted = scaled(self._coasted, exp(-dt / _FADE_S)) if largest(self._coasted) > _SAME else ZERO6
        self._applied = lerp(self._filtered, self._coasted, 1.0)
        self._speed = scaled(sub(self._applied, before), 1.0 / dt)

    def _coast(self, dt: float, ramp: float) -> None:
        size = max(norm3(*self._speed[:3]) / LEVER_M, norm3(*self._speed[3:]))
        self._speed = scaled(self._speed, 1.0 - ramp * dt / size) if size > ramp * dt else ZERO6
        self._coasted = lerp(self._coasted, self._speed, dt)
        self._applied = lerp(self._filtered, self._coasted, 1.0)

    def apply(self, pose: Pose) -> Pose:
        offset = self._applied
        if offset == ZERO6:
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


def _motion_axes(path: Pose, before: Axes | None, along: Vector3 | None = None) -> Axes:
    """Axes of the MOTION frame; the last ones where there is no direction, the tool's x before there was any."""
    tool_x, _, tool_z = axes_of(path)
    x = unit(along, tool_x) if along is not None else tool_x
    aside = cross(x, tool_z)
    if norm3(*aside) < 1e-6:
        return before if before is not None else axes_of(path)
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
    """The sources in force, and where they take the path.

    ``q``, ``qd``: there [rad, rad/s], as long as anything is ``active``. ``settings``: of path offsets. ``lost``: the
    fault that ended it all; poses of the program that runs no longer mean what they did.
    """

    def __init__(self, target: ArmTarget, movement: ActiveMovement) -> None:
        self.settings = OffsetSettings()
        self.lost: MotionFault | None = None
        self.active = False
        self.q, self.qd = target.q, ZERO6
        self._target, self._movement = target, movement
        self._sources: dict[Kind, Source] = {}
        self._path: tuple[Reach, Joints, Pose] | None = None  # the last period's TCP, path joints and path pose
        self._pose: Pose | None = None  # the last displaced pose

    # what a program asks for

    def enable_path_offset(self) -> None:
        """Begin to apply an offset, zero at first. Does nothing when that is so already."""
        if self._path_offset is None:
            self._add(Kind.PATH_OFFSET, PathOffset(self.settings))

    def set_path_offset(self, offset: Sequence[float], frame: OffsetFrame) -> None:
        """The offset to apply from now on [m, rotation vector]; without effect unless enabled (guess)."""
        if self._path_offset is not None:
            self._path_offset.set(as_six(offset), frame)

    def path_offset(self, frame: OffsetFrame) -> Pose:
        """The offset applied just now, as one of this frame; zero unless enabled."""
        return ZERO6 if self._path_offset is None else self._path_offset.get(frame)

    def track(self, conveyor: Source) -> None:
        """Take the path along with a conveyor. Raises ValueError while one is tracked."""
        if Kind.CONVEYOR in self._sources:
            raise ValueError("a conveyor is tracked already: call stop_conveyor_tracking() first")
        self._add(Kind.CONVEYOR, conveyor)

    def track_frame(self, frame: FrameTracking) -> None:
        """Take the path along with a frame. Raises ValueError while one is tracked."""
        if self.tracked_frame is not None:
            raise ValueError("a frame is tracked already: call frame_tracking_disable() first")
        self._add(Kind.FRAME, frame)

    @property
    def tracked_frame(self) -> FrameTracking | None:
        """The frame that the path is taken along with."""
        source = self._sources.get(Kind.FRAME)
        return source if isinstance(source, FrameTracking) else None

    @property
    def _path_offset(self) -> PathOffset | None:
        source = self._sources.get(Kind.PATH_OFFSET)
        return source if isinstance(source, PathOffset) else None

    def _add(self, kind: Kind, source: Source) -> None:
        """Begin to apply a source. The first one takes the path to where it is already: nothing jumps."""
        if not self.active:
            self.active = True
            self.q, self.qd = self._movement.q, self._movement.qd
            self._path, self._pose = None, None
        self._sources = dict(sorted({**self._sources, kind: source}.items()))

    # ending it: what a source did to the path so far stays, since the arm must not jump back

    def end(self, kind: Kind) -> None:
        """Apply a source no more. Raises MotionFault when the path cannot be where that has taken it."""
        if self._sources.pop(kind, None) is None:
            return
        if self._sources:
            self._movement.put(self._path_for(self.q), self._movement.qd)
        else:
            self.release()

    def release(self) -> None:
        """Displace the path no more: it is where it has been taken."""
        if self.active:
            self._movement.put(self.q, self.qd)
            self.clear()

    def clear(self) -> None:
        """Displace the path no more, wherever it is."""
        self.active, self._sources = False, {}

    def lose(self, fault: MotionFault) -> None:
        """A fault ends it. The program must not go on as if its path were displaced."""
        if self.active:
            self.lost = fault
            self.clear()

    def program_stopped(self) -> None:
        """The next program begins without settings and loss; what is in force goes on until the arm is stopped."""
        self.settings, self.lost = OffsetSettings(), None

    def rejoin(self) -> bool:
        """Take what brought the arm to where it is, beside its path, as part of the path; False when none leads here.

        So the next movement, which starts from the path, can take that back.
        """
        target = self._target
        try:
            self._movement.put(self._path_for(target.q), self._movement.qd)
        except MotionFault:
            return False
        self.q, self.qd = target.q, target.qd
        return True

    def _path_for(self, q: Joints) -> Joints:
        """The path joints that are taken to q. Raises MotionFault when they are out of reach."""
        reach = self._target.reach
        pose = reach.pose(q)
        for source in reversed(self._sources.values()):
            pose = source.undo(pose)
        self._path, self._pose = None, None
        return reach.joints(pose, self._movement.q)

    # one control period

    def advance(self, path: Joints) -> tuple[Joints, Joints]:
        """One period, at the end of which the movement is at ``path``: where that is taken, before and after it.

        Raises MotionFault when a joint cannot follow.
        """
        reach, before = self._target.reach, self._path
        pose = self._path_pose(reach, path)
        shift = pose_sub(pose, before[2]) if before is not None and before[0] is reach else ZERO6
        self._path = (reach, path, pose)
        ramp = None if self._movement.running else self._movement.ramp
        # In the order of `Kind`: what is tracked carries the offset along.
        for source in self._sources.values():
            source.step(self._target.period_s, pose, shift, ramp)
            pose = source.apply(pose)
        start = self.q
        # The way back from a pose to joints rounds: an arm at rest must not move by that.
        q = start if pose == self._pose else reach.joints(pose, start)
        self._pose = pose
        self._judge(reach, q)
        return start, q

    def _path_pose(self, reach: Reach, path: Joints) -> Pose:
        """TCP on the path."""
        if self._path is not None and self._path[0] is reach and self._path[1] == path:
            return self._path[2]
        return reach.pose(path)

    def _judge(self, reach: Reach, q: Joints) -> None:
        period_s = self._target.period_s
        qd = ZERO6 if q == self.q else scaled(sub(q, self.q), 1.0 / period_s)
        model = reach.model
        limits = zip(qd, self.qd, model.qd_max, model.qdd_max, strict=True)
        for joint, (now, before, most, acceleration) in enumerate(limits):
            sudden = abs(now - before) > _SUDDEN * acceleration * period_s
            if sudden or abs(now) > most * (1.0 + _TOLERANCE):
                raise sudden_jump(joint, now - before, now)
        self.q, self.qd = q, qd
