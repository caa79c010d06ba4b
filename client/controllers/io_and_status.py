"""Inputs, outputs, modes and settings of the robot, and small controllers for one setting each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

from client.controllers.calls import Call, CallingController, CallParameters
from client.controllers.controller import Controller, Topic, controller_type
from client.controllers.parameters import PrefixParameters, without_effect
from urproto.signals import SIGNALS

_EVERY_CYCLE: Final = "the effect is waited for in robot time"
DIGITAL: Final = tuple(f"gpio/standard_digital_output_cmd_{pin}" for pin in range(SIGNALS))
ANALOG: Final = tuple(f"gpio/standard_analog_output_cmd_{pin}" for pin in range(2))
DOMAIN: Final = "gpio/analog_output_domain_cmd"
IO_ANSWER: Final = "gpio/io_async_success"
PAYLOAD: Final = ("payload/mass", "payload/cog.x", "payload/cog.y", "payload/cog.z")
INERTIA: Final = (
    *(f"payload/inertia.i{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
    "payload/transition_time",
)
_PAYLOAD_OFF: Final = 1e-4  # kg, m, kg m2: the ROS 2 driver's tolerance of centre and inertia
TRIGGERS: Final = ("resend_robot_program", "hand_back_control", "zero_ftsensor")
GPIO_COMMANDS: Final = (
    *DIGITAL,
    *ANALOG,
    DOMAIN,
    "gpio/tool_voltage_cmd",
    IO_ANSWER,
    "speed_scaling/target_speed_fraction_cmd",
    "speed_scaling/target_speed_fraction_async_success",
    *PAYLOAD,
    *INERTIA,
    "payload/payload_async_success",
    *(f"{name}/{name}_{end}" for name in TRIGGERS for end in ("cmd", "async_success")),
)
"""Command interfaces of the `GPIOController`."""


class IOStates(NamedTuple):
    """Levels of the 18 digital signals (0-7 standard, 8-15 configurable, 16-17 tool) and of the analog ones.

    An analog signal is in V where its type is 1, in A where it is 0.
    """

    digital_in: tuple[bool, ...]
    digital_out: tuple[bool, ...]
    analog_in: tuple[float, ...]
    analog_out: tuple[float, ...]
    analog_types: tuple[int, ...]


class ToolData(NamedTuple):
    """Data of the tool connector: [V], [A], [degC]; mode is one of urproto.modes.ToolMode.

    An analog input is in V where its type is 1, in A where it is 0.
    """

    analog_in: tuple[float, ...]
    analog_types: tuple[int, ...]
    output_voltage: float
    output_current: float
    temperature: float
    mode: int


@dataclass(frozen=True, slots=True)
class GPIOParameters(PrefixParameters):
    """verify_payload_on_set: a payload counts as set once the robot reports it."""

    check_io_successfull_retries: int = without_effect(10, _EVERY_CYCLE)
    verify_payload_on_set: bool = True


@controller_type("ur_controllers/GPIOController")
class GPIOController(CallingController[GPIOParameters]):
    """Publishes inputs, outputs and tool data, and modes when they change; sets outputs and other settings.

    Every setting returns a `Call`, which is answered once the robot has accepted it; for outputs and the speed slider,
    once its effect is seen.
    """

    def __init__(self, name: str, parameters: GPIOParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.io_states: Topic[IOStates] = Topic()
        self.tool_data: Topic[ToolData] = Topic()
        self.robot_mode: Topic[int] = Topic()
        self.safety_mode: Topic[int] = Topic()
        self.program_running: Topic[bool] = Topic()

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(self.parameters.tf_prefix + name for name in GPIO_COMMANDS)

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        prefix = self.parameters.tf_prefix
        return (f"{prefix}gpio/*", f"{prefix}speed_scaling/*", f"{prefix}payload/*")

    def on_silence(self, reason: str) -> None:
        super().on_silence(reason)
        _publish_if_changed(self.program_running, False)

    def update(self, time_s: float, period_s: float) -> None:
        super().update(time_s, period_s)
        self.io_states.publish(self._io_states())
        self.tool_data.publish(self._tool_data())
        _publish_if_changed(self.robot_mode, self._whole("gpio/robot_mode"))
        _publish_if_changed(self.safety_mode, self._whole("gpio/safety_mode"))
        _publish_if_changed(self.program_running, self._state("gpio/program_running") == 1.0)

    def set_digital_out(self, pin: int, on: bool) -> Call:
        """Set a digital output; pins are numbered as in `IOStates`. Raises ControllerError."""
        self._check_pin(pin, SIGNALS, "digital output")
        output = f"gpio/digital_output_{pin}"
        return self._send(
            f"digital output {pin}",
            {DIGITAL[pin]: float(on)},
            IO_ANSWER,
            lambda: self._state(output) == float(on),
        )

    def set_analog_out(self, pin: int, share: float, *, voltage: bool | None = None) -> Call:
        """Set an analog output to a share, 0 to 1, of its range.

        voltage: True for 0 to 10 V, False for 4 to 20 mA, None leaves the domain unchanged.
        """
        self._check_pin(pin, 2, "analog output")
        if not 0.0 <= share <= 1.0:
            raise self.error(f"an analog output takes 0 to 1 of its range, not {share}")
        values = {ANALOG[pin]: share}
        if voltage is not None:
            values[DOMAIN] = float(voltage)
        return self._send(f"analog output {pin}", values, IO_ANSWER)

    def set_tool_voltage(self, volts: float) -> Call:
        """Set the supply voltage at the tool: 0, 12 or 24 V."""
        if volts not in (0, 12, 24):
            raise self.error(f"the tool voltage is 0, 12 or 24 V, not {volts}")
        return self._send("tool voltage", {"gpio/tool_voltage_cmd": float(volts)}, IO_ANSWER)

    def set_speed_slider(self, fraction: float) -> Call:
        """Set the speed slider, 0.01 to 1."""
        if not 0.01 <= fraction <= 1.0:
            raise self.error(f"the speed slider takes 0.01 to 1, not {fraction}")
        return self._send(
            "speed slider",
            {"speed_scaling/target_speed_fraction_cmd": fraction},
            "speed_scaling/target_speed_fraction_async_success",
            lambda: abs(self._state("speed_scaling/target_speed_fraction") - fraction) < 1e-3,
        )

    def resend_robot_program(self) -> Call:
        """Start the control program on the robot again."""
        return self._trigger("resend_robot_program")

    def hand_back_control(self) -> Call:
        """End the control program; the robot's own program continues after it."""
        return self._trigger("hand_back_control")

    def set_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] | None = None,
        transition_time_s: float = 0.0,
    ) -> Call:
        """Set mass, centre of gravity (3,) in the flange frame and, from 5.10 on, inertia (6,) and transition time."""
        if len(cog_m) != 3 or (inertia_kg_m2 is not None and len(inertia_kg_m2) != 6):
            raise self.error("a centre of gravity must have 3 numbers, an inertia 6: xx, yy, zz, xy, xz, yz")
        values = dict(zip(PAYLOAD, (mass_kg, *cog_m), strict=True))
        if inertia_kg_m2 is not None:
            values |= zip(INERTIA, (*inertia_kg_m2, transition_time_s), strict=True)
        checked = self.parameters.verify_payload_on_set and transition_time_s < 1.0
        return self._send(
            "payload", values, "payload/payload_async_success", lambda: self._reports(values) if checked else True
        )

    def _reports(self, values: Mapping[str, float]) -> bool:
        """Whether the robot reports these values, to single precision; values that it does not report are ignored."""
        seen = [(self._state(name), value) for name, value in values.items() if name != "payload/transition_time"]
        return all(state != state or abs(state - value) <= _PAYLOAD_OFF for state, value in seen)

    def zero_ftsensor(self) -> Call:
        """Zero the force/torque sensor (take the present wrench as zero); e-Series."""
        return self._trigger("zero_ftsensor")

    def _trigger(self, name: str) -> Call:
        return self._send(name, {f"{name}/{name}_cmd": 1.0}, f"{name}/{name}_async_success")

    def _check_pin(self, pin: int, count: int, what: str) -> None:
        if not 0 <= pin < count:
            raise self.error(f"there is no {what} {pin}: they are numbered from 0 to {count - 1}")

    def _state(self, name: str) -> float:
        return self.states[self.parameters.tf_prefix + name]

    def _whole(self, name: str) -> int:
        value = self._state(name)
        return int(value) if value == value else -1

    def _levels(self, name: str, count: int) -> tuple[bool, ...]:
        return tuple(self._state(f"{name}_{pin}") == 1.0 for pin in range(count))

    def _values(self, name: str, count: int) -> tuple[float, ...]:
        return tuple(self._state(f"{name}_{pin}") for pin in range(count))

    def _io_states(self) -> IOStates:
        return IOStates(
            self._levels("gpio/digital_input", SIGNALS),
            self._levels("gpio/digital_output", SIGNALS),
            self._values("gpio/standard_analog_input", 2),
            self._values("gpio/standard_analog_output", 2),
            tuple(self._whole(f"gpio/analog_io_type_{pin}") for pin in range(4)),
        )

    def _tool_data(self) -> ToolData:
        return ToolData(
            self._values("gpio/tool_analog_input", 2),
            tuple(self._whole(f"gpio/tool_analog_input_type_{pin}") for pin in range(2)),
            self._state("gpio/tool_output_voltage"),
            self._state("gpio/tool_output_current"),
            self._state("gpio/tool_temperature"),
            self._whole("gpio/tool_mode"),
        )


