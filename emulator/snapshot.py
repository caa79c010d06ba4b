"""The snapshot that the controller publishes once per control period.

Servers see nothing else of the controller. Its attributes have the names of the RTDE output
fields, so that the RTDE field table needs no getters: the row's name is the attribute.
Vectors are tuples of floats in the field's units.

Each period's snapshot starts as a shallow copy of the previous one (``successor``), and only
changes are written to it (`Marked`); at rest, a snapshot takes a few microseconds.
"""

from dataclasses import dataclass, field, fields
from math import hypot
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, TypeVar

from emulator.devices.tool_line import AS_DELIVERED, SerialSettings
from urproto.compat import Self
from urproto.modes import (
    ControlMode,
    JointMode,
    RobotMode,
    RuntimeState,
    SafetyMode,
    SafetyStatus,
    ToolDigitalOutputMode,
    ToolMode,
    ToolOutputMode,
)
from urproto.primary.messages import RobotMessage
from urproto.primary.program_state import VariableMessage
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6

ValueT = TypeVar("ValueT")

_MAX_PLAUSIBLE: Final = 1e7  # rad, rad/s, A, Nm, m, N, kg: beyond any arm and its load (guess)
_STILL: Final = SimpleNamespace(pose=ZERO6, speed=ZERO6, elbow_position=ZERO3)
_RESTING: Final = SimpleNamespace(now=_STILL, acceleration=ZERO6, elbow_velocity=ZERO3)
_NO_ARM: Final[Any] = SimpleNamespace(
    tool=_RESTING,
    target=_RESTING,
    measured=_STILL,
    sensors=SimpleNamespace(force=ZERO6, acceleration=ZERO3, raw_wrench=ZERO6),
    efforts=SimpleNamespace(
        momentum=0.0,
        target_torque=ZERO6,
        actual_torque=ZERO6,
        target_current=ZERO6,
        actual_current=ZERO6,
        control_output=ZERO6,
        base_wrench=ZERO6,
    ),
)
"""An `emulator.robot.arm.ArmState` of zeros."""


def plausible(*numbers: float) -> bool:
    """Whether numbers in SI units are plausible for an arm and its surroundings: finite, and not absurdly large."""
    if hypot(*numbers) < _MAX_PLAUSIBLE:  # the usual case, checked in a single operation
        return True
    return all(-_MAX_PLAUSIBLE < number < _MAX_PLAUSIBLE for number in numbers)


def _of_arm(path: str, like: ValueT) -> ValueT:
    """A value of the arm, of the type of the example, which is computed when it is read."""
    return property(attrgetter(f"arm.{path}"))  # type: ignore[return-value]  # as seen from outside


