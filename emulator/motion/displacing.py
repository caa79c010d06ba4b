"""Commands that add something to the path of the movements: path offsets, conveyor and frame tracking."""

from collections.abc import Sequence

from emulator.motion.faults import MotionFault
from emulator.motion.frame_tracking import FrameTracking
from emulator.motion.path_offset import OffsetFrame, PathOffset
from emulator.motion.stepping import Move
from emulator.motion.stopping import StoppingStepper
from emulator.motion.superposition import Kind, Source, Superposition
from emulator.motion.vectors import ZERO, as_six
from urproto.robots.pose import Pose

__all__ = ["DisplacingStepper"]


class DisplacingStepper(StoppingStepper):
    """A stepper whose path can be displaced."""

    def enable_path_offset(self) -> None:
        """Begin to apply an offset, zero at first. Does nothing when that is so already."""
        if self._path_offset is None:
            self._displace(Kind.PATH_OFFSET, PathOffset(self.offset_settings))

    def set_path_offset(self, offset: Sequence[float], frame: OffsetFrame) -> None:
        """The offset to apply from now on [m, rotation vector]; without effect unless enabled (guess)."""
        if self._path_offset is not None:
            self._path_offset.set(as_six(offset), frame)

    def path_offset(self, frame: OffsetFrame) -> Pose:
        """The offset applied just now, as one of this frame; zero unless enabled."""
        return ZERO if self._path_offset is None else self._path_offset.get(frame)

    def disable_path_offset(self, a: float) -> Move:
        """Add no offset any more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.PATH_OFFSET, a)

    def track(self, conveyor: Source) -> None:
        """Take the path along with a conveyor. Raises ValueError while one is tracked."""
        if self._added is not None and Kind.CONVEYOR in self._added.sources:
            raise ValueError("a conveyor is tracked already: call stop_conveyor_tracking() first")
        self._displace(Kind.CONVEYOR, conveyor)

    def stop_tracking(self, a: float) -> Move:
        """Take the path along no more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.CONVEYOR, a)

    def track_frame(self, frame: FrameTracking) -> None:
        """Take the path along with a frame. Raises ValueError while one is tracked."""
        if self.tracked_frame is not None:
            raise ValueError("a frame is tracked already: call frame_tracking_disable() first")
        self._displace(Kind.FRAME, frame)

    def stop_tracking_frame(self, a: float) -> Move:
        """Take the path along no more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.FRAME, a)

    @property
    def tracked_frame(self) -> FrameTracking | None:
        """The frame that the path is taken along with."""
        source = None if self._added is None else self._added.sources.get(Kind.FRAME)
        return source if isinstance(source, FrameTracking) else None

    @property
    def _path_offset(self) -> PathOffset | None:
        source = None if self._added is None else self._added.sources.get(Kind.PATH_OFFSET)
        return source if isinstance(source, PathOffset) else None

    def _displace(self, kind: Kind, source: Source) -> None:
        if self._added is None:
            if self._compliance is None:
                self._nominal, self._nominal_qd = self.q, self.qd
            self._added = Superposition(self.period_s, self._nominal, self._nominal_qd)
        self._added.add(kind, source)

    def _end_source(self, kind: Kind, a: float) -> Move:
        """Where the source took the path to becomes the path; from there all joints stop."""
        added = self._added
        if added is not None and added.sources.pop(kind, None) is not None:
            try:
                self._without(added)
            except MotionFault as fault:
                return self._refuse(fault)
        return self._stop_joints(a)

    def _without(self, added: Superposition) -> None:
        if added.sources:
            self._nominal = added.path_for(self._reach, added.q, self._nominal)
        else:
            self._let_go()
