"""Topics of controllers, one row each, with the names and types of the ROS 2 driver.

Source of names, types, frames, rates and quality of service: ros2_controllers, ur_controllers and tf2_ros. A
controller's private topics (``~/``) are below its name; /tf is the same in every namespace.
"""

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from client.controllers.broadcasters import (
    ForceTorqueSensorBroadcaster,
    JointState,
    JointStateBroadcaster,
    PoseBroadcaster,
    PoseStamped,
    SpeedScalingStateBroadcaster,
    WrenchStamped,
)
from client.controllers.compliance import FreedriveModeController
from client.controllers.controller import Controller
from client.controllers.forward import ForwardCommandController
from client.controllers.goals import JointTrajectory, JointTrajectoryPoint
from client.controllers.io_and_status import GPIOController, IOStates, ToolData
from client.controllers.joint_trajectory import ControllerState, JointTrajectoryController
from client.ros2.control_side import SIDE, ControlSide
from client.ros2.frames import Frames, set_transform
from client.ros2.host import NodeHost, interface
from urproto.joints import JOINT_NAMES
from urproto.robots.pose import Pose, quaternion_to_rotvec
from urproto.vectors import ZERO6

_TF_EVERY_S: Final = 0.05  # robot_state_publisher's publish_frequency is 20 Hz
_SCALING_EVERY_S: Final = 0.01  # state_publish_rate of the ROS 2 driver
_MAX_MODE: Final = 127  # of an int8
TF_DEPTH: Final = 100  # tf2_ros
_TCP_FRAME: Final = "tool0_controller"
_POSE: Final = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))


@dataclass
class PublishingContext:
    """Data that messages need in addition to what controllers publish.

    prefix: for the names of joints and frames. states: names of all state interfaces. frames: the arm's, if its model
    is known. joints: positions and velocities of joints that do not belong to the arm; set as whole tuples by any
    thread. sec, nanosec: current wall time.
    """

    prefix: str = ""
    states: tuple[str, ...] = ()
    frames: Frames | None = None
    joints: dict[str, tuple[float, float]] = field(default_factory=dict)
    sec: int = 0
    nanosec: int = 0

    def stamp(self, header: Any, frame_id: str) -> None:
        """Set a std_msgs/Header."""
        header.stamp.sec, header.stamp.nanosec = self.sec, self.nanosec
        header.frame_id = frame_id

    def pose_of(self, frame: str, values: Sequence[float]) -> Pose | None:
        """Pose of a frame in the arm's base frame [m, rotation vector]; "" is the base frame.

        values: of all state interfaces. None for a frame that does not belong to the arm.
        """
        state = {name.removeprefix(self.prefix): value for name, value in zip(self.states, values, strict=True)}
        name, base = frame.lstrip("/") or f"{self.prefix}base", f"{self.prefix}base"
        if name == f"{self.prefix}{_TCP_FRAME}":
            x, y, z, *turn = (state[f"tcp_pose/{part}"] for part in _POSE)
            return (x, y, z, *quaternion_to_rotvec(*turn))
        if name == base:
            return ZERO6
        angles = {self.prefix + joint: state[f"{joint}/position"] for joint in JOINT_NAMES}
        return self.frames.pose_in(base, name, angles) if self.frames else None

    @property
    def frame_names(self) -> frozenset[str]:
        """Names of the frames that `pose_of` knows."""
        own = {f"{self.prefix}base", f"{self.prefix}{_TCP_FRAME}"}
        return frozenset(own | (self.frames.names if self.frames else set()))

    @cached_property
    def components(self) -> dict[str, tuple[list[str], list[int]]]:
        """For each joint, sensor and so on: the names of its state interfaces, and their places in `states`."""
        found: dict[str, tuple[list[str], list[int]]] = {}
        for place, name in enumerate(self.states):
            component, _, interface_name = name.rpartition("/")
            names, places = found.setdefault(component, ([], []))
            names.append(interface_name)
            places.append(place)
        return found


@dataclass(frozen=True)
class Publication:
    """A topic that a controller publishes.

    controller: type of the controller. source: attribute with the controller's topic. fill: sets a message's fields;
    returns False if there is nothing to publish. latched: late subscribers get the last message. every_s: shortest
    interval by the robot's clock. all_states: ``fill`` gets the values of all state interfaces instead of a message.
    """

    controller: type[Controller[Any]]
    source: str
    name: str
    type: str
    fill: Callable[[Any, Any, PublishingContext], bool]
    latched: bool = False
    depth: int = 1
    every_s: float = 0.0
    all_states: bool = False


@dataclass(frozen=True)
class CommandContext:
    """Converts times of messages; from the threads of nodes."""

    host: NodeHost

    def robot_time_s(self, stamp: Any) -> float:
        """Convert a builtin_interfaces/Time of this machine's clock to robot time."""
        robot_s, time_ns = self.host.do(ControlSide.robot_time, SIDE)
        return float(robot_s + (stamp.sec * 1_000_000_000 + stamp.nanosec - time_ns) * 1e-9)


