"""The enumerations shared by the controller's interfaces.

Numbers are the wire values of RTDE, the realtime and the primary interface. Sources: the public client libraries of
Universal Robots, the RTDE guide and the ROS message definitions. Values from a single source are marked.
"""

from collections.abc import Mapping
from typing import Final, TypeVar

from urproto.compat import IntEnum, IntFlag

Mode = TypeVar("Mode", bound=IntEnum)


def mode_of(modes: type[Mode], number: int) -> Mode:
    """The member of an enumeration; ``UNKNOWN(n)``, equal to its number, for an unknown one.

    A newer robot may have more members than these tables, and a faulty one may send any number.
    """
    try:
        return modes(number)
    except ValueError:
        unknown = int.__new__(modes, number)
        unknown._name_, unknown._value_ = f"UNKNOWN({number})", number
        return unknown


def mode_name(modes: type[IntEnum], number: float) -> str:
    """The name of a member; ``UNKNOWN(n)`` for an unknown one."""
    try:
        return modes(number).name  # type: ignore[arg-type]  # 7.0, as the realtime interface sends it, is 7 here too
    except ValueError:
        return f"UNKNOWN({number if isinstance(number, int) else format(number, 'g')})"


class RobotMode(IntEnum):
    """State of the arm as a whole (RTDE robot_mode, dashboard ``robotmode``)."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """Safety mode. CB3 reports 1-11; it reports SAFEGUARD_STOP in place of the more specific ones above."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13
    TP_THREE_POSITION_ENABLING_STOP = 14
    IMMI_EMERGENCY_STOP = 15
    IMMI_SAFEGUARD_STOP = 16
    PROFISAFE_WAITING_FOR_PARAMETERS = 17
    PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP = 18
    PROFISAFE_SAFEGUARD_STOP = 19
    PROFISAFE_EMERGENCY_STOP = 20
    SAFETY_API_SAFEGUARD_STOP = 22


class SafetyStatus(IntEnum):
    """More specific than the safety mode (RTDE safety_status, from 3.10 and 5.4).

    Values 10 and up follow the ROS message definition; one other library numbers the
    automatic-mode and three-position stops 10 and 11.
    """

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13
    TP_THREE_POSITION_ENABLING_STOP = 14
    IMMI_EMERGENCY_STOP = 15
    IMMI_SAFEGUARD_STOP = 16
    PROFISAFE_WAITING_FOR_PARAMETERS = 17
    PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP = 18
    PROFISAFE_SAFEGUARD_STOP = 19
    PROFISAFE_EMERGENCY_STOP = 20
    SAFETY_API_SAFEGUARD_STOP = 22
    IO_PLANE_STOP = 23


class SafetyStatusBits(IntFlag):
    """RTDE safety_status_bits."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOPPED = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOPPED = 1 << 4
    SYSTEM_EMERGENCY_STOPPED = 1 << 5
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED_DUE_TO_SAFETY = 1 << 10
    ENABLING_INPUT_ACTIVE = 1 << 11  # of a three-position device, from 5.25


class RobotStatusBits(IntFlag):
    """RTDE robot_status_bits."""

    POWER_ON = 1 << 0
    PROGRAM_RUNNING = 1 << 1
    TEACH_BUTTON = 1 << 2
    POWER_BUTTON = 1 << 3


class JointMode(IntEnum):
    """State of a joint. 237 and 248-250 are internal or obsolete."""

    RESET = 235
    SHUTTING_DOWN = 236
    PART_D_CALIBRATION = 237
    BACKDRIVE = 238
    POWER_OFF = 239
    READY_FOR_POWER_OFF = 240
    NOT_RESPONDING = 245
    MOTOR_INITIALISATION = 246
    BOOTING = 247
    PART_D_CALIBRATION_ERROR = 248
    BOOTLOADER = 249
    CALIBRATION = 250
    VIOLATION = 251  # one source has 51
    FAULT = 252
    RUNNING = 253
    IDLE = 255


class ToolMode(IntEnum):
    """State of the board in the tool flange."""

    RESET = 235
    SHUTTING_DOWN = 236
    POWER_OFF = 239
    NOT_RESPONDING = 245
    BOOTING = 247
    BOOTLOADER = 249
    FAULT = 252
    RUNNING = 253
    IDLE = 255


class ControlMode(IntEnum):
    """How the arm is being controlled (primary interface, robot mode data)."""

    POSITION = 0
    TEACH = 1
    FORCE = 2
    TORQUE = 3


class RuntimeState(IntEnum):
    """State of the running program (RTDE runtime_state, realtime program state)."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MODE_OUTPUTS: Final[Mapping[str, type[IntEnum]]] = {
    "robot_mode": RobotMode,
    "safety_mode": SafetyMode,
    "runtime_state": RuntimeState,
}
"""The RTDE outputs that say in which modes a robot and its program are."""


