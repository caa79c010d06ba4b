"""Parameters of the joint trajectory controllers, under the names and with the defaults of ros2_controllers."""

from dataclasses import dataclass, field
from typing import Final

from client.controllers.parameters import BY_NAME, without_effect
from client.controllers.pid import Gains

__all__ = ["JointConstraints", "JointTrajectoryParameters", "ScaledJointTrajectoryParameters"]

_EVERY_CYCLE: Final = "states and results are told in the cycle they come about"


@dataclass(frozen=True, slots=True)
class JointConstraints:
    """Tolerances of one joint [rad], and how fast it may brake [rad/s2]; 0 is none."""

    trajectory: float = 0.0
    goal: float = 0.0
    max_deceleration_on_cancel: float = 0.0


@dataclass(frozen=True, slots=True)
class Constraints:
    """goal_time [s]: how late the arm may be, 0 for any time; stopped_velocity_tolerance [rad/s] at the end."""

    stopped_velocity_tolerance: float = 0.01
    goal_time: float = 0.0
    decelerate_on_cancel: bool = False
    joints: dict[str, JointConstraints] = field(default_factory=dict, metadata=BY_NAME)


@dataclass(frozen=True, slots=True)
class GainsByJoint:
    """For controllers that command speeds or torques."""

    joints: dict[str, Gains] = field(default_factory=dict, metadata=BY_NAME)


@dataclass(frozen=True, slots=True)
class SpeedScaling:
    """Where the factor comes from by which time passes slower; state_interface "" keeps it as it is."""

    initial_scaling_factor: float = 1.0
    state_interface: str = ""
    command_interface: str = without_effect("", "the speed slider is moved by io_and_status_controller")


@dataclass(frozen=True, slots=True)
class JointTrajectoryParameters:
    """As of ros2_controllers; what ROS 2 publishes at rates of its own comes every cycle here."""

    joints: tuple[str, ...]
    command_interfaces: tuple[str, ...]
    state_interfaces: tuple[str, ...]
    command_joints: tuple[str, ...] = ()
    allow_partial_joints_goal: bool = False
    allow_trajectory_replacement: bool = True
    interpolate_from_desired_state: bool = False
    allow_integration_in_goal_trajectories: bool = False
    allow_nonzero_velocity_at_trajectory_end: bool = False
    set_last_command_interface_value_as_state_on_activation: bool = True
    interpolation_method: str = "splines"
    cmd_timeout: float = 0.0
    constraints: Constraints = field(default_factory=Constraints)
    gains: GainsByJoint = field(default_factory=GainsByJoint)
    speed_scaling: SpeedScaling = field(default_factory=SpeedScaling)
    state_publish_rate: float = without_effect(50.0, _EVERY_CYCLE)
    action_monitor_rate: float = without_effect(20.0, _EVERY_CYCLE)


@dataclass(frozen=True, slots=True)
class ScaledJointTrajectoryParameters(JointTrajectoryParameters):
    """With the name of the state interface that holds the scaling factor."""

    speed_scaling_interface_name: str = "speed_scaling/speed_scaling_factor"
