"""Displacements added to the path of a movement: path offsets, a tracked frame, a conveyor.

The movement runs on its nominal path and is not affected. Once a period, each source displaces the pose on that path,
in the order path offset, frame, conveyor. Sources are independent of the speed slider. Path offsets, which a program
commands, advance in its time; frames and conveyors, which move by themselves, in real time. While the movement is held
(pause, protective stop), they all stand still, and continue from there afterwards.

A new source needs three methods: ``step`` to advance, ``apply`` to displace a pose, and ``undo`` to reverse that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Protocol

from emulator.motion.faults import Displacement, MotionFault, displaced_too_fast, sudden_jump
from emulator.motion.movement import ActiveMovement
from emulator.motion.reach import Reach
from emulator.motion.target import ArmTarget
from emulator.motion.tracking import FrameTracking, Tick
from urproto.compat import IntEnum
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, axes_of, pose_add, pose_inv, pose_sub, pose_trans
from urproto.vectors import (
    ZERO6,
    Axes,
    Vector3,
    as_six,
    cross,
    into6,
    largest,
    lerp,
    norm3,
    out_of6,
    scaled,
    scaled_sub,
    sub,
    unit,
)

_SAME = 1e-9  # m, rad: a filtered offset this close to the commanded one is set to it (guess)
_STANDING_M = 1e-9  # a shorter displacement in one period has no direction
_SUDDEN = 5.0  # times a joint's acceleration limit: a displacement that demands more is a jump (guess)
_TOLERANCE = 1e-6


class OffsetFrame(IntEnum):
    """path_offset_set's type: the frame in which the offset is given."""

    BASE = 1  # axes of the base; rotation about the TCP
    TCP = 2
    MOTION = 3  # x along the path, y = x cross the tool's z, z = x cross y
    WORLD = 4  # the offset is the pose of the base in the world, and the path is given in the world


@dataclass(slots=True)
class OffsetSettings:
    """Settings that survive path_offset_disable: the filter's weight of a new value, and limits per axis [m, rad]."""

    alpha: float = 1.0
    translation_limit: float = 0.1  # Script Manual, path_offset_set_max_offset
    rotation_limit: float = radians(30.0)

    def limited(self, offset: Joints) -> Joints:
        """The offset with each component limited."""
        far, turned = self.translation_limit, self.rotation_limit
        bounds = (far, far, far, turned, turned, turned)
        return as_six(max(-bound, min(bound, value)) for value, bound in zip(offset, bounds, strict=True))


class PathOffset:
    """The active path offset; zero until one is set, and filtered when it changes."""

    def __init__(self, settings: OffsetSettings) -> None:
        self._settings = settings
        self._frame = OffsetFrame.BASE
        self._target: Joints = ZERO6
        self._applied: Joints = ZERO6
        self._left = 1.0  # of the frame of the program in which the target is to be reached
        self._path: Pose | None = None
        self._axes: Axes | None = None  # of the MOTION frame

    def set(self, offset: Joints, frame: OffsetFrame) -> None:
        """Set another offset [m, rotation vector], from the next period on."""
        if frame is not self._frame:
            self._applied, self._frame = self.get(frame), frame  # the filter continues from the offset applied now
        self._target, self._left = self._settings.limited(offset), 1.0

    def get(self, frame: OffsetFrame) -> Pose:
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

    def step(self, tick: Tick, path: Pose, shift: Joints) -> None:
        self._path = path
        if self._axes is None or norm3(*shift[:3]) > _STANDING_M:
            self._axes = _motion_axes(path, self._axes, shift[:3])
        missing = sub(self._target, self._applied)
        near = largest(missing) <= _SAME
        share = min(1.0, tick.pace / self._left)
        self._applied = self._target if near else lerp(self._applied, missing, self._settings.alpha * share)
        self._left = self._left - tick.pace if share < 1.0 else 1.0

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
    """Axes of the MOTION frame; without a direction of motion the last ones, and at first along the tool's x axis."""
    tool_x, _, tool_z = axes_of(path)
    x = unit(along, tool_x) if along is not None else tool_x
    aside = cross(x, tool_z)
    if norm3(*aside) < 1e-6:
        return before if before is not None else axes_of(path)
    y = unit(aside, tool_x)
    return x, y, cross(x, y)


class Kind(IntEnum):
    """Kinds of sources, at most one of each; they apply in this order."""

    PATH_OFFSET = 0
    FRAME = 1
    CONVEYOR = 2


class Source(Protocol):
    """One displacement added to the path."""

    def step(self, tick: Tick, path: Pose, shift: Joints) -> None:
        """Advance one period, given the path's pose and its change in this period (pose_sub).

        Raises MotionFault if the source cannot be followed.
        """

    def apply(self, pose: Pose) -> Pose:
        """Displace a pose of the path, in the base frame."""

    def undo(self, pose: Pose) -> Pose:
        """The pose of the path that is displaced to this one."""


