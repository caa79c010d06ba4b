"""The protective stop that holds the arm: since when, why, and when it may be unlocked."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from urproto.modes import ReportLevel, SafetyMode
from urproto.primary.messages import ErrorCodeMessage

__all__ = ["UNLOCK_AFTER_S", "ProtectiveStop", "Stops"]

UNLOCK_AFTER_S: Final = 5.0  # dashboard manual: earlier the robot refuses
_DEVELOPER: Final = ReportLevel.DEVELOPER_DEBUG  # levels from there on mean the same as those before
_SAME_S: Final = 1.0  # guess: a report so close to the stop is its cause


@dataclass(slots=True)
class ProtectiveStop:
    """at_s: by the robot's clock, the first state that showed it. cause: the report that came with it, if one did."""

    at_s: float
    cause: ErrorCodeMessage | None = None
    hidden: bool = False


class Stops:
    """current: the stop that holds the arm now, None while none does.

    All times are the robot's own, so that an emulator may be faster or slower.
    """

    def __init__(self) -> None:
        self.current: ProtectiveStop | None = None
        self._now_s = 0.0
        self._report: ErrorCodeMessage | None = None

    @property
    def unlock_in_s(self) -> float:
        """How long the robot still refuses to unlock; 0 when it may be asked, or when nothing is to be unlocked."""
        if self.current is None:
            return 0.0
        return max(0.0, self.current.at_s + UNLOCK_AFTER_S - self._now_s)

    @property
    def shown(self) -> ProtectiveStop | None:
        """The stop as long as nobody has put its dialogue away."""
        return None if self.current is None or self.current.hidden else self.current

    def hide(self) -> None:
        """Show its dialogue no more."""
        if self.current is not None:
            self.current.hidden = True

    def see(self, values: Mapping[str, Any]) -> None:
        """Take note of a state, by RTDE name."""
        self._now_s = float(values.get("timestamp", 0.0))
        if values.get("safety_mode") != SafetyMode.PROTECTIVE_STOP:
            self.current = None
        elif self.current is None or self._now_s < self.current.at_s:  # or the controller began anew
            self.current = ProtectiveStop(self._now_s)
            self._blame()

    def hear(self, message: object) -> None:
        """Take note of an error report: it comes before or after the state that shows the stop."""
        if isinstance(message, ErrorCodeMessage) and message.level % _DEVELOPER >= ReportLevel.WARNING:
            self._report = message
            self._blame()

    def _blame(self) -> None:
        stop, report = self.current, self._report
        if stop is None or report is None or stop.cause is not None:
            return
        if abs(report.timestamp_us / 1e6 - stop.at_s) < _SAME_S:
            stop.cause = report
