"""What a robot's state is to somebody who writes a program for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self, cast

from urproto.errors import LocalProtocolError
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots import Joints
from urproto.robots.pose import Pose

__all__ = ["MORE_OUTPUTS", "OUTPUTS", "SIGNALS", "RobotState", "check_signal"]

OUTPUTS: Final = (
    "actual_q",
    "actual_qd",
    "target_qd",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
)
MORE_OUTPUTS: Final = (
    "target_q",
    "target_qdd",
    "target_current",
    "target_moment",
    "actual_current",
    "joint_control_output",
    "target_TCP_pose",
    "target_TCP_speed",
    "joint_temperatures",
    "actual_execution_time",
    "joint_mode",
    "actual_tool_accelerometer",
    "speed_scaling",
    "actual_momentum",
    "actual_main_voltage",
    "actual_robot_voltage",
    "actual_robot_current",
    "actual_joint_voltage",
    "standard_analog_input0",
    "standard_analog_input1",
    "standard_analog_output0",
    "standard_analog_output1",
    "robot_status_bits",
    "safety_status_bits",
    "ft_raw_wrench",
    "payload",
    "payload_cog",
    "payload_inertia",
)
"""What ur_rtde receives by default too; where a version lacks one, it is missing from `RobotState.values`."""
_AT_REST_RAD_S: Final = 1e-4  # guess: far below any motion, above rounding

SIGNALS: Final = 18
"""Digital signals of one direction: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """One control period.

    q_rad, qd_rad_s: joints (6,), base to wrist 3, as measured. pose_base_tcp: TCP in the base
    frame (6,) [m, rotation vector]. velocity_base: of the TCP (6,) [m/s, rad/s].
    wrench_base: at the TCP (6,) [N, Nm]. speed_fraction: the speed slider, 0 to 1.
    timestamp_s: since the controller came up. values: every RTDE variable there is, by name.
    """

    timestamp_s: float
    q_rad: Joints
    qd_rad_s: Joints
    pose_base_tcp: Pose
    velocity_base: Joints
    wrench_base: Joints
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_fraction: float
    at_rest: bool
    values: Mapping[str, Any]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """From the RTDE variables `OUTPUTS` and those a driver needs."""
        return cls(
            timestamp_s=values["timestamp"],
            q_rad=cast(Joints, values["actual_q"]),
            qd_rad_s=values["actual_qd"],
            pose_base_tcp=values["actual_TCP_pose"],
            velocity_base=values["actual_TCP_speed"],
            wrench_base=values["actual_TCP_force"],
            robot_mode=_named(RobotMode, values["robot_mode"]),
            safety_mode=_named(SafetyMode, values["safety_mode"]),
            runtime_state=_named(RuntimeState, values["runtime_state"]),
            speed_fraction=values["target_speed_fraction"],
            at_rest=max(map(abs, values["target_qd"])) < _AT_REST_RAD_S,
            values=values,
        )

    def digital_in(self, number: int) -> bool:
        """Level of a digital input, numbered as `SIGNALS` says."""
        return bool(self.values["actual_digital_input_bits"] >> check_signal(number) & 1)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered as `SIGNALS` says."""
        return bool(self.values["actual_digital_output_bits"] >> check_signal(number) & 1)


def check_signal(number: int) -> int:
    """The number of a digital signal. Raises LocalProtocolError when there is none."""
    if not 0 <= number < SIGNALS:
        raise LocalProtocolError(f"there is no digital signal {number}: 0-7 standard, 8-15 configurable, 16-17 tool")
    return number


def _named(kind: Any, number: int) -> int:
    """A member of the enum where it has one: newer robots may have more."""
    try:
        return cast(int, kind(number))
    except ValueError:
        return number
