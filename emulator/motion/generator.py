"""What a movement is to the rest of this package, whichever script function asked for it."""

from typing import Protocol

from urproto.robots.model import Joints
from urproto.robots.pose import Pose


class Generator(Protocol):
    """One movement in progress.

    Each control period asks for a proposal, perhaps several times with ever shorter steps, and commits the last one.
    So a proposal must not change what the next one starts from: only ``commit`` does.

    ``scaled`` generators run in stretched time (speed slider, pause, joint speed limits); the others, which bring the
    arm to rest, run by the clock.
    """

    scaled: bool

    def propose(self, h: float, q: Joints) -> Joints:
        """Configuration h seconds after the last commit, coming from q. Raises MotionFault when there is none."""

    def commit(self) -> None:
        """The last proposal came true."""

    @property
    def done(self) -> bool:
        """The arm has arrived and stands."""

    @property
    def ready(self) -> bool:
        """The program may go on."""

    def goal(self) -> Pose | None:
        """The TCP pose moved to, in the base frame; None when the movement has no goal."""
