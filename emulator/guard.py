"""The guard under the tick: what the emulator does when it fails itself.

An exception in a control period is a bug of the emulator, or a number that nobody thought of. Whatever it is, the robot
must not stand there with ports that say nothing. So the program ends, the arm is switched off as by a fault of the
safety system, clients read that on every port, and the controller goes on publishing. `restart safety`, `power on` and
`brake release` lead out of it, as out of any fault.

What happened is logged once, not once a period, and saved as a bundle that a bug report needs nothing beside.
"""

import logging
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from emulator import reports
from emulator.lifecycle.power import PowerState
from emulator.lifecycle.safety import SafetyEvent
from emulator.logs import ReportedErrors, place_of
from emulator.machine import Machine
from emulator.programs.runner import Programs
from emulator.safety.board import SafetyBoard
from emulator.safety.causes import Cause

MOVING: Final = "moving the arm"
PUBLISHING: Final = "publishing"

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Problem:
    """The failure that keeps the arm off. ``stage``: of the control period; ``text``: exception and place."""

    stage: str
    text: str
    step: int


class Guard:
    """Catches what a control period raises. ``problem``: what keeps the arm off; None when nothing does."""

    def __init__(self, machine: Machine, programs: Programs, safety_board: SafetyBoard) -> None:
        self._machine, self._programs, self._safety_board = machine, programs, safety_board
        self._reported = ReportedErrors()
        self.problem: Problem | None = None

    def caught(self, stage: str, error: Exception) -> None:
        """A stage of the control period has failed: bring the robot into its fault state. Raises nothing."""
        first = self.problem is None
        if first:
            text = f"{type(error).__name__}: {error} ({place_of(error)})"
            self.problem = Problem(stage, text, self._machine.step_count)
            self._attempt(lambda: self._tell(stage, text, error))
        orderly = first and self._attempt(lambda: self._trip(stage, text))
        if not orderly or stage == MOVING:
            self._let_go()

    def listener_failed(self, listener: object, error: Exception) -> None:
        """Somebody who is told of each period has failed: that is not the robot's fault, and logged once."""
        if self._reported.is_new(error, listener):
            _logger.error("a listener of the controller failed", exc_info=error)

    def restarted(self) -> None:
        """The safety system has been restarted: what fails from now on is another problem."""
        self.problem = None

    def _tell(self, stage: str, text: str, error: Exception) -> None:
        if not self._reported.is_new(error, stage):
            _logger.error("the emulator failed again while %s: %s", stage, text)
            return
        trace = "".join(traceback.format_exception(error))
        try:
            saved = f"saved as {reports.write_crash(self._machine, self._programs.source, stage, trace)}"
        except Exception as problem:
            saved = f"not saved: {problem}"
        _logger.critical(
            "the emulator failed while %s, which is a bug: the program is stopped and the arm switched off; "
            "restart safety, power on and brake release lead on. Script, state and log are %s\n%s",
            stage,
            saved,
            trace.rstrip(),
        )
        self._machine.messages.note(f"the emulator failed while {stage}; script, state and log are {saved}")

    def _trip(self, stage: str, text: str) -> None:
        """The orderly way: a fault of the safety system, with all that follows."""
        machine = self._machine
        self._safety_board.trip(Cause.EMULATOR_FAILURE, text=f"the emulator failed while {stage}: {text}")
        machine.popups.show(f"The emulator failed while {stage}: {text}", title="Fault", error=True)

    def _let_go(self) -> None:
        """The other way: every part is put to rest by itself, so that none is kept from it by another."""
        machine = self._machine
        machine.forget_movement()
        for rest in (
            self._programs.abandon,
            machine.motion.halt,
            lambda: machine.motion.stand_at(machine.last_good_q),
            lambda: machine.arm.recover(machine.last_good_q),
            lambda: machine.power.put(PowerState.OFF),
            lambda: machine.safety.handle(SafetyEvent.FAULT),
        ):
            self._attempt(rest)

    def _attempt(self, action: Callable[[], object]) -> bool:
        try:
            action()
        except Exception:
            _logger.debug("the guard's own step failed", exc_info=True)
            return False
        return True
