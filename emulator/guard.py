"""The guard of the tick: the emulator's reaction to its own failures.

An exception in a control period is a bug of the emulator, or an unexpected number. In either case, the robot's ports
must not fall silent. The program therefore ends, the arm is powered off as after a fault of the safety system, clients
receive that on every port, and the controller continues to publish. `restart safety`, `power on` and `brake release`
recover from it, as from any fault.

The failure is logged once, not once a period, and saved as a bundle that contains everything needed for a bug report.
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
    """The failure that keeps the arm off. ``stage``: of the control period; ``text``: exception and location."""

    stage: str
    text: str
    step: int


class Guard:
    """Handles exceptions of control periods. ``problem``: the failure that keeps the arm off, or None."""

    def __init__(self, machine: Machine, programs: Programs, safety_board: SafetyBoard) -> None:
        self._machine, self._programs, self._safety_board = machine, programs, safety_board
        self._reported = ReportedErrors()
        self.problem: Problem | None = None

    def caught(self, stage: str, error: Exception) -> None:
        """A stage of the control period has failed: put the robot into its fault state. Raises nothing."""
        first = self.problem is None
        if first:
            text = f"{type(error).__name__}: {error} ({place_of(error)})"
            self.problem = Problem(stage, text, self._machine.step_count)
            self._attempt(lambda: self._report(stage, text, error))
        orderly = first and self._attempt(lambda: self._trip(stage, text))
        if not orderly or stage == MOVING:
            self._force_fault_state()

    def listener_failed(self, listener: object, error: Exception) -> None:
        """A subscriber of snapshots has failed: this does not affect the robot, and is logged once."""
        if self._reported.is_new(error, listener):
            _logger.error("a listener of the controller failed", exc_info=error)

    def restarted(self) -> None:
        """The safety system has been restarted: a later failure is another problem."""
        self.problem = None

    def _report(self, stage: str, text: str, error: Exception) -> None:
        if not self._reported.is_new(error, stage):
            _logger.error("the emulator failed again while %s: %s", stage, text)
            return
        trace = "".join(traceback.format_exception(error))
        try:
            saved = f"saved as {reports.write_crash(self._machine, self._programs.source, stage, trace)}"
        except Exception as problem:
            saved = f"not saved: {problem}"
        _logger.critical(
            "the emulator failed while %s, which is a bug: the program is stopped and the arm powered off; "
            "recover with restart safety, power on and brake release. Script, state and log are %s\n%s",
            stage,
            saved,
            trace.rstrip(),
        )
        self._machine.messages.note(f"the emulator failed while {stage}; script, state and log are {saved}")

    def _trip(self, stage: str, text: str) -> None:
        """Regular reaction: a fault of the safety system, with all its consequences."""
        machine = self._machine
        self._safety_board.trip(Cause.EMULATOR_FAILURE, text=f"the emulator failed while {stage}: {text}")
        machine.popups.show(f"The emulator failed while {stage}: {text}", title="Fault", error=True)

    def _force_fault_state(self) -> None:
        """Fallback: bring each part to rest separately, so that the failure of one does not prevent the others."""
        machine = self._machine
        machine.discard_movement()
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
