"""Safety modes as a table, the conditions that maintain them, and the unlocking rules.

A protective stop lasts until it is unlocked. Emergency stop, safeguard stop, recovery and
reduced mode last as long as their condition (button, gate, input, position): when a mode
ends, the conditions that are still present are applied again. Violations and faults last until
the safety system is restarted.
"""

from enum import Enum, auto
from typing import Final

from urproto.compat import IntEnum
from urproto.modes import SafetyMode, SafetyStatus, SafetyStatusBits

PROTECTIVE_STOP_LOCK_S: Final = 5.0  # dashboard manual: no unlock earlier than this after the stop
_M = SafetyMode
_OPERATIONAL: Final = (_M.NORMAL, _M.REDUCED, _M.RECOVERY)
_STOPPED: Final = (_M.PROTECTIVE_STOP, _M.SAFEGUARD_STOP)
_EMERGENCY: Final = (_M.SYSTEM_EMERGENCY_STOP, _M.ROBOT_EMERGENCY_STOP)
_HARD: Final = (_M.VIOLATION, _M.FAULT)
_POWERLESS: Final = (*_EMERGENCY, *_HARD)
_STOP: Final = SafetyStatusBits.STOPPED_DUE_TO_SAFETY
_ESTOP: Final = SafetyStatusBits.EMERGENCY_STOPPED | _STOP
_STATUS_BITS: Final[dict[SafetyMode, SafetyStatusBits]] = {
    _M.NORMAL: SafetyStatusBits.NORMAL,
    _M.REDUCED: SafetyStatusBits.REDUCED,
    _M.PROTECTIVE_STOP: SafetyStatusBits.PROTECTIVE_STOPPED | _STOP,
    _M.RECOVERY: SafetyStatusBits.RECOVERY,
    _M.SAFEGUARD_STOP: SafetyStatusBits.SAFEGUARD_STOPPED | _STOP,
    _M.SYSTEM_EMERGENCY_STOP: SafetyStatusBits.SYSTEM_EMERGENCY_STOPPED | _ESTOP,
    _M.ROBOT_EMERGENCY_STOP: SafetyStatusBits.ROBOT_EMERGENCY_STOPPED | _ESTOP,
    _M.VIOLATION: SafetyStatusBits.VIOLATION | _STOP,
    _M.FAULT: SafetyStatusBits.FAULT | _STOP,
}


class StopCategory(IntEnum):
    """Stop categories of IEC 60204-1."""

    POWER_REMOVED = 0  # immediately; the brakes bring the arm to rest
    CONTROLLED_THEN_OFF = 1  # along the path; power is removed once the arm has stopped
    CONTROLLED = 2  # along the path; power stays on


class SafetyEvent(Enum):
    """Events of the safety system."""

    PROTECTIVE_STOP = auto()
    UNLOCK = auto()
    ROBOT_EMERGENCY_STOP = auto()
    SYSTEM_EMERGENCY_STOP = auto()
    EMERGENCY_STOP_RELEASED = auto()
    SAFEGUARD_OPEN = auto()
    SAFEGUARD_CLOSED = auto()
    AUTOMATIC_SAFEGUARD_OPEN = auto()  # e-Series: the safeguard that is active in automatic mode only
    AUTOMATIC_SAFEGUARD_CLOSED = auto()
    ENABLING_RELEASED = auto()  # e-Series: three-position enabling device, in manual mode only
    ENABLING_HELD = auto()
    REDUCED = auto()
    NOT_REDUCED = auto()
    OUTSIDE_LIMITS = auto()  # the arm is outside its limits when it could start to move
    INSIDE_LIMITS = auto()
    VIOLATION = auto()
    FAULT = auto()
    RESTART = auto()


_E = SafetyEvent
# opening event -> closing event and the safety status in between; the safety mode is the same for all
_SAFEGUARDS: Final = {
    _E.SAFEGUARD_OPEN: (_E.SAFEGUARD_CLOSED, SafetyStatus.SAFEGUARD_STOP),
    _E.AUTOMATIC_SAFEGUARD_OPEN: (_E.AUTOMATIC_SAFEGUARD_CLOSED, SafetyStatus.AUTOMATIC_MODE_SAFEGUARD_STOP),
    _E.ENABLING_RELEASED: (_E.ENABLING_HELD, SafetyStatus.SYSTEM_THREE_POSITION_ENABLING_STOP),
}
STOP_CATEGORY: Final[dict[SafetyMode, StopCategory]] = {
    _M.PROTECTIVE_STOP: StopCategory.CONTROLLED,
    _M.SAFEGUARD_STOP: StopCategory.CONTROLLED,
    _M.SYSTEM_EMERGENCY_STOP: StopCategory.CONTROLLED_THEN_OFF,
    _M.ROBOT_EMERGENCY_STOP: StopCategory.CONTROLLED_THEN_OFF,
    _M.VIOLATION: StopCategory.POWER_REMOVED,
    _M.FAULT: StopCategory.POWER_REMOVED,
}
"""User manual, safety functions: emergency stop 1, safeguard stop 2, limit violation and fault 0."""