@dataclass(kw_only=True, eq=False)
class Snapshot:
    """One control period as seen from outside. Never changed after it has been published.

    Joint vectors: base, shoulder, elbow, wrist 1-3. Poses: x, y, z [m] and rotation
    vector rx, ry, rz [rad] of the TCP in the base frame. The defaults are those of an arm
    that is off, at zero joint angles.
    """

    # time
    step: int = 0  # control periods since the controller started
    timestamp: float = 0.0  # controller uptime [s], from the step counter
    # the arm, whose poses, speeds, torques and currents are computed when they are read
    arm: Any = field(default_factory=lambda: _NO_ARM)
    actual_TCP_pose = _of_arm("measured.pose", ZERO6)
    actual_TCP_speed = _of_arm("measured.speed", ZERO6)
    actual_TCP_force = _of_arm("sensors.force", ZERO6)  # N, Nm
    target_TCP_pose = _of_arm("target.now.pose", ZERO6)
    target_TCP_speed = _of_arm("target.now.speed", ZERO6)
    actual_TCP_acceleration = _of_arm("tool.acceleration", ZERO6)
    target_TCP_acceleration = _of_arm("target.acceleration", ZERO6)
    elbow_position = _of_arm("tool.now.elbow_position", ZERO3)
    elbow_velocity = _of_arm("tool.elbow_velocity", ZERO3)
    actual_tool_accelerometer = _of_arm("sensors.acceleration", ZERO3)  # m/s2
    ft_raw_wrench = _of_arm("sensors.raw_wrench", ZERO6)  # in the flange frame
    actual_momentum = _of_arm("efforts.momentum", 0.0)
    target_moment = _of_arm("efforts.target_torque", ZERO6)
    target_current = _of_arm("efforts.target_current", ZERO6)
    actual_current = _of_arm("efforts.actual_current", ZERO6)
    actual_current_as_torque = _of_arm("efforts.actual_torque", ZERO6)
    joint_control_output = _of_arm("efforts.control_output", ZERO6)
    target_base_wrench = _of_arm("efforts.base_wrench", ZERO6)
    # joints: rad, rad/s, rad/s2, A
    target_q: Vector6 = ZERO6
    target_qd: Vector6 = ZERO6
    target_qdd: Vector6 = ZERO6
    actual_q: Vector6 = ZERO6
    actual_qd: Vector6 = ZERO6
    actual_current_window: Vector6 = ZERO6
    joint_temperatures: Vector6 = ZERO6  # degC
    actual_joint_voltage: Vector6 = ZERO6  # V
    joint_mode: tuple[JointMode, ...] = (JointMode.POWER_OFF,) * 6
    # tool centre point
    tcp_offset: Vector6 = ZERO6  # flange to TCP
    tcp_force_scalar: float = 0.0
    wrench_calc_from_currents: Vector6 = ZERO6
    # payload
    payload: float = 0.0
    payload_cog: Vector3 = ZERO3
    payload_inertia: Vector6 = ZERO6  # Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2]
    target_gravity: Vector3 = ZERO3
    target_base_acceleration: Vector6 = ZERO6
    # modes
    robot_mode: RobotMode = RobotMode.POWER_OFF
    safety_mode: SafetyMode = SafetyMode.NORMAL
    safety_status: SafetyStatus = SafetyStatus.NORMAL
    control_mode: ControlMode = ControlMode.POSITION
    runtime_state: RuntimeState = RuntimeState.STOPPED
    robot_status_bits: int = 0
    safety_status_bits: int = 1
    # speed
    speed_scaling: float = 0.0  # 0 while no program plays
    target_speed_fraction: float = 1.0
    time_scale_source: int = 0  # the numbering is not published
    # electrics
    actual_main_voltage: float = 0.0
    actual_robot_voltage: float = 0.0
    actual_robot_current: float = 0.0
    io_current: float = 0.0
    actual_execution_time: float = 0.0
    target_execution_time: float = 0.0
    actual_robot_energy_consumed: float = 0.0
    actual_robot_braking_energy_dissipated: float = 0.0
    joint_position_deviation_ratio: float = 0.0
    collision_detection_ratio: float = 0.0
    # inputs and outputs: bits 0-7 standard, 8-15 configurable, 16-17 tool
    actual_digital_input_bits: int = 0
    actual_digital_output_bits: int = 0
    actual_configurable_digital_input_bits: int = 0
    actual_configurable_digital_output_bits: int = 0
    analog_io_types: int = 0
    standard_analog_input0: float = 0.0
    standard_analog_input1: float = 0.0
    standard_analog_output0: float = 0.0
    standard_analog_output1: float = 0.0
    euromap67_input_bits: int = 0
    euromap67_output_bits: int = 0
    euromap67_24V_voltage: float = 0.0
    euromap67_24V_current: float = 0.0
    encoder0_raw: int = 0
    encoder1_raw: int = 0
    # tool
    tool_mode: ToolMode = ToolMode.POWER_OFF
    tool_analog_input_types: int = 0
    tool_analog_input0: float = 0.0
    tool_analog_input1: float = 0.0
    tool_output_voltage: int = 0
    tool_output_current: float = 0.0
    tool_output_voltage_2: int = 0  # the second supply of newer tool flanges, which is not emulated
    tool_output_current_2: float = 0.0
    tool_temperature: float = 0.0
    tool_output_mode: int = ToolOutputMode.DIGITAL
    tool_communication: SerialSettings = AS_DELIVERED
    tool_bytes: bytes = b""  # received over the tool's serial line in this period
    tool_digital_output0_mode: int = ToolDigitalOutputMode.SINKING_NPN
    tool_digital_output1_mode: int = ToolDigitalOutputMode.SINKING_NPN
    # registers: 128 booleans packed into one integer (bit n is register n), 48 integers, 48 doubles
    output_bit_registers: int = 0
    output_int_registers: tuple[int, ...] = (0,) * 48
    output_double_registers: tuple[float, ...] = (0.0,) * 48
    input_bit_registers: int = 0
    input_int_registers: tuple[int, ...] = (0,) * 48
    input_double_registers: tuple[float, ...] = (0.0,) * 48
    # program
    script_control_line: int = 0
    program_name: str = ""
    program_running: bool = False  # playing (not paused)
    program_paused: bool = False
    # messages of this period, in order
    messages: tuple[RobotMessage | VariableMessage, ...] = ()
    # for the primary interface only
    force_mode_frame: Vector6 = ZERO6  # task frame in the base frame, zero without force mode
    board_temperature: float = 0.0  # degC, of the control box
    tool_board_voltage: float = 0.0  # V, as the tool data report it
    io_freedrive: bool = False  # an input holds the arm in freedrive
    safety_checksum: int = 0  # of the active safety configuration
    simulation: bool = False  # the pendant's switch is on Simulation: the real arm stands still
    switched_on: bool = False  # the arm has been on since the controller started
    safety_confirmed: bool = True  # the safety setup; until then, RTDE sends no data
    local_control: bool = False  # an e-Series arm that refuses commands from the network

    def successor(self) -> Self:
        """A shallow copy for the next period."""
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        return copy

    def values(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in NAMES}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Snapshot) and self.values() == other.values()

    __hash__ = None  # type: ignore[assignment]  # as of any other container


NAMES: Final = (
    *(row.name for row in fields(Snapshot) if row.name != "arm"),
    *(name for name, value in vars(Snapshot).items() if isinstance(value, property)),
)
"""Names of the values of a snapshot."""


class Marked:
    """Base of machine parts that track changes, so that they are written to the snapshot only after a change.

    Every assignment to an attribute, or to an item of a list in one, is tracked automatically.
    """

    if not TYPE_CHECKING:  # otherwise, type checkers would allow assignments to any name

        def __setattr__(self, name: str, value: Any) -> None:
            own = vars(self)
            own[name] = _MarkedList(value, own) if isinstance(value, list) else value
            own["_changed"] = True

    def take_change(self) -> bool:
        """Whether anything has changed since the last call."""
        own = vars(self)
        changed: bool = own["_changed"]
        own["_changed"] = False
        return changed

    def mark(self) -> None:
        vars(self)["_changed"] = True


class _MarkedList(list[Any]):
    """A list of fixed length that marks its owner."""

    def __init__(self, values: list[Any], owner: dict[str, Any]) -> None:
        super().__init__(values)
        self._owner = owner

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(index, value)
        self._owner["_changed"] = True
