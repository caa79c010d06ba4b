"""Holding a movement and ending it: pauses, stops of each kind, brakes."""

from emulator.motion.pacing import RAMP_RAD_S2
from emulator.motion.stepping import Holding, Stepper
from emulator.motion.stops import JointStop, ToolStop, brake_together
from emulator.motion.vectors import ZERO, as_six, largest

__all__ = ["StoppingStepper"]

_BRAKE_SHARE = 1.5  # of the highest acceleration is what the brakes slow a joint by (guess)


class StoppingStepper(Stepper):
    """A stepper whose movement can be held and ended."""

    def pause(self) -> None:
        """Slow to a standstill on the path; `resume` goes on."""
        self._mode, self._ramp = Holding.PAUSE, RAMP_RAD_S2

    def resume(self) -> None:
        """Go on after `pause` or `protective_stop`."""
        self._mode, self._ramp = Holding.RUN, RAMP_RAD_S2

    def safeguard_stop(self) -> None:
        """As a protective stop, or as gently as a pause when transitions are soft."""
        if self.hard_transitions:
            self.protective_stop()
        else:
            self.pause()

    def engage_brakes(self) -> None:
        """Power is removed (stop category 0): brakes bring each joint to rest, and everything is forgotten."""
        qd, qdd = self.qd, self.qdd
        self.halt()
        if qd != ZERO:
            self.qd, self.qdd = qd, qdd
            durations = (abs(speed) / (_BRAKE_SHARE * a) for speed, a in zip(self.qd, self.model.qdd_max, strict=True))
            self._generator = self._emergency = self._brakes = JointStop(self.q, self.qd, as_six(durations))

    @property
    def braking(self) -> bool:
        """The brakes are bringing the arm to rest."""
        return self._brakes is not None and self._generator is self._brakes

    def mode_changed(self) -> None:
        """Reduced mode begins or ends: the speed follows as quickly as the joints can, unless transitions are soft."""
        if self.hard_transitions and self._mode is Holding.RUN:
            self._ramp = min(self.model.qdd_max)

    def protective_stop(self) -> None:
        """Stop on the path as quickly as the joints' acceleration limit allows; `resume` goes on."""
        self._mode, self._ramp = Holding.PAUSE, min(self.model.qdd_max)
        self._hasten()

    def stop(self, decel: float | None = None) -> None:
        """Stop on the path, the leading joint slowing by ``decel`` [rad/s2], and end the movement."""
        self._ramp = RAMP_RAD_S2 if decel is None else decel
        if self._added is not None:
            self._let_go()
            self._generator = brake_together(self._nominal, self._nominal_qd, self._ramp)
        self._mode = Holding.STOP if self._generator is not None else Holding.RUN
        self._hasten()

    def _hasten(self) -> None:
        """A gentle stop of the program's becomes as quick as the one now asked for; who waits for it still does."""
        stop = self._generator
        if not isinstance(stop, JointStop | ToolStop) or stop is self._emergency:
            return
        speed = self._nominal_qd if self._beside else self.qd
        if largest(speed) < stop.remaining_s * self._ramp:
            self._generator = brake_together(self._nominal, speed, self._ramp)

    def halt(self) -> None:
        """Power is gone: stand still at once and forget everything."""
        self._drop()
        self._compliance = self._refusal = self._added = None
        self._nominal, self._nominal_qd = self.q, ZERO
        self.qd = self.qdd = ZERO
        self._mode = Holding.RUN
