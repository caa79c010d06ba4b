"""Verbs about power, the safety system, and what an operator does."""

from math import isfinite
from typing import Any, Final, Literal

from emulator.control.verbs import Verbs, Waiting, refusing, verb
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.runstate import SCRIPT_PROTECTIVE_STOP, StopCause
from emulator.lifecycle.safety import SafetyEvent
from emulator.safety.causes import CAUSES, Cause
from emulator.safety.signals import SafetyDevice
from emulator.snapshot import plausible
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import AnalogDomain, RuntimeState
from urproto.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup
from urproto.text import unknown
from urproto.vectors import Vector6
from urscript.polyscope.safety_configuration import SafetyInput
from urscript.values import INT_MAX, INT_MIN

Group = Literal["standard", "configurable", "tool"]
Domain = Literal["current", "voltage"]
Register = Literal["bit", "int", "double"]

_GROUPS: Final[dict[str, DigitalGroup]] = {group.name: group for group in (STANDARD, CONFIGURABLE, TOOL)}
_JOG_RAD_S2: Final = 1.4
_BUTTONS = {"robot": SafetyDevice.EMERGENCY_STOP, "system": SafetyDevice.SYSTEM_EMERGENCY_STOP}


class SignalVerbs(Verbs):
    """Verbs about digital and analog signals and registers."""

    @verb
    def set_digital_input(self, index: int, level: bool, group: Group = "standard") -> None:
        """Set a digital input: 0 to 7 (standard and configurable, at the control box), or 0 and 1 (tool)."""
        with refusing(BadArguments):
            self.controller.signals.set_digital_input(_GROUPS[group], index, level)

    @verb
    def set_digital_output(self, index: int, level: bool, group: Group = "standard") -> None:
        """Set a digital output, as a program does."""
        with refusing(BadArguments):
            self.controller.signals.set_digital_output(_GROUPS[group], index, level)

    @verb
    def set_analog_input(self, index: int, value: float, domain: Domain | None = None, *, tool: bool = False) -> None:
        """Set analog input 0 or 1 of the control box or the tool [A or V], and optionally its domain."""
        if index not in (0, 1):
            raise BadArguments(f"there is no analog input {index}: choose 0 or 1")
        if not plausible(value):
            raise BadArguments(f"{value} is out of range for an analog input: give A or V")
        signals = self.controller.signals
        values = signals.tool_analog_inputs if tool else signals.analog_inputs
        domains = signals.tool_analog_input_domains if tool else signals.analog_input_domains
        values[index] = value
        if domain is not None:
            domains[index] = AnalogDomain[domain.upper()]

    @verb
    def set_analog_output(self, index: int, ratio: float) -> None:
        """Set analog output 0 or 1 to a ratio (0 to 1) of its range."""
        if not plausible(ratio):
            raise BadArguments(f"an analog output takes a ratio from 0 to 1 of its range, not {ratio}")
        with refusing(BadArguments):
            self.controller.signals.set_analog_output(index, ratio)

    @verb
    def set_input_register(self, kind: Register, index: int, value: float) -> None:
        """Write an input register, as clients do; programs read it."""
        bank = self.controller.registers.input
        with refusing(BadArguments):
            if not isfinite(value):
                raise BadArguments(f"a register takes finite numbers, not {value}")
            if kind == "bit":
                bank.set_bit(index, bool(value))
            elif kind == "double":
                bank.set_double(index, value)
            elif value != int(value):
                raise BadArguments(f"integer register {index} cannot hold {value}")
            else:
                bank.set_int(index, int(value))

    @verb
    def set_encoder_speed(self, index: int, ticks_per_s: float) -> None:
        """Set the speed of the emulated conveyor at encoder 0 or 1."""
        if not plausible(ticks_per_s):
            raise BadArguments(f"{ticks_per_s} ticks/s is out of range for a conveyor")
        with refusing(BadArguments):
            self.controller.encoders[index].simulated_speed = ticks_per_s


Button = Literal["robot", "system"]
Device = Literal["safeguard", "automatic_safeguard", "enabling_device", "reduced_mode"]


