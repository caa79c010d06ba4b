"""The pendant's switch between Simulation and Real Robot.

On Simulation, whatever runs moves an arm of its own, which is exactly where it is told to be and meets nothing. It is
the one that is published and watched by the safety system, whose limits stay in force: a comment in the vendor's
``robotinterface.h``, which also says that the real arm's joints are reported while it is enabled. The real arm stays
where it was, driven while the power is on and pushed by the world, and is published again once the switch is back.
Signals, registers and the gripper are the same ones in both: what a real control box does with its terminals is not
public.
"""

from emulator.robot.arm import Arm
from emulator.robot.installation import Installation
from urproto.vectors import ZERO6, Vector6


class Simulation:
    """The switch of one arm. ``real``: the arm that stands in the world; ``shown``: the one that programs move."""

    def __init__(self, real: Arm) -> None:
        self.real = self.shown = real
        self._place: Vector6 = ZERO6

    @property
    def on(self) -> bool:
        """Programs move a simulated arm."""
        return self.shown is not self.real

    def begin(self) -> Arm:
        """The arm that is moved from now on; it begins where the real one is to be. Both must stand."""
        real = self.real
        self._place = real.target_q
        self.shown = Arm(real.model)
        self.shown.base_wrench_wanted = real.base_wrench_wanted
        return self.shown

    def end(self) -> Arm:
        """The real arm, which is moved again from where it stands."""
        self.shown = self.real
        return self.real

    def hold(self, installation: Installation, wrench: Vector6, period_s: float, *, driven: bool) -> bool:
        """One period of the real arm, which nobody moves; True when anything about it changed."""
        real = self.real
        changed = real.update((self._place, ZERO6, ZERO6), installation, wrench, period_s, driven=driven)
        if not driven and real.standing:
            self._place = real.q  # brakes may have let it sag before they held
        return changed

    @property
    def place(self) -> Vector6:
        """Where the real arm is to stand [rad]."""
        return self._place if self.on else self.real.target_q