def _publish_if_changed(topic: Topic[Any], message: object) -> None:
    if topic.latest != message:
        topic.publish(message)


class _SettingController(CallingController[CallParameters]):
    """Base class: a group of command interfaces with an answer."""

    names: ClassVar[tuple[str, ...]] = ()
    answer: ClassVar[str] = ""

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(self.parameters.tf_prefix + name for name in (*self.names, self.answer))

    def _set(self, title: str, values: Sequence[float]) -> Call:
        if len(values) != len(self.names):
            raise self.error(f"{title} has {len(self.names)} numbers, not {len(values)}")
        return self._send(title, dict(zip(self.names, values, strict=True)), self.answer)


@controller_type("ur_controllers/GravityUpdateController")
class GravityUpdateController(_SettingController):
    """Sets the direction of gravity, that is, how the robot is mounted."""

    names = ("gravity/x", "gravity/y", "gravity/z")
    answer = "gravity/gravity_async_success"

    def set_gravity(self, gravity_m_s2: Sequence[float]) -> Call:
        """Set the acceleration of the base (3,) [m/s2]: [0, 0, 9.82] for an upright arm. Raises ControllerError."""
        return self._set("gravity", gravity_m_s2)


@controller_type("ur_controllers/FrictionModelController")
class FrictionModelController(_SettingController):
    """Sets how much friction torque control compensates; PolyScope 5.25.1 or newer."""

    names = tuple(f"friction_model/{kind}_{joint}" for kind in ("viscous", "coulomb") for joint in range(6))
    answer = "friction_model/async_success"

    def set_friction_model_parameters(self, viscous: Sequence[float], coulomb: Sequence[float]) -> Call:
        """Set the compensated share, 0 to 1, of each joint's friction (6,). Raises ControllerError."""
        if not all(0.0 <= share <= 1.0 for share in (*viscous, *coulomb)):
            raise self.error("friction compensation takes shares from 0 to 1")
        return self._set("friction", (*viscous, *coulomb))


@controller_type("ur_controllers/URConfigurationController")
class URConfigurationController(Controller[CallParameters]):
    """Reports the version of the robot's software."""

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        name = f"{self.parameters.tf_prefix}get_robot_software_version/get_version"
        return tuple(f"{name}_{part}" for part in ("major", "minor", "bugfix", "build"))

    def robot_software_version(self) -> tuple[int, ...]:
        """Major, minor, bugfix and build. Raises ControllerError while it is not active."""
        self.check_active()
        return tuple(int(value) for value in self.states.get())
