"""The state interfaces of a Universal Robots arm, and how RTDE fills them.

Source of names and meaning: the hardware interface of Universal_Robots_ROS2_Driver. Values that a robot does not report
stay NaN.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import hypot
from typing import Any, Final

from client.controllers.controller import Interfaces
from client.controllers.motion_primitives import READY, STATUS
from client.errors import StateError
from urproto.joints import JOINT_NAMES
from urproto.robots.pose import pose_inv, pose_trans, rotvec_to_quaternion, wrench_trans
from urproto.rtde.fields import MAX_TIMESTAMP_S, OUTPUT_FIELDS
from urproto.signals import SIGNALS
from urproto.text import quoted
from urproto.versions import PolyscopeVersion, Series

RTDE_OUTPUTS: Final = (
    "actual_q", "actual_qd", "actual_current", "speed_scaling", "actual_TCP_force", "actual_TCP_pose",
    "target_TCP_pose", "standard_analog_input0", "standard_analog_input1", "standard_analog_output0",
    "standard_analog_output1", "tool_mode", "tool_analog_input0", "tool_analog_input1", "tool_output_voltage",
    "tool_output_current", "tool_temperature", "robot_status_bits", "safety_status_bits",
    "actual_digital_input_bits", "actual_digital_output_bits", "analog_io_types", "tool_analog_input_types",
)  # fmt: skip
"""RTDE outputs to receive; every version has them. payload, payload_cog, payload_inertia, tcp_offset are optional."""

_SINGLE: Final = {
    "standard_analog_input0": "gpio/standard_analog_input_0",
    "standard_analog_input1": "gpio/standard_analog_input_1",
    "standard_analog_output0": "gpio/standard_analog_output_0",
    "standard_analog_output1": "gpio/standard_analog_output_1",
    "tool_analog_input0": "gpio/tool_analog_input_0",
    "tool_analog_input1": "gpio/tool_analog_input_1",
    "tool_output_voltage": "gpio/tool_output_voltage",
    "tool_output_current": "gpio/tool_output_current",
    "tool_temperature": "gpio/tool_temperature",
    "tool_mode": "gpio/tool_mode",
    "robot_mode": "gpio/robot_mode",
    "safety_mode": "gpio/safety_mode",
    "target_speed_fraction": "speed_scaling/target_speed_fraction",
    "payload": "payload/mass",
}
_BITS: Final = {
    "actual_digital_input_bits": ("gpio/digital_input", SIGNALS),
    "actual_digital_output_bits": ("gpio/digital_output", SIGNALS),
    "safety_status_bits": ("gpio/safety_status_bit", 11),
    "robot_status_bits": ("gpio/robot_status_bit", 4),
    "analog_io_types": ("gpio/analog_io_type", 4),
    "tool_analog_input_types": ("gpio/tool_analog_input_type", 2),
}
_VECTORS: Final = {
    "payload_cog": tuple(f"payload/cog.{axis}" for axis in "xyz"),
    "payload_inertia": tuple(f"payload/inertia.i{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
}
_WRENCH: Final = tuple(f"tcp_fts_sensor/{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
_POSE: Final = (
    *(f"tcp_pose/position.{axis}" for axis in "xyz"),
    *(f"tcp_pose/orientation.{axis}" for axis in "xyzw"),
)
_VERSION: Final = tuple(
    f"get_robot_software_version/get_version_{part}" for part in ("major", "minor", "bugfix", "build")
)
_MAX_ABS: Final = 1e6
"""Upper bound of every angle, speed, current, force, voltage and temperature of an arm, in RTDE's units; guess."""
_NUMBERS: Final = ("speed_scaling", *_SINGLE)
_ROWS: Final = tuple(
    (name, OUTPUT_FIELDS[name].type.count)
    for name in (
        *("actual_q", "actual_qd", "actual_current", "actual_TCP_pose", "target_TCP_pose", "actual_TCP_force"),
        *("tcp_offset", *_VECTORS),
    )
)
_OTHERS: Final = (
    "speed_scaling/speed_scaling_factor",
    "gpio/program_running",
    "system_interface/initialized",
    "tool_contact/tool_contact_result",
    "tool_contact/tool_contact_state",
    STATUS,
    READY,
)


