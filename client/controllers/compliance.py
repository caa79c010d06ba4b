"""Controllers for freedrive, force mode and tool contact."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from client.controllers.calls import Call, CallingController, CallParameters
from client.controllers.controller import Controller, controller_type
from client.controllers.parameters import PrefixParameters, without_effect
from urproto.compat import IntEnum

_AXES: Final = ("x", "y", "z", "rx", "ry", "rz")
FORCE_MODE_COMMANDS: Final = (
    *(f"force_mode/{group}_{axis}" for group in ("task_frame", "selection_vector", "wrench") for axis in _AXES),
    "force_mode/type",
    *(f"force_mode/limits_{axis}" for axis in _AXES),
    "force_mode/damping",
    "force_mode/gain_scaling",
)
"""Interfaces that are set to start force mode."""
FORCE_MODE_ANSWER: Final = "force_mode/force_mode_async_success"


@dataclass(frozen=True, slots=True)
class FreedriveParameters(PrefixParameters):
    """inactive_timeout: how long freedrive lasts after the last call [s]."""

    inactive_timeout: int = 1
    check_io_successful_retries: int = without_effect(10, "the timeout is measured in robot time")


@controller_type("ur_controllers/FreedriveModeController")
class FreedriveModeController(Controller[FreedriveParameters]):
    """Keeps the arm in freedrive as long as a client keeps requesting it."""

    def __init__(self, name: str, parameters: FreedriveParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.enabled = False
        self._requested_s: float | None = None
        self._wanted: bool | None = None

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(f"{self._component}/{name}" for name in ("async_success", "enable", "abort"))

    @property
    def _component(self) -> str:
        return f"{self.parameters.tf_prefix}freedrive_mode"

    def on_activate(self, time_s: float) -> None:
        self.enabled, self._requested_s, self._wanted = False, None, None

    def on_halt(self, reason: str) -> None:
        self.enabled, self._wanted = False, None

    def enable_freedrive_mode(self, on: bool) -> None:
        """Start or keep alive freedrive (True), at least every inactive_timeout, or end it. Raises ControllerError."""
        self.check_active()
        self._wanted = on

    def update(self, time_s: float, period_s: float) -> None:
        if self._wanted is not None:
            wanted, self._wanted, self._requested_s = self._wanted, None, time_s
            self._change(wanted)
        elif self.enabled and self._requested_s is not None:
            self._change(time_s - self._requested_s <= self.parameters.inactive_timeout)

    def _change(self, wanted: bool) -> None:
        if wanted != self.enabled:
            self.enabled = wanted
            self.commands[f"{self._component}/{'enable' if wanted else 'abort'}"] = 1.0


@controller_type("ur_controllers/ForceModeController")
class ForceModeController(CallingController[CallParameters]):
    """Makes axes of a frame compliant (force mode); alone, or with the passthrough trajectory controller."""

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        names = (*FORCE_MODE_COMMANDS, FORCE_MODE_ANSWER, "force_mode/disable_cmd")
        return tuple(self.parameters.tf_prefix + name for name in names)

    def start_force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        *,
        type: int = 2,  # noqa: A002 # the field's name in ROS and in URScript
        speed_limits: Sequence[float] = (0.05, 0.05, 0.05, 0.5, 0.5, 0.5),
        deviation_limits: Sequence[float] = (0.01,) * 6,
        damping_factor: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> Call:
        """Start force mode, like the ROS service of the same name; each sequence is (6,).

        task_frame_base: the frame, as a pose in the base frame [m, rotation vector]. selection: 1 for each compliant
        axis. wrench: applied to the environment [N, Nm]. type: 1 to 3, see URScript's force_mode. speed_limits: of
        compliant axes [m/s, rad/s]; deviation_limits: of the others [m, rad]. Raises ControllerError.
        """
        groups = (task_frame_base, selection, wrench, speed_limits, deviation_limits)
        if any(len(group) != 6 for group in groups):
            raise self.error("frame, selection, wrench and limits must have six numbers each")
        if type not in (1, 2, 3):
            raise self.error(f"the type of force mode is 1, 2 or 3, not {type}")
        if not (0.0 <= damping_factor <= 1.0 and 0.0 <= gain_scaling <= 2.0):
            raise self.error(f"damping is 0 to 1 and gain scaling 0 to 2, not {damping_factor} and {gain_scaling}")
        pairs = zip(selection, speed_limits, deviation_limits, strict=True)
        limits = [speed if chosen else deviation for chosen, speed, deviation in pairs]
        if any(not limit >= 0.0 for limit in limits) or any(chosen not in (0, 1) for chosen in selection):
            raise self.error("limits cannot be negative, and each selection is 0 or 1")
        values = (*task_frame_base, *selection, *wrench, type, *limits, damping_factor, gain_scaling)
        commands = {name: float(value) for name, value in zip(FORCE_MODE_COMMANDS, values, strict=True)}
        return self._send("start_force_mode", commands, FORCE_MODE_ANSWER)

    def stop_force_mode(self) -> Call:
        """End force mode; the arm holds its pose again. Raises ControllerError."""
        return self._send("stop_force_mode", {"force_mode/disable_cmd": 1.0}, FORCE_MODE_ANSWER)


class ToolContactState(IntEnum):
    """State of contact detection, on the interfaces tool_contact_set_state and tool_contact_state."""

    STANDBY = 1
    WAITING_BEGIN = 2
    EXECUTING = 3
    FAILURE_BEGIN = 4
    WAITING_END = 5
    SUCCESS_END = 6
    FAILURE_END = 7


@dataclass(frozen=True, slots=True)
class ToolContactParameters(PrefixParameters):
    action_monitor_rate: float = without_effect(20.0, "results are reported in the cycle in which they occur")


@controller_type("ur_controllers/ToolContactController")
class ToolContactController(Controller[ToolContactParameters]):
    """Stops the arm when the tool touches something, while another controller moves it. e-Series."""

    def __init__(self, name: str, parameters: ToolContactParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._call: Call | None = None

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return (self._name("tool_contact_set_state"),)

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        names = (self._name("tool_contact_result"), self._name("tool_contact_state"))
        return (*names, f"{self.parameters.tf_prefix}get_robot_software_version/get_version_major")

    def _name(self, interface: str) -> str:
        return f"{self.parameters.tf_prefix}tool_contact/{interface}"

    def on_activate(self, time_s: float) -> None:
        if self.states[self.state_interfaces[2]] < 5.0:
            raise self.error("CB3 robots have no tool contact")
        self._set(ToolContactState.STANDBY)

    def on_deactivate(self) -> None:
        self._end(False, "the controller was deactivated")

    @property
    def watching(self) -> bool:
        return self._call is not None

    def detect_tool_contact(self) -> Call:
        """Watch for a contact. The call succeeds once the arm is back where it began. Raises ControllerError."""
        self.check_active()
        if self._call is not None:
            raise self.error("it is already watching for contact")
        self._call = Call("detect_tool_contact")
        self._set(ToolContactState.WAITING_BEGIN)
        return self._call

    def cancel(self) -> None:
        """Stop watching. Raises ControllerError."""
        self.check_active()
        if self._call is not None:
            self._set(ToolContactState.WAITING_END)
            self._end(False, "canceled")

    def update(self, time_s: float, period_s: float) -> None:
        state = self.states[self._name("tool_contact_state")]
        if state == ToolContactState.EXECUTING and self._call is not None:
            result = self.states[self._name("tool_contact_result")]
            if result == 0.0:
                self._set(ToolContactState.WAITING_END)
                self._end(True, "")
            elif result == 1.0:
                self._set(ToolContactState.STANDBY)
                self._end(False, "watching ended without a contact")
        elif state in (ToolContactState.FAILURE_BEGIN, ToolContactState.FAILURE_END):
            self._set(ToolContactState.STANDBY)
            self._end(False, "the robot did not accept it: see its log")

    def _end(self, success: bool, message: str) -> None:
        call, self._call = self._call, None
        if call is not None:
            call.end(success, message)

    def _set(self, state: ToolContactState) -> None:
        self.commands[self._name("tool_contact_set_state")] = float(state)
