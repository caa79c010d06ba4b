"""The interface of a movement to the rest of this package, whichever script function commanded it."""

from enum import Enum, auto
from typing import Protocol

from urproto.robots.model import Joints
from urproto.robots.pose import Pose


class Clock(Enum):
    """What the time of a movement follows."""

    SCALED = auto()  # the program's time, stretched by the speed slider and by limits of the joints
    PROGRAM = auto()  # the program's time, which a pause slows down
    REAL = auto()  # nothing slows it down: the brakes, a fault's stop, torques


class Generator(Protocol):
    """One movement in progress.

    Each control period requests a proposal, possibly several times with shorter and shorter steps, and commits the last
    one. A proposal must therefore not change the state from which the next one starts: only ``commit`` does.
    """

    @property
    def clock(self) -> Clock:
        """What its time follows."""

    def propose(self, h: float, q: Joints) -> Joints:
        """Configuration h seconds after the last commit, coming from q. Raises MotionFault if there is none."""

    def commit(self) -> None:
        """The last proposal has been executed."""

    @property
    def done(self) -> bool:
        """Whether the arm has arrived and stands still."""

    @property
    def ready(self) -> bool:
        """Whether the program may continue."""

    def goal(self) -> Pose | None:
        """The target TCP pose in the base frame; None if the movement has no goal."""