@dataclass(frozen=True)
class Subscription:
    """A topic to which a controller subscribes.

    command: converts a message to a command for the controller. hand_over: passes it to the controller. Both raise
    ControllerError. latched: also take a message that was published before the controller was loaded.
    """

    controller: type[Controller[Any]]
    name: str
    type: str
    command: Callable[[Any, CommandContext], Any]
    hand_over: Callable[[Any, Any], object]
    latched: bool = False


# publications


def _joint_states(message: Any, state: JointState, scene: PublishingContext) -> bool:
    scene.stamp(message.header, "base_link")
    others = list(scene.joints.items())
    message.name = [*state.name, *(name for name, _ in others)]
    message.position = array("d", (*state.position, *(position for _, (position, _) in others)))
    message.velocity = array("d", (*state.velocity, *(velocity for _, (_, velocity) in others)))
    message.effort = array("d", (*state.effort, *(math.nan for _ in others)))  # not measured
    return True


def _dynamic_joint_states(message: Any, values: Sequence[float], scene: PublishingContext) -> bool:
    scene.stamp(message.header, "")
    make = interface("control_msgs/msg/InterfaceValue")
    message.joint_names = list(scene.components)
    message.interface_values = [
        make(interface_names=names, values=array("d", [values[place] for place in places]))
        for names, places in scene.components.values()
    ]
    return True


def _frames(message: Any, state: JointState, scene: PublishingContext) -> bool:
    if scene.frames is None:
        return False
    message.transforms = scene.frames.moving(state.name, state.position, scene.sec, scene.nanosec)
    return True


def _data(message: Any, value: float | bool, scene: PublishingContext) -> bool:
    message.data = value
    return True


def _wrench(message: Any, wrench: WrenchStamped, scene: PublishingContext) -> bool:
    scene.stamp(message.header, wrench.frame_id)
    _set_xyz(message.wrench.force, wrench.force)
    _set_xyz(message.wrench.torque, wrench.torque)
    return True


def _pose(message: Any, pose: PoseStamped, scene: PublishingContext) -> bool:
    scene.stamp(message.header, pose.frame_id)
    _set_xyz(message.pose.position, pose.position)
    turn = message.pose.orientation
    turn.x, turn.y, turn.z, turn.w = pose.orientation
    return True


def _tcp_frame(message: Any, pose: PoseStamped, scene: PublishingContext) -> bool:
    if not message.transforms:
        message.transforms = [interface("geometry_msgs/msg/TransformStamped")()]
    transform = message.transforms[0]
    scene.stamp(transform.header, pose.frame_id)
    set_transform(transform, pose.child_frame_id, pose.position, pose.orientation)
    return True


def _io_states(message: Any, states: IOStates, scene: PublishingContext) -> bool:
    digital, analog = interface("ur_msgs/msg/Digital"), interface("ur_msgs/msg/Analog")
    message.digital_in_states = [digital(pin=pin, state=on) for pin, on in enumerate(states.digital_in)]
    message.digital_out_states = [digital(pin=pin, state=on) for pin, on in enumerate(states.digital_out)]
    inputs, outputs = states.analog_types[:2], states.analog_types[2:]
    for name, values, domains in (
        ("analog_in_states", states.analog_in, inputs),
        ("analog_out_states", states.analog_out, outputs),
    ):
        signals = enumerate(zip(values, domains, strict=True))
        made = [
            analog(pin=pin, domain=max(domain, 0), state=_finite_or_zero(value)) for pin, (value, domain) in signals
        ]
        setattr(message, name, made)
    return True


def _tool_data(message: Any, data: ToolData, scene: PublishingContext) -> bool:
    message.analog_input_range2, message.analog_input_range3 = (max(kind, 0) for kind in data.analog_types)
    message.analog_input2, message.analog_input3 = map(_finite_or_zero, data.analog_in)
    message.tool_output_voltage = _unsigned(data.output_voltage)
    message.tool_current = _finite_or_zero(data.output_current)
    message.tool_temperature = _finite_or_zero(data.temperature)
    message.tool_mode = _unsigned(data.mode)
    return True


def _mode(message: Any, mode: int, scene: PublishingContext) -> bool:
    if not 0 <= mode <= _MAX_MODE:  # no controller has such a mode, and the message cannot hold it
        return False
    message.mode = mode
    return True


def _controller_state(message: Any, state: ControllerState, scene: PublishingContext) -> bool:
    """Set the message; in Humble, the reference is called desired, the feedback actual, and there is no output."""
    scene.stamp(message.header, "")
    message.joint_names = state.joint_names
    points = {
        "reference": state.reference,
        "feedback": state.feedback,
        "error": state.error,
        "output": state.output,
        "desired": state.reference,
        "actual": state.feedback,
    }
    for name, point in points.items():
        if hasattr(message, name):
            set_point(getattr(message, name), point)
    if hasattr(message, "speed_scaling_factor"):
        message.speed_scaling_factor = state.speed_scaling_factor
    return True


