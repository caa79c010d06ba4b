"""Hands: wrenches that act on the tool for a while."""

from dataclasses import dataclass
from enum import StrEnum
from math import isfinite

from emulator.guard import plausible
from emulator.motion.axes import of_rotation, out_of6
from emulator.snapshot import Vector6
from urproto.robots.pose import Pose

__all__ = ["Frame", "Push"]

_ALMOST = 1e-9


class Frame(StrEnum):
    """In whose axes a wrench is given."""

    BASE = "base"
    TOOL = "tool"


@dataclass(slots=True)
class Push:
    """A force [N] and torque [Nm] at the TCP. ``duration_s``: None pushes until it is released.

    Raises ValueError for what is not finite, or no time.
    """

    wrench: Vector6
    frame: Frame = Frame.BASE
    duration_s: float | None = None

    def __post_init__(self) -> None:
        if len(self.wrench) != 6 or not plausible(*self.wrench):
            raise ValueError(f"a wrench must be six finite numbers, not {list(self.wrench)}")
        if self.duration_s is not None and not (isfinite(self.duration_s) and self.duration_s > 0.0):
            raise ValueError(f"a push must last longer than 0 s, not {self.duration_s}")

    def wrench_base(self, pose_base_tcp: Pose) -> Vector6:
        """In the base frame's axes, for a tool that is there."""
        return self.wrench if self.frame is Frame.BASE else out_of6(of_rotation(pose_base_tcp), self.wrench)

    def over(self, period_s: float) -> bool:
        """One period has gone; True when it was the last."""
        if self.duration_s is None:
            return False
        self.duration_s -= period_s
        return self.duration_s <= _ALMOST
