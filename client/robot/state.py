"""`RobotState`: the robot's state in one control period, as a program reads it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

from client.rtde import ReceivedState
from urproto.errors import LocalProtocolError
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_of
from urproto.robots import Joints
from urproto.robots.pose import Pose
from urproto.signals import digital_signal

OUTPUTS: Final = (
    "actual_q", "actual_qd", "target_qd", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force",
    "actual_digital_input_bits", "actual_digital_output_bits"
)  # fmt: skip
MORE_OUTPUTS: Final = (
    "target_q", "target_qdd", "target_current", "target_moment", "actual_current", "joint_control_output",
    "target_TCP_pose", "target_TCP_speed", "joint_temperatures", "actual_execution_time", "joint_mode",
    "actual_tool_accelerometer", "speed_scaling", "actual_momentum", "actual_main_voltage", "actual_robot_voltage",
    "actual_robot_current", "actual_joint_voltage", "standard_analog_input0", "standard_analog_input1",
    "standard_analog_output0", "standard_analog_output1", "robot_status_bits", "safety_status_bits",
    "ft_raw_wrench", "payload", "payload_cog", "payload_inertia"
)  # fmt: skip
"""Further variables that ur_rtde receives by default; those that a version lacks are missing in `RobotState.values`."""
_AT_REST_RAD_S: Final = 1e-4  # guess: far below any motion, above rounding


@dataclass(frozen=True, slots=True)
class RobotState:
    """State of the robot in one control period.

    values: all received RTDE variables, by name: `OUTPUTS`, and those that a driver needs. The properties are computed
    from them on access.
    """

    values: Mapping[str, Any]

    @property
    def age_s(self) -> float:
        """The robot took the state at most this long ago [s]; infinite for values that were not received from it."""
        return self.values.age_s if isinstance(self.values, ReceivedState) else math.inf

    @property
    def timestamp_s(self) -> float:
        """Time since the controller started [s]."""
        return cast(float, self.values["timestamp"])

    @property
    def q_rad(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3, as measured."""
        return cast(Joints, self.values["actual_q"])

    @property
    def qd_rad_s(self) -> Joints:
        """Joint speeds (6,) [rad/s], as measured."""
        return cast(Joints, self.values["actual_qd"])

    @property
    def pose_base_tcp(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]."""
        return cast(Pose, self.values["actual_TCP_pose"])

    @property
    def velocity_base(self) -> Joints:
        """Velocity of the TCP in the base frame (6,) [m/s, rad/s]."""
        return cast(Joints, self.values["actual_TCP_speed"])

    @property
    def wrench_base(self) -> Joints:
        """Wrench (6,) [N, Nm] in the axes of the base frame: about the flange on e-Series, at the TCP on CB3.

        An external sensor (`Force.use_external_sensor`) is reported at the TCP on e-Series too.
        """
        return cast(Joints, self.values["actual_TCP_force"])

    @property
    def robot_mode(self) -> RobotMode:
        """Robot mode; ``UNKNOWN(n)`` for an unknown number."""
        return mode_of(RobotMode, self.values["robot_mode"])

    @property
    def safety_mode(self) -> SafetyMode:
        """Safety mode; ``UNKNOWN(n)`` for an unknown number."""
        return mode_of(SafetyMode, self.values["safety_mode"])

    @property
    def runtime_state(self) -> RuntimeState:
        """Runtime state of the program; ``UNKNOWN(n)`` for an unknown number."""
        return mode_of(RuntimeState, self.values["runtime_state"])

    @property
    def speed_fraction(self) -> float:
        """The speed slider, 0 to 1."""
        return cast(float, self.values["target_speed_fraction"])

    @property
    def at_rest(self) -> bool:
        """True if the target speeds of all joints are zero."""
        return bool(max(map(abs, self.values["target_qd"])) < _AT_REST_RAD_S)

    def digital_in(self, number: int) -> bool:
        """Level of a digital input, numbered as in `urproto.signals.SIGNALS`."""
        return bool(self.values["actual_digital_input_bits"] >> check_signal(number) & 1)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered as in `urproto.signals.SIGNALS`."""
        return bool(self.values["actual_digital_output_bits"] >> check_signal(number) & 1)


def check_signal(number: int) -> int:
    """Return the number of a digital signal. Raises LocalProtocolError if it does not exist."""
    try:
        digital_signal(number)
    except IndexError as error:
        raise LocalProtocolError(str(error)) from None
    return number