class ReportLevel(IntEnum):
    """Severity of a robot message; 128 and up are developer versions of the first six."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    VIOLATION = 3
    FAULT = 4
    CRITICAL_FAULT = 5
    DEVELOPER_DEBUG = 128
    DEVELOPER_INFO = 129
    DEVELOPER_WARNING = 130
    DEVELOPER_VIOLATION = 131
    DEVELOPER_FAULT = 132
    DEVELOPER_CRITICAL_FAULT = 133


class ReportDataType(IntEnum):
    """How to interpret the data word of an error or safety message.

    Only INT32 and FLOAT change the reading; 4 is shown in hexadecimal, everything else
    as an unsigned number. The names of 0 and 1 are guesses.
    """

    NONE = 0
    UINT32 = 1
    INT32 = 2
    FLOAT = 3
    HEX = 4


class RequestedType(IntEnum):
    """Type of the value a popup or request message asks the operator for."""

    BOOLEAN = 0
    INTEGER = 1
    FLOAT = 2
    STRING = 3
    POSE = 4
    JOINT_VECTOR = 5
    WAYPOINT = 6
    EXPRESSION = 7
    NONE = 8


class MessageSource(IntEnum):
    """Which part of the system a robot message comes from."""

    GUI = -5
    SIMULATED_ROBOT = -4
    RT_MACHINE = -3
    ROBOT_INTERFACE = -2
    UNDEFINED = -1  # the name is a guess
    CONTROLLER = 7
    RTDE = 8
    SAFETY_PROCESSOR_A = 20
    SAFETY_PROCESSOR_B = 30
    SCB_FPGA = 40
    JOINT_0_FPGA = 100
    JOINT_1_FPGA = 101
    JOINT_2_FPGA = 102
    JOINT_3_FPGA = 103
    JOINT_4_FPGA = 104
    JOINT_5_FPGA = 105
    TOOL_FPGA = 106
    EUROMAP_FPGA = 107
    TEACH_PENDANT_A = 108
    JOINT_0_A = 110
    JOINT_1_A = 111
    JOINT_2_A = 112
    JOINT_3_A = 113
    JOINT_4_A = 114
    JOINT_5_A = 115
    TOOL_A = 116
    EUROMAP_A = 117
    TEACH_PENDANT_B = 118
    JOINT_0_B = 120
    JOINT_1_B = 121
    JOINT_2_B = 122
    JOINT_3_B = 123
    JOINT_4_B = 124
    JOINT_5_B = 125
    TOOL_B = 126
    EUROMAP_B = 127


class RobotType(IntEnum):
    """Robot type in the primary interface's configuration data: the size, not the generation."""

    UR5 = 1
    UR10 = 2
    UR3 = 3
    UR16 = 4
    UR18 = 5
    UR8LONG = 6
    UR20 = 7
    UR30 = 8
    UR15 = 9


class RobotSubType(IntEnum):
    """Generation, in the configuration data (one source; a UR5e simulator agrees)."""

    CB2 = 1
    CB3 = 2
    E_SERIES = 3


class ControllerBox(IntEnum):
    """Controller box type, in the configuration data (one source; a UR5e simulator agrees)."""

    UR5 = 4
    UR10 = 5
    UR3 = 6
    UR20 = 10
    UR30 = 11
    UR16 = 16


class KinematicsStatus(IntEnum):
    """Calibration status in the kinematics data, as a controller's own calibration.conf explains it.

    A calibrated arm is linearised (caiobarrosv/ur5_isaac_simulation issue 4, MyRobotLab/pyrobotlab issue 145: a UR3's
    file); a simulator, which has no calibration, is not initialised.
    """

    NOT_INITIALISED = 0
    NOT_LINEARISED = 1
    LINEARISED = 2


class AnalogDomain(IntEnum):
    """Whether an analog input or output works in current [A] or voltage [V]."""

    CURRENT = 0
    VOLTAGE = 1


class ToolOutputMode(IntEnum):
    """Use of the tool connector's output pins (e-Series)."""

    DIGITAL = 0
    DUAL_PIN_POWER = 1


class ToolDigitalOutputMode(IntEnum):
    """Drive of one tool digital output (e-Series)."""

    SINKING_NPN = 1
    SOURCING_PNP = 2
    PUSH_PULL = 3
