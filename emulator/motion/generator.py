"""The interface of a movement to the rest of this package, whichever script function commanded it."""

from typing import Protocol

from urproto.robots.model import Joints
from urproto.robots.pose import Pose


class Generator(Protocol):
    """One movement in progress.

    Each control period requests a proposal, possibly several times with shorter and shorter steps, and commits the last
    one. A proposal must therefore not change the state from which the next one starts: only ``commit`` does.

    ``scaled`` generators run in stretched time (speed slider, pause, joint speed limits); the others, which bring the
    arm to rest, run in real time.
    """

    scaled: bool

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
