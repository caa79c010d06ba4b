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
from typing import TYPE_CHECKING, Final

from emulator.lifecycle.power import PowerState
from emulator.lifecycle.safety import SafetyEvent
from emulator.reporting import reports
from emulator.safety.causes import Cause

if TYPE_CHECKING:
    from emulator.controller import Controller


_MOST: Final = 1e7  # rad, rad/s, A, Nm, m, N, kg: no arm reaches that, and nothing it carries (guess)
MOVING: Final = "moving the arm"
PUBLISHING: Final = "publishing"
_MOST_REMEMBERED: Final = 20  # kinds of failures that are told in full, and saved (guess)

_logger = logging.getLogger(__name__)


def plausible(*numbers: float) -> bool:
    """Whether numbers in SI units could be of an arm, or of something near it: finite, and not absurd."""
    return all(-_MOST < number < _MOST for number in numbers)


@dataclass(frozen=True, slots=True)
class Problem:
    """The failure that keeps the arm off. ``stage``: of the control period; ``text``: exception and place."""

    stage: str
    text: str
    step: int


class Novelty:
    """Which failures were told already."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def of(self, error: BaseException, who: object = "") -> bool:
        """True the first time that this kind of error comes from this place."""
        key = f"{who} {type(error).__name__} {place_of(error)}"
        if key in self._told or len(self._told) >= _MOST_REMEMBERED:
            return False
        self._told.add(key)
        return True


def place_of(error: BaseException) -> str:
    """File and line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    return f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown place"


class Guard:
    """Catches what a control period raises. ``problem``: what keeps the arm off; None when nothing does."""

    def __init__(self, controller: "Controller") -> None:
        self._controller = controller
        self._novelty = Novelty()
        self.problem: Problem | None = None

    def caught(self, stage: str, error: Exception) -> None:
        """A stage of the control period has failed: bring the robot into its fault state. Raises nothing."""
        first = self.problem is None
        if first:
            text = f"{type(error).__name__}: {error} ({place_of(error)})"
            self.problem = Problem(stage, text, self._controller.step_count)
            self._attempt(lambda: self._tell(stage, text, error))
        orderly = first and self._attempt(lambda: self._trip(stage, text))
        if not orderly or stage == MOVING:
            self._let_go()

    def listener_failed(self, listener: object, error: Exception) -> None:
        """Somebody who is told of each period has failed: that is not the robot's fault, and logged once."""
        if self._novelty.of(error, listener):
            _logger.error("a listener of the controller failed", exc_info=error)

    def restarted(self) -> None:
        """The safety system has been restarted: what fails from now on is another problem."""
        self.problem = None

    def _tell(self, stage: str, text: str, error: Exception) -> None:
        if not self._novelty.of(error, stage):
            _logger.error("the emulator failed again while %s: %s", stage, text)
            return
        trace = "".join(traceback.format_exception(error))
        try:
            saved = f"saved as {reports.write_crash(self._controller, stage, trace)}"
        except Exception as problem:
            saved = f"not saved: {problem}"
        _logger.critical(
            "the emulator failed while %s, which is a bug: the program is stopped and the arm switched off; "
            "restart safety, power on and brake release lead on. Script, state and log are %s\n%s",
            stage,
            saved,
            trace.rstrip(),
        )
        self._controller.messages.note(f"the emulator failed while {stage}; script, state and log are {saved}")

    def _trip(self, stage: str, text: str) -> None:
        """The orderly way: a fault of the safety system, with all that follows."""
        controller = self._controller
        controller.safety_board.trip(Cause.EMULATOR_FAILURE, text=f"the emulator failed while {stage}: {text}")
        controller.popups.show(f"The emulator failed while {stage}: {text}", title="Fault", error=True)

    def _let_go(self) -> None:
        """The other way: every part is put to rest by itself, so that none is kept from it by another."""
        controller = self._controller
        controller.forget_movement()
        for rest in (
            controller.programs.abandon,
            controller.motion.halt,
            lambda: controller.motion.stand_at(controller.last_good_q),
            lambda: controller.arm.recover(controller.last_good_q),
            lambda: controller.power.put(PowerState.OFF),
            lambda: controller.safety.handle(SafetyEvent.FAULT),
        ):
            self._attempt(rest)

    def _attempt(self, action: Callable[[], object]) -> bool:
        try:
            action()
        except Exception:
            _logger.debug("the guard's own step failed", exc_info=True)
            return False
        return True