def set_point(message: Any, point: JointTrajectoryPoint) -> None:
    """Set a trajectory_msgs/JointTrajectoryPoint."""
    message.positions = array("d", point.positions)
    message.velocities = array("d", point.velocities)
    message.accelerations = array("d", point.accelerations)
    message.effort = array("d", point.effort)
    nanoseconds = round(point.time_from_start_s * 1e9)
    message.time_from_start.sec, message.time_from_start.nanosec = divmod(nanoseconds, 1_000_000_000)


def _set_xyz(message: Any, values: Sequence[float]) -> None:
    message.x, message.y, message.z = values


def _finite_or_zero(value: float) -> float:
    """The value, or 0 if the robot does not report it, as in ros2_control."""
    return value if math.isfinite(value) else 0.0


def _unsigned(value: float) -> int:
    """For a uint8; 0 for a value that no controller reports."""
    return int(value) if 0 <= value <= 255 else 0


# subscriptions


def trajectory(message: Any, now: CommandContext) -> JointTrajectory:
    """Convert a trajectory. Its stamp is in this machine's time, like all times in ROS; 0 means immediately."""
    stamp = message.header.stamp
    begin_s = now.robot_time_s(stamp) if stamp.sec or stamp.nanosec else 0.0
    return JointTrajectory(tuple(message.joint_names), tuple(map(_point, message.points)), begin_s)


def _point(message: Any) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(
        tuple(message.positions),
        tuple(message.velocities),
        tuple(message.accelerations),
        tuple(message.effort),
        seconds(message.time_from_start),
    )


def seconds(duration: Any) -> float:
    """The length of a builtin_interfaces/Duration [s]."""
    return float(duration.sec + duration.nanosec * 1e-9)


MOVING_FRAMES: Final = Publication(
    JointStateBroadcaster, "topic", "/tf", "tf2_msgs/msg/TFMessage", _frames, depth=TF_DEPTH, every_s=_TF_EVERY_S
)
"""The transforms that robot_state_publisher derives from joint states."""
PUBLICATIONS: Final = (
    Publication(JointStateBroadcaster, "topic", "joint_states", "sensor_msgs/msg/JointState", _joint_states),
    Publication(
        JointStateBroadcaster,
        "topic",
        "dynamic_joint_states",
        "control_msgs/msg/DynamicJointState",
        _dynamic_joint_states,
        all_states=True,
    ),
    Publication(PoseBroadcaster, "topic", "/tf", "tf2_msgs/msg/TFMessage", _tcp_frame, depth=TF_DEPTH),
    Publication(PoseBroadcaster, "topic", "~/pose", "geometry_msgs/msg/PoseStamped", _pose),
    Publication(ForceTorqueSensorBroadcaster, "topic", "~/wrench", "geometry_msgs/msg/WrenchStamped", _wrench),
    Publication(
        SpeedScalingStateBroadcaster,
        "topic",
        "~/speed_scaling",
        "std_msgs/msg/Float64",
        _data,
        every_s=_SCALING_EVERY_S,
    ),
    Publication(GPIOController, "io_states", "~/io_states", "ur_msgs/msg/IOStates", _io_states),
    Publication(GPIOController, "tool_data", "~/tool_data", "ur_msgs/msg/ToolDataMsg", _tool_data),
    Publication(GPIOController, "robot_mode", "~/robot_mode", "ur_dashboard_msgs/msg/RobotMode", _mode, latched=True),
    Publication(
        GPIOController, "safety_mode", "~/safety_mode", "ur_dashboard_msgs/msg/SafetyMode", _mode, latched=True
    ),
    Publication(GPIOController, "program_running", "~/robot_program_running", "std_msgs/msg/Bool", _data, latched=True),
    Publication(
        JointTrajectoryController,
        "state_topic",
        "~/controller_state",
        "control_msgs/msg/JointTrajectoryControllerState",
        _controller_state,
    ),
)
SUBSCRIPTIONS: Final = (
    Subscription(
        JointTrajectoryController,
        "~/joint_trajectory",
        "trajectory_msgs/msg/JointTrajectory",
        trajectory,
        JointTrajectoryController.command,
    ),
    Subscription(
        JointTrajectoryController,
        "~/speed_scaling_input",
        "control_msgs/msg/SpeedScalingFactor",
        lambda message, now: float(message.factor),
        JointTrajectoryController.set_scaling,
        latched=True,
    ),
    Subscription(
        ForwardCommandController,
        "~/commands",
        "std_msgs/msg/Float64MultiArray",
        lambda message, now: tuple(message.data),
        ForwardCommandController.command,
    ),
    Subscription(
        FreedriveModeController,
        "~/enable_freedrive_mode",
        "std_msgs/msg/Bool",
        lambda message, now: bool(message.data),
        FreedriveModeController.enable_freedrive_mode,
    ),
)