def check(state: Mapping[str, Any]) -> None:
    """Check that a control loop can use a state: the right count of numbers, and values that an arm can have.

    It is done once, when a state arrives (2 µs), so that later code need not check again. Missing variables
    are not checked. Raises StateError.
    """
    numbers: list[float] = []
    for name, count in _ROWS:
        values = state.get(name)
        if values is not None:
            if len(values) != count:
                raise StateError(name, f"has {len(values)} numbers instead of {count}")
            numbers += values
    for name in _NUMBERS:
        if (value := state.get(name)) is not None:
            numbers.append(value)
    if not hypot(*numbers) < _MAX_ABS:  # one call for all of them; false for NaN too
        for name in (*_NUMBERS, *(name for name, _ in _ROWS)):
            values = state.get(name)
            if values is not None and not hypot(*(values if isinstance(values, Sequence) else (values,))) < _MAX_ABS:
                raise StateError(name, f"is {quoted(values)}, which no arm has")
    if not abs(state["timestamp"]) < MAX_TIMESTAMP_S:
        raise StateError("timestamp", f"is {state['timestamp']!r}, which is not a time")


class PrefixedInterfaces:
    """State or command interfaces (`all`) of the joints and with other names; all begin with `prefix`."""

    def __init__(self, prefix: str, others: Iterable[str]) -> None:
        joints = [f"{prefix}{joint}/{kind}" for kind in ("position", "velocity", "effort") for joint in JOINT_NAMES]
        self._prefix = prefix
        self.all = Interfaces([*joints, *(prefix + name for name in others)])

    def joints(self, kind: str) -> Interfaces:
        """Interfaces of one kind, base to wrist 3."""
        return self.all.lend([f"{self._prefix}{joint}/{kind}" for joint in JOINT_NAMES])

    def part(self, names: Sequence[str]) -> Interfaces:
        """Some of the interfaces, named without the prefix."""
        return self.all.lend([self._prefix + name for name in names])

    def __getitem__(self, name: str) -> float:
        return self.all[self._prefix + name]

    def __setitem__(self, name: str, value: float) -> None:
        self.all[self._prefix + name] = value


class URStates(PrefixedInterfaces):
    """The state interfaces; `take` fills them from RTDE."""

    def __init__(self, prefix: str, version: PolyscopeVersion) -> None:
        bits = [f"{name}_{place}" for name, count in _BITS.values() for place in range(count)]
        vectors = _names(_VECTORS.values())
        super().__init__(prefix, (*_SINGLE.values(), *bits, *vectors, *_WRENCH, *_POSE, *_VERSION, *_OTHERS))
        self._flange_sensor = version.series is not Series.CB3
        self._bits: dict[str, int] = {}
        self._rows = self._make_rows()
        self.part(_VERSION).put([float(part) for part in (version.major, version.minor, version.bugfix, version.build)])
        self["system_interface/initialized"] = 1.0

    def take(self, state: Mapping[str, Any]) -> None:
        """Set the interfaces from RTDE variables by name; missing ones are left unchanged. Raises StateError."""
        check(state)
        for variable, put in self._rows:
            value = state.get(variable)
            if value is not None:
                put(value)
        if "actual_TCP_force" in state and "target_TCP_pose" in state:
            self._wrench.put(self._at_tcp(state))

    def _make_rows(self) -> list[tuple[str, Callable[[Any], None]]]:
        self._wrench = self.part(_WRENCH)
        pose = self.part(_POSE)
        rows: list[tuple[str, Callable[[Any], None]]] = [
            ("actual_q", self.joints("position").put),
            ("actual_qd", self.joints("velocity").put),
            ("actual_current", self.joints("effort").put),
            ("actual_TCP_pose", lambda value: pose.put((*value[:3], *rotvec_to_quaternion(*value[3:])))),
        ]
        rows += [(variable, self.part([name]).fill) for variable, name in _SINGLE.items()]
        rows += [(variable, self.part(names).put) for variable, names in _VECTORS.items()]
        return rows + [(variable, self._bit_setter(variable)) for variable in _BITS]

    def _bit_setter(self, variable: str) -> Callable[[int], None]:
        name, count = _BITS[variable]
        part = self.part([f"{name}_{place}" for place in range(count)])

        def put(value: int) -> None:
            if self._bits.get(variable) != value:
                self._bits[variable] = value
                part.put([float(value >> place & 1) for place in range(count)])

        return put

    def _at_tcp(self, state: Mapping[str, Any]) -> Sequence[float]:
        """The wrench in the TCP's frame: e-Series report it about the flange, CB3 at the TCP, both in base axes."""
        turn = (0.0, 0.0, 0.0, *state["target_TCP_pose"][3:])
        wrench = state["actual_TCP_force"]
        if not self._flange_sensor or "tcp_offset" not in state:
            return wrench_trans(turn, wrench)
        offset = state["tcp_offset"]
        flange = pose_trans(turn, pose_inv((0.0, 0.0, 0.0, *offset[3:])))
        return wrench_trans(offset, wrench_trans(flange, wrench))


def _names(groups: Iterable[Sequence[str]]) -> tuple[str, ...]:
    return tuple(name for group in groups for name in group)
