"""Journals that are written by themselves: when the robot has stopped unexpectedly, with the second that follows."""

from functools import partial
from typing import Final

from emulator import reports
from emulator.controller import Controller
from emulator.journal.recorder import Recorder
from urproto.modes import SafetyMode

_UNEXPECTED: Final = (
    SafetyMode.PROTECTIVE_STOP,
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.VIOLATION,
    SafetyMode.FAULT,
)
_AFTER_S: Final = 1.0  # of the run that follows the stop (guess)
_EVERY_S: Final = 60.0  # at most: a journal has the stops before it as well (guess)


class StopJournals:
    """Writes the journals of unexpected stops to the folder of reports, the newest five of them."""

    def __init__(self) -> None:
        self._mode = SafetyMode.NORMAL
        self._stop: SafetyMode | None = None  # of which a journal is to be written
        self._due_s = self._not_before_s = 0.0  # of the run, also across restarts

    def look(self, controller: Controller, recorder: Recorder) -> None:
        """After each control period."""
        mode = controller.safety.mode
        if mode is self._mode and self._stop is None:
            return
        time_s = recorder.periods * controller.period_s
        if mode is not self._mode:
            self._mode = mode
            failed = controller.guard.problem is not None  # of which there is a crash report
            if mode in _UNEXPECTED and self._stop is None and time_s >= self._not_before_s and not failed:
                self._stop, self._due_s = mode, time_s + _AFTER_S
        if time_s >= self._due_s:
            self.write(controller, recorder)

    def write(self, controller: Controller, recorder: Recorder) -> None:
        """Write the journal that is due, or would be soon: in the thread of the journal."""
        stop, self._stop = self._stop, None
        if stop is None:
            return
        self._not_before_s = recorder.periods * controller.period_s + _EVERY_S
        recorder.save(partial(reports.write_stop_journal, reports.stop_journal(controller), stop.name))
