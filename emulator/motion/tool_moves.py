"""Straight tool paths: movel and movep."""

from emulator.motion.legs import ToolLeg
from emulator.motion.profile import Limits
from emulator.motion.reach import Reach
from emulator.motion.vectors import Joints, norm3, scaled
from urproto.robots.pose import Pose, pose_add, pose_sub

__all__ = ["LineLeg", "path_length"]


def path_length(distance_m: float, angle_rad: float, equivalent_radius_m: float) -> float:
    """A tool path's length: its distance, or its turn at the equivalent radius when that is longer (guess)."""
    return max(distance_m, angle_rad * equivalent_radius_m)


class LineLeg(ToolLeg):
    """The TCP on a straight line, its orientation turning about one axis in step."""

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
        return pose_add(scaled(self.change, s / self.length), self._start)