class ModeVerbs(Verbs):
    """Verbs for what buttons, gates and faults do on a real robot."""

    @verb
    def power_on(self) -> None:
        """Switch the arm on; the robot mode becomes IDLE."""
        self._power(PowerEvent.POWER_ON)

    @verb
    def release_brakes(self) -> None:
        """Release the brakes, switching the arm on first if necessary; the robot mode becomes RUNNING."""
        self._power(PowerEvent.BRAKE_RELEASE)

    @verb
    def power_off(self) -> None:
        """Switch the arm off; a running program ends."""
        self._power(PowerEvent.POWER_OFF)

    @verb
    def confirm_safety_setup(self) -> None:
        """Confirm the safety setup, as PolyScope does when it has started; until then, RTDE sends no data."""
        self.controller.power_event(PowerEvent.CONFIRM)

    @verb
    def protective_stop(self, code: int = SCRIPT_PROTECTIVE_STOP.code, argument: int = 0) -> None:
        """Trigger a protective stop, with this error code in the log."""
        if not (0 <= code <= INT_MAX and INT_MIN <= argument <= INT_MAX):
            raise BadArguments(f"C{code}A{argument} is not an error code: both must be 32-bit integers")
        self.controller.protective_stop(StopCause(code, argument))

    @verb
    def unlock_protective_stop(self) -> None:
        """Unlock a protective stop immediately; the 5 s wait applies to the dashboard only."""
        self.controller.safety_event(SafetyEvent.UNLOCK)

    @verb
    def press_emergency_stop(self, button: Button = "robot") -> None:
        """Press the emergency stop button of the teach pendant, or the system's; it stays pressed."""
        self._set(_BUTTONS[button], True)

    @verb
    def release_emergency_stop(self, button: Button | None = None) -> None:
        """Release one emergency stop button, or both; the arm stays off until it is switched on."""
        for name, device in _BUTTONS.items():
            if button in (None, name):
                self._set(device, False)

    @verb
    def open_safeguard(self) -> None:
        """Open the safeguard gate: safeguard stop until it is closed."""
        self._set(SafetyDevice.SAFEGUARD, True)

    @verb
    def close_safeguard(self) -> None:
        """Close the safeguard gate. The program resumes, or waits for ``reset_safeguard`` if there is a reset input.

        As delivered, a robot has one.
        """
        self._set(SafetyDevice.SAFEGUARD, False)

    @verb
    def reset_safeguard(self) -> None:
        """Press the safeguard reset button; the program resumes if the gate is closed."""
        pins = self.controller.safety_board.inputs.pins_of(SafetyInput.SAFEGUARD_RESET)
        if not pins:
            raise NotPossible("no input is assigned to the safeguard reset: the program resumes without it")
        self.controller.signals.digital_inputs &= ~pins
        return self._wait(self._rise(pins))

    @verb
    def set_safety_device(self, device: Device, active: bool) -> None:
        """Make a safety device request its stop or mode, or end the request.

        The enabling device requests its stop while it is not held in its middle position.
        """
        self._set(SafetyDevice[device.upper()], active)

    @verb
    def safety_devices(self) -> dict[str, bool]:
        """Whether each emergency stop button and safety device currently requests its stop or mode."""
        inputs = self.controller.safety_board.inputs
        return {device.name.lower(): inputs.active(device) for device in SafetyDevice}

    @verb
    def safety_causes(self) -> dict[str, str]:
        """List what ``trip_safety`` can trigger on this robot, with the error code of each."""
        series = self.controller.model.series
        return {
            cause.name.lower(): f"{row.label} {row.what}"
            for cause, row in CAUSES.items()
            if row.code is not None and row.only in (None, series)
        }

    @verb
    def trip_safety(self, cause: str, joint: int | None = None) -> None:
        """Trigger a protective stop, a violation or a fault; ``safety_causes`` lists them."""
        if joint is not None and not 0 <= joint <= 5:
            raise BadArguments(f"there is no joint {joint}: choose 0 (base) to 5")
        if cause not in self.safety_causes():
            raise BadArguments(unknown("cause", cause, self.safety_causes()))
        self.controller.safety_board.trip(Cause[cause.upper()], joint)

    @verb
    def restart_safety(self) -> None:
        """Restart the safety system after a violation or fault; the arm is then switched off."""
        self.controller.power_event(PowerEvent.POWER_OFF)
        self.controller.safety_event(SafetyEvent.RESTART)

    @verb
    def last_stop(self) -> dict[str, Any] | None:
        """The last stop of the safety system: mode, category 0 to 2, stopping time [s] and tool distance [m]."""
        stop = self.controller.safety_board.last_stop
        if stop is None:
            return None
        return {
            "mode": stop.mode.name,
            "category": stop.category.value,
            "over": stop.done,
            "duration_s": stop.duration_s,
            "distance_m": stop.distance_m,
        }

    @verb
    def set_arm_supply(self, present: bool) -> None:
        """Cut the arm's 48 V supply, or restore it; after restoring it, call ``restart_safety``."""
        self.controller.safety_board.set_supply(present)

    @verb
    def set_remote_control(self, on: bool) -> None:
        """Switch the pendant to remote control, or back to local control, in which ``play`` is refused."""
        self.controller.remote_control, self.controller.remote_control_enabled = on, True

    @verb
    def set_simulation(self, on: bool) -> None:
        """Switch the pendant to Simulation, or back to Real Robot. The arm must be at rest, and no program may run.

        In simulation, programs move a simulated arm, whose state all ports publish; the real arm stands still.
        """
        with refusing(NotPossible):
            self.controller.simulate(on)

    @verb
    def simulation(self) -> dict[str, Any]:
        """Whether the pendant is switched to Simulation, and the joint angles of the real arm [rad]."""
        switch = self.controller.simulation
        return {"on": switch.on, "real_q_rad": list(switch.real.q)}

    @verb
    def hold_freedrive_button(self, held: bool) -> None:
        """Hold the pendant's freedrive button, or release it; held, the arm can be moved while no program runs."""
        self.controller.safety_board.hold_freedrive(held)

    @verb
    def jog(self, qd_rad_s: Vector6) -> None:
        """Move the joints at these speeds, as the pendant's Move tab does; zeros stop them. No program may run."""
        controller, commands = self.controller, self.controller.motion.commands
        free = controller.may_run and controller.programs.state is RuntimeState.STOPPED
        if not (free and plausible(*qd_rad_s)):
            raise NotPossible("the arm may not move, or a program moves it: see robot_mode, safety_mode, runtime_state")
        if any(qd_rad_s):
            commands.speedj(qd_rad_s, a=_JOG_RAD_S2)
        else:
            commands.stopj(_JOG_RAD_S2)

    @verb
    def popups(self) -> list[dict[str, Any]]:
        """List the open popups, oldest first; ``type``: type of the requested answer, NONE for a plain popup."""
        return [
            {"id": popup.request_id, "title": popup.title, "text": popup.text, "type": popup.requested_type.name}
            for popup in self.controller.popups.shown
        ]

    @verb
    def answer_popup(self, popup_id: int, value: int | float | str | bool | None = None) -> None:
        """Close a popup, or answer a question; without a value the question is cancelled."""
        with refusing(NotPossible):
            if not self.controller.popups.answer(popup_id, value):
                raise NotPossible(f"no popup {popup_id} is open")

    def _power(self, event: PowerEvent) -> None:
        if not self.controller.power_event(event):
            raise NotPossible(f"the safety mode {self.controller.safety.mode.name} keeps the arm switched off")

    def _rise(self, pins: int) -> Waiting[None]:
        yield
        self.controller.signals.digital_inputs |= pins

    def _set(self, device: SafetyDevice, active: bool) -> None:
        """Set the device and latch it now, so that the next verb finds the safety system in its new state."""
        board = self.controller.safety_board
        board.inputs.set_device(device, active)
        board.latch()
