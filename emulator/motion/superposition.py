"""What is added to the path of a movement: path offsets, a tracked frame, a conveyor.

The movement runs on its nominal path and knows nothing of this. Once a period each source says where it takes a pose
of that path, in the order: path offset, frame, conveyor. Sources move on by the clock, whatever the speed slider says;
while the movement is held (pause, protective stop) they stand still too, and go on from there afterwards.

A new source needs three things: ``step`` to move on, ``apply`` to displace a pose, ``undo`` to take that back.
"""

from enum import IntEnum
from typing import Protocol

from emulator.motion.faults import sudden_jump
from emulator.motion.reach import Reach
from emulator.motion.vectors import ZERO, Joints, scaled, sub
from urproto.robots.pose import Pose, pose_sub

__all__ = ["Kind", "Source", "Superposition"]

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