class Superposition:
    """The active sources and the displaced path.

    ``q``, ``qd``: the displaced path [rad, rad/s] while anything is ``active``. ``settings``: of path offsets.
    ``lost``: the fault that ended all displacements; poses of the running program are no longer valid then.
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

    # commands of a program

    def enable_path_offset(self) -> None:
        """Start applying an offset, zero at first. Does nothing if one is active already."""
        if self._path_offset is None:
            self._add(Kind.PATH_OFFSET, PathOffset(self.settings))

    def set_path_offset(self, offset: Sequence[float], frame: OffsetFrame) -> None:
        """Set the offset to apply [m, rotation vector]; without effect unless enabled (guess)."""
        if self._path_offset is not None:
            self._path_offset.set(as_six(offset), frame)

    def path_offset(self, frame: OffsetFrame) -> Pose:
        """The offset applied now, expressed in this frame; zero unless enabled."""
        return ZERO6 if self._path_offset is None else self._path_offset.get(frame)

    def track(self, conveyor: Source) -> None:
        """Move the path along with a conveyor. Raises ValueError while one is tracked."""
        if Kind.CONVEYOR in self._sources:
            raise ValueError("a conveyor is already being tracked: call stop_conveyor_tracking() first")
        self._add(Kind.CONVEYOR, conveyor)

    def track_frame(self, frame: FrameTracking) -> None:
        """Move the path along with a frame. Raises ValueError while one is tracked."""
        if self.tracked_frame is not None:
            raise ValueError("a frame is already being tracked: call frame_tracking_disable() first")
        self._add(Kind.FRAME, frame)

    @property
    def tracked_frame(self) -> FrameTracking | None:
        source = self._sources.get(Kind.FRAME)
        return source if isinstance(source, FrameTracking) else None

    @property
    def _path_offset(self) -> PathOffset | None:
        source = self._sources.get(Kind.PATH_OFFSET)
        return source if isinstance(source, PathOffset) else None

    def _add(self, kind: Kind, source: Source) -> None:
        """Start applying a source. The first one starts at the present path, so nothing jumps."""
        if not self.active:
            self.active = True
            self.q, self.qd = self._movement.q, self._movement.qd
            self._path, self._pose = None, None
        self._sources = dict(sorted({**self._sources, kind: source}.items()))

    # ending: the displacement so far stays part of the path, because the arm must not jump back

    def end(self, kind: Kind) -> None:
        """Stop applying a source. Raises MotionFault if the path cannot continue from the displaced position."""
        if self._sources.pop(kind, None) is None:
            return
        if self._sources:
            self._movement.put(self._path_for(self.q), self._movement.qd)
        else:
            self.release()

    def release(self) -> None:
        """End all displacements; the displaced position becomes the path's position."""
        if self.active:
            self._movement.put(self.q, self.qd)
            self.clear()

    def clear(self) -> None:
        """End all displacements and leave the path where it is."""
        self.active, self._sources = False, {}

    def lose(self, fault: MotionFault) -> None:
        """End all displacements after a fault. The program must not continue as if its path were displaced."""
        if self.active:
            self.lost = fault
            self.clear()

    def program_stopped(self) -> None:
        """Reset settings and faults for the next program; active displacements continue until the arm is stopped."""
        self.settings, self.lost = OffsetSettings(), None

    def rejoin(self) -> bool:
        """Make the arm's deviation part of the path; False if no path is displaced to the arm's position.

        The next movement, which starts from the path, can then remove the deviation.
        """
        target = self._target
        try:
            self._movement.put(self._path_for(target.q), self._movement.qd)
        except MotionFault:
            return False
        self.q, self.qd = target.q, target.qd
        return True

    def _path_for(self, q: Joints) -> Joints:
        """The path joints that are displaced to q. Raises MotionFault if they are out of reach."""
        reach = self._target.reach
        pose = reach.pose(q)
        for source in reversed(self._sources.values()):
            pose = source.undo(pose)
        self._path, self._pose = None, None
        return reach.joints(pose, self._movement.q)

    # one control period

    def advance(self, path: Joints) -> tuple[Joints, Joints]:
        """Advance one period to ``path``; return the displaced joints before and after it.

        Raises MotionFault if a joint cannot follow.
        """
        reach, before = self._target.reach, self._path
        pose = self._path_pose(reach, path)
        shift = pose_sub(pose, before[2]) if before is not None and before[0] is reach else ZERO6
        self._path = (reach, path, pose)
        movement = self._movement
        tick = Tick(self._target.period_s, movement.time.pace, None if movement.running else movement.ramp)
        # In the order of `Kind`: a tracked frame or conveyor moves the offset along.
        for source in self._sources.values():
            source.step(tick, pose, shift)
            pose = source.apply(pose)
        start = self.q
        # Converting a pose back to joints has rounding errors, by which an arm at rest must not move.
        q = start if pose == self._pose else reach.joints(pose, start)
        self._pose = pose
        self._check_joints(reach, q)
        return start, q

    def _path_pose(self, reach: Reach, path: Joints) -> Pose:
        """TCP on the path."""
        if self._path is not None and self._path[0] is reach and self._path[1] == path:
            return self._path[2]
        return reach.pose(path)

    def _check_joints(self, reach: Reach, q: Joints) -> None:
        period_s = self._target.period_s
        qd = ZERO6 if q == self.q else scaled_sub(q, self.q, 1.0 / period_s)
        model = reach.model
        limits = zip(qd, self.qd, model.qd_max, model.qdd_max, strict=True)
        for joint, (now, before, most, acceleration) in enumerate(limits):
            if abs(now - before) > _SUDDEN * acceleration * period_s:
                raise sudden_jump(joint, now - before, now)
            if abs(now) > most * (1.0 + _TOLERANCE):
                first = min(self._sources, default=Kind.PATH_OFFSET)
                raise displaced_too_fast(Displacement[first.name], joint, now, most)
        self.q, self.qd = q, qd
