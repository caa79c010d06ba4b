"""Direct torque: torques move the joints, and the targets follow the joints.

Each command is valid for one control period. In a period without one (the program is paused, over, or late), the joints
brake together and come to rest, so that nothing drives an arm without its program. Torques have no path on which the
arm could slow down, so a pause holds their program immediately.
"""

from collections.abc import Callable

from emulator.motion.generator import Clock
from emulator.motion.stops import JointStop, brake_together
from emulator.robot.drives import TorqueCommand
from urproto.robots.model import Joints
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6

TorqueResponse = Callable[[TorqueCommand, Joints, Joints, float], tuple[Joints, Joints]]
"""From a command, joint angles, speeds and a time to the angles and speeds after it."""


class DirectTorque:
    """Movement by torques. ``ramp``: deceleration [rad/s2] of the leading joint when no command arrives."""

    clock = Clock.REAL

    def __init__(self, qd: Joints, respond: TorqueResponse, ramp: Callable[[], float]) -> None:
        self._qd = qd
        self._respond, self._ramp = respond, ramp
        self._command: TorqueCommand | None = None
        self._next = (ZERO6, qd)
        self._stop: JointStop | None = None
        self.acting: TorqueCommand | None = None  # in the last period

    def command(self, command: TorqueCommand) -> None:
        """Set the torques for the next control period."""
        self._command, self._stop = command, None

    def propose(self, h: float, q: Joints) -> Joints:
        if self._command is not None:
            self._next = self._respond(self._command, q, self._qd, h)
            return self._next[0]
        if self._stop is None:
            self._stop = brake_together(q, self._qd, self._ramp())
        return self._stop.propose(h, q)

    def commit(self) -> None:
        self.acting, self._command = self._command, None
        if self._stop is not None:
            self._stop.commit()
        else:
            self._qd = self._next[1]

    @property
    def done(self) -> bool:
        return self._stop is not None and self._stop.done

    @property
    def ready(self) -> bool:
        return self._command is None

    def goal(self) -> Pose | None:
        return None
