"""The pendant's switch between Simulation and Real Robot.

On Simulation, programs move a separate simulated arm, which is exactly at its target and touches nothing. This arm is
published and monitored by the safety system, whose limits stay active (source: a comment in the vendor's
``robotinterface.h``, which also says that the real arm's joints are reported while it is enabled). The real arm stays
where it was, driven while the power is on and pushed by the world, and is published again once the switch is back on
Real Robot. Signals, registers and the gripper are shared by both: what a real control box does with its terminals is
not public.
"""

from emulator.robot.arm import Arm
from emulator.robot.installation import Installation
from urproto.vectors import ZERO6, Vector6


class Simulation:
    """The switch of one arm. ``real``: the arm in the world; ``shown``: the one that programs move."""

    def __init__(self, real: Arm) -> None:
        self.real = self.shown = real
        self._place: Vector6 = ZERO6

    @property
    def on(self) -> bool:
        """Whether programs move a simulated arm."""
        return self.shown is not self.real

    def begin(self) -> Arm:
        """Start simulation and return the simulated arm; it starts at the real one's target. Both must be at rest."""
        real = self.real
        self._place = real.target_q
        self.shown = Arm(real.model)
        return self.shown

    def end(self) -> Arm:
        """End simulation and return the real arm, which moves again from where it stands."""
        self.shown = self.real
        return self.real

    def hold(self, installation: Installation, wrench: Vector6, period_s: float, *, driven: bool) -> bool:
        """Advance the real arm one period without moving it; returns True if anything about it changed."""
        real = self.real
        changed = real.update((self._place, ZERO6, ZERO6), installation, wrench, period_s, driven=driven)
        if not driven and real.standing:
            self._place = real.q  # the arm may have sagged before the brakes held it
        return changed

    @property
    def place(self) -> Vector6:
        """Target angles of the real arm [rad]."""
        return self._place if self.on else self.real.target_q
