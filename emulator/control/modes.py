"""Verbs about power, the safety system and the operator's hands."""

from typing import Any, Literal

from emulator.control.base import ControlBase
from emulator.control.verbs import NotPossible, verb
from emulator.lifecycle.errorcodes import SCRIPT_PROTECTIVE_STOP, StopCause
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent

__all__ = ["ModeVerbs"]


class ModeVerbs(ControlBase):
    """Verbs that buttons, gates and faults stand behind on a real robot."""

    @verb
    def power_on(self) -> None:
        """Switch the arm on; the robot mode ends in IDLE."""
        self._power(PowerEvent.POWER_ON)

    @verb
    def release_brakes(self) -> None:
        """Release the brakes, switching the arm on first if need be; the robot mode ends in RUNNING."""
        self._power(PowerEvent.BRAKE_RELEASE)

    @verb
    def power_off(self) -> None:
        """Switch the arm off; a running program ends."""
        self._power(PowerEvent.POWER_OFF)

    @verb
    def protective_stop(self, code: int = SCRIPT_PROTECTIVE_STOP.code, argument: int = 0) -> None:
        """Stop the arm protectively, with this error code in the log."""
        self.controller.protective_stop(StopCause(code, argument))

    @verb
    def unlock_protective_stop(self) -> None:
        """Leave a protective stop at once; only the dashboard waits for 5 s."""
        self.controller.safety_event(SafetyEvent.UNLOCK)

    @verb
    def press_emergency_stop(self, button: Literal["robot", "system"] = "robot") -> None:
        """Press the emergency stop of the teach pendant, or the system's; it stays pressed."""
        pressed = {"robot": SafetyEvent.ROBOT_EMERGENCY_STOP, "system": SafetyEvent.SYSTEM_EMERGENCY_STOP}
        self.controller.safety_event(pressed[button])

    @verb
    def release_emergency_stop(self) -> None:
        """Release the emergency stop; the arm stays off until it is switched on."""
        self.controller.safety_event(SafetyEvent.EMERGENCY_STOP_RELEASED)

    @verb
    def open_safeguard(self) -> None:
        """Open the gate: safeguard stop until it is closed."""
        self.controller.safety_event(SafetyEvent.SAFEGUARD_OPEN)

    @verb
    def close_safeguard(self) -> None:
        """Close the gate; the program goes on."""
        self.controller.safety_event(SafetyEvent.SAFEGUARD_CLOSED)

    @verb
    def set_reduced_mode(self, on: bool) -> None:
        """Switch reduced mode on or off, as its input does."""
        self.controller.safety_event(SafetyEvent.REDUCED if on else SafetyEvent.NOT_REDUCED)

    @verb
    def cause_violation(self) -> None:
        """Let the safety system find a limit violated; ``restart_safety`` mends it."""
        self.controller.safety_event(SafetyEvent.VIOLATION)

    @verb
    def cause_fault(self) -> None:
        """Let the safety system find a fault; ``restart_safety`` mends it."""
        self.controller.safety_event(SafetyEvent.FAULT)

    @verb
    def restart_safety(self) -> None:
        """Restart the safety system after a violation or fault; the arm ends switched off."""
        self.controller.power_event(PowerEvent.POWER_OFF)
        self.controller.safety_event(SafetyEvent.RESTART)

    @verb
    def set_remote_control(self, on: bool) -> None:
        """Turn the pendant's switch to remote control, or back."""
        self.controller.remote_control = on

    @verb
    def popups(self) -> list[dict[str, Any]]:
        """The dialogues that are open, oldest first; ``type``: what answer one asks for, NONE for a plain popup."""
        return [
            {"id": popup.request_id, "title": popup.title, "text": popup.text, "type": popup.requested_type.name}
            for popup in self.controller.popups.shown
        ]

    @verb
    def answer_popup(self, popup_id: int, value: float | str | bool | None = None) -> None:
        """Close a popup, or answer a question; a question without a value is cancelled."""
        try:
            if not self.controller.popups.answer(popup_id, value):
                raise NotPossible(f"no popup {popup_id} is open")
        except ValueError as error:
            raise NotPossible(str(error)) from error

    def _power(self, event: PowerEvent) -> None:
        if not self.controller.power_event(event):
            raise NotPossible(f"the safety mode {self.controller.safety.mode.name} keeps the arm switched off")