SAFETY_TABLE: Final[dict[tuple[SafetyMode, SafetyEvent], SafetyMode]] = {
    (_M.NORMAL, _E.REDUCED): _M.REDUCED,
    (_M.REDUCED, _E.NOT_REDUCED): _M.NORMAL,
    (_M.PROTECTIVE_STOP, _E.UNLOCK): _M.NORMAL,
    (_M.RECOVERY, _E.INSIDE_LIMITS): _M.NORMAL,
    **{(mode, _E.PROTECTIVE_STOP): _M.PROTECTIVE_STOP for mode in (*_OPERATIONAL, _M.SAFEGUARD_STOP)},
    **{(mode, _E.OUTSIDE_LIMITS): _M.RECOVERY for mode in (_M.NORMAL, _M.REDUCED)},
    **{(mode, opened): _M.SAFEGUARD_STOP for opened in _SAFEGUARDS for mode in _OPERATIONAL},
    **{(_M.SAFEGUARD_STOP, closed): _M.NORMAL for closed, _ in _SAFEGUARDS.values()},
    **{(mode, _E.ROBOT_EMERGENCY_STOP): _M.ROBOT_EMERGENCY_STOP for mode in (*_OPERATIONAL, *_STOPPED)},
    **{(mode, _E.SYSTEM_EMERGENCY_STOP): _M.SYSTEM_EMERGENCY_STOP for mode in (*_OPERATIONAL, *_STOPPED)},
    **{(mode, _E.EMERGENCY_STOP_RELEASED): _M.NORMAL for mode in _EMERGENCY},
    **{(mode, _E.VIOLATION): _M.VIOLATION for mode in (*_OPERATIONAL, *_STOPPED, *_EMERGENCY)},
    **{(mode, _E.FAULT): _M.FAULT for mode in (*_OPERATIONAL, *_STOPPED, *_EMERGENCY, _M.VIOLATION)},
    **{(mode, _E.RESTART): _M.NORMAL for mode in _HARD},
}

# lasting conditions: the event that ends each of them; strongest first
_CONDITIONS: Final[dict[SafetyEvent, SafetyEvent]] = {
    _E.ROBOT_EMERGENCY_STOP: _E.EMERGENCY_STOP_RELEASED,
    _E.SYSTEM_EMERGENCY_STOP: _E.EMERGENCY_STOP_RELEASED,
    **{opened: closed for opened, (closed, _) in _SAFEGUARDS.items()},
    _E.OUTSIDE_LIMITS: _E.INSIDE_LIMITS,
    _E.REDUCED: _E.NOT_REDUCED,
}


class Safety:
    """The safety mode, its age, and the present conditions."""

    def __init__(self, mode: SafetyMode = SafetyMode.NORMAL) -> None:
        self._conditions: set[SafetyEvent] = set()
        self._begin(mode)

    def _begin(self, mode: SafetyMode) -> None:
        self.mode, self.mode_age_s = mode, 0.0
        self.status_bits = int(_STATUS_BITS[mode])
        """RTDE safety_status_bits."""
        self._status = SafetyStatus(mode)

    @property
    def stopped(self) -> bool:
        """Whether the arm must not move."""
        return self.mode not in _OPERATIONAL

    @property
    def power_allowed(self) -> bool:
        """Whether the arm may have power; False while the safety system keeps it off."""
        return self.mode not in _POWERLESS

    @property
    def may_unlock_remotely(self) -> bool:
        """False during the first 5 s of a protective stop, when the dashboard refuses to unlock."""
        return self.mode is not SafetyMode.PROTECTIVE_STOP or self.mode_age_s >= PROTECTIVE_STOP_LOCK_S

    @property
    def programs_allowed(self) -> bool:
        """Whether programs may run; False while stopped, or outside the limits."""
        return self.mode in (_M.NORMAL, _M.REDUCED)

    @property
    def status(self) -> SafetyStatus:
        """Status: like the mode, but it distinguishes which safeguard stops the arm."""
        if self.mode is _M.SAFEGUARD_STOP:
            for opened, (_, status) in _SAFEGUARDS.items():
                if opened in self._conditions:
                    return status
        return self._status

    def handle(self, event: SafetyEvent) -> bool:
        """Apply an event; returns whether the mode changed. A pair that is not in the table changes nothing."""
        if event in _CONDITIONS:
            self._conditions.add(event)
        self._conditions -= {begun for begun, ended in _CONDITIONS.items() if ended is event}
        before = self.mode
        self._follow(event)
        return self.mode is not before

    def advance(self, period_s: float) -> None:
        self.mode_age_s += period_s

    def _follow(self, event: SafetyEvent) -> None:
        mode = SAFETY_TABLE.get((self.mode, event))
        if mode is None:
            return
        self._begin(mode)
        if mode is SafetyMode.NORMAL:
            for condition in _CONDITIONS:
                if condition in self._conditions:
                    self._follow(condition)
