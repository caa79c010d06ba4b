"""What is told and what is taken: one row a topic, under the names and with the types of the ROS 2 driver.

Source of names, types, frames, rates and quality of service: ros2_controllers, ur_controllers, robot_state_publisher
and tf2_ros. A controller's own topics (``~/``) are below its name, /tf and /tf_static are the same in every namespace.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
from client.controllers.joint_trajectory import JointTrajectoryController
from client.recording.timestamps import header
from client.recording.topics import controller_message
from client.ros2.transforms import Frames, transform

TF: Final = "/tf"
TF_STATIC: Final = "/tf_static"
DESCRIPTION: Final = "robot_description"
_TF_EVERY_S: Final = 0.05  # robot_state_publisher
_SCALING_EVERY_S: Final = 0.01  # state_publish_rate of the ROS 2 driver
_TF_DEPTH: Final = 100  # tf2_ros
_TCP_FRAME: Final = "tool0_controller"

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Scene:
    """What messages need besides what controllers tell: the prefix of names, and the arm's frames if it is known."""

    prefix: str = ""
    frames: Frames | None = None


@dataclass(frozen=True, slots=True)
class Publication:
    """A topic that is told.

    controller: whose. source: the attribute that is its topic here. message: makes fields, or None where there is
    nothing to tell. latched: those who come late get the last one. every_s: not more often, by the robot's clock.
    again: it is told when it changes, and once a second.
    """

    controller: type[Controller[Any]]
    source: str
    name: str
    type: str
    message: Callable[[Any, int, Scene], Values | None]
    latched: bool = False
    depth: int = 1
    every_s: float = 0.0
    again: bool = False


@dataclass(frozen=True, slots=True)
class Moment:
    """Now, by the robot's clock [s] and by this machine's [ns since 1970]."""

    robot_s: float
    time_ns: int


@dataclass(frozen=True, slots=True)
class Subscription:
    """A topic that is taken.

    order: what the fields ask of the controller; give: hands it over; check: raises ControllerError for what the
    controller would not take.
    """

    controller: type[Controller[Any]]
    name: str
    type: str
    order: Callable[[Values, Moment], Any]
    give: Callable[[Any, Any], object]
    check: Callable[[Any, Any], object] | None = None


# told


def _joint_states(state: JointState, time_ns: int, scene: Scene) -> Values:
    return {
        "header": header(time_ns, "base_link"),
        "name": state.name,
        "position": state.position,
        "velocity": state.velocity,
        "effort": state.effort,
    }


def _frames(state: JointState, time_ns: int, scene: Scene) -> Values | None:
    return None if scene.frames is None else scene.frames.moving(state.name, state.position, time_ns)


def _speed_scaling(percent: float, time_ns: int, scene: Scene) -> Values:
    return {"data": percent}


def _wrench(wrench: WrenchStamped, time_ns: int, scene: Scene) -> Values:
    forces = {"force": _xyz(wrench.force), "torque": _xyz(wrench.torque)}
    return {"header": header(time_ns, wrench.frame_id), "wrench": forces}


def _pose(pose: PoseStamped, time_ns: int, scene: Scene) -> Values:
    place = {"position": _xyz(pose.position), "orientation": dict(zip("xyzw", pose.orientation, strict=True))}
    return {"header": header(time_ns, pose.frame_id), "pose": place}


def _tcp_frame(pose: PoseStamped, time_ns: int, scene: Scene) -> Values:
    child = scene.prefix + _TCP_FRAME
    return {"transforms": [transform(pose.frame_id, child, pose.position, pose.orientation, time_ns)]}


def _io_states(states: IOStates, time_ns: int, scene: Scene) -> Values:
    inputs, outputs = states.analog_types[:2], states.analog_types[2:]
    return {
        "digital_in_states": _digital(states.digital_in),
        "digital_out_states": _digital(states.digital_out),
        "analog_in_states": _analog(states.analog_in, inputs),
        "analog_out_states": _analog(states.analog_out, outputs),
    }


def _tool_data(data: ToolData, time_ns: int, scene: Scene) -> Values:
    return {
        "analog_input_range2": data.analog_types[0],
        "analog_input_range3": data.analog_types[1],
        "analog_input2": data.analog_in[0],
        "analog_input3": data.analog_in[1],
        "tool_output_voltage": _whole(data.output_voltage),
        "tool_current": data.output_current,
        "tool_temperature": data.temperature,
        "tool_mode": _whole(data.mode),
    }


def _mode(mode: int, time_ns: int, scene: Scene) -> Values | None:
    return None if mode < 0 else {"mode": mode}


def _running(running: bool, time_ns: int, scene: Scene) -> Values:
    return {"data": running}


def _controller_state(state: Any, time_ns: int, scene: Scene) -> Values:
    return controller_message(state, time_ns)


def _xyz(values: Sequence[float]) -> Values:
    return dict(zip("xyz", values, strict=True))


def _digital(levels: Sequence[bool]) -> list[Values]:
    return [{"pin": pin, "state": level} for pin, level in enumerate(levels)]


def _analog(values: Sequence[float], domains: Sequence[int]) -> list[Values]:
    signals = enumerate(zip(values, domains, strict=True))
    return [{"pin": pin, "domain": max(domain, 0), "state": value} for pin, (value, domain) in signals]


def _whole(value: float) -> int:
    """0 where the robot does not say."""
    return int(value) if value >= 0 else 0


# taken


def _commands(values: Values, now: Moment) -> Sequence[float]:
    commands: Sequence[float] = values["data"]
    return commands


def _trajectory(values: Values, now: Moment) -> JointTrajectory:
    """Its stamp is by this machine's clock, as all times in ROS; 0 is at once."""
    stamp_ns = _ns(values["header"]["stamp"])
    begin_s = now.robot_s + (stamp_ns - now.time_ns) * 1e-9 if stamp_ns else 0.0
    return JointTrajectory(tuple(values["joint_names"]), tuple(map(_point, values["points"])), begin_s)


def _point(values: Values) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(
        tuple(values["positions"]),
        tuple(values["velocities"]),
        tuple(values["accelerations"]),
        tuple(values["effort"]),
        _ns(values["time_from_start"]) * 1e-9,
    )


def _ns(time: Values) -> int:
    return int(time["sec"]) * 1_000_000_000 + int(time["nanosec"])


def _enable(values: Values, now: Moment) -> bool:
    return bool(values["data"])


PUBLICATIONS: Final = (
    Publication(JointStateBroadcaster, "topic", "joint_states", "sensor_msgs/msg/JointState", _joint_states),
    Publication(
        JointStateBroadcaster, "topic", TF, "tf2_msgs/msg/TFMessage", _frames, depth=_TF_DEPTH, every_s=_TF_EVERY_S
    ),
    Publication(PoseBroadcaster, "topic", TF, "tf2_msgs/msg/TFMessage", _tcp_frame, depth=_TF_DEPTH),
    Publication(PoseBroadcaster, "topic", "~/pose", "geometry_msgs/msg/PoseStamped", _pose),
    Publication(ForceTorqueSensorBroadcaster, "topic", "~/wrench", "geometry_msgs/msg/WrenchStamped", _wrench),
    Publication(
        SpeedScalingStateBroadcaster,
        "topic",
        "~/speed_scaling",
        "std_msgs/msg/Float64",
        _speed_scaling,
        every_s=_SCALING_EVERY_S,
    ),
    Publication(GPIOController, "io_states", "~/io_states", "ur_msgs/msg/IOStates", _io_states, again=True),
    Publication(GPIOController, "tool_data", "~/tool_data", "ur_msgs/msg/ToolDataMsg", _tool_data, again=True),
    Publication(GPIOController, "robot_mode", "~/robot_mode", "ur_dashboard_msgs/msg/RobotMode", _mode, latched=True),
    Publication(
        GPIOController, "safety_mode", "~/safety_mode", "ur_dashboard_msgs/msg/SafetyMode", _mode, latched=True
    ),
    Publication(
        GPIOController, "program_running", "~/robot_program_running", "std_msgs/msg/Bool", _running, latched=True
    ),
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
        _trajectory,
        JointTrajectoryController.command,
        JointTrajectoryController.check,
    ),
    Subscription(
        ForwardCommandController,
        "~/commands",
        "std_msgs/msg/Float64MultiArray",
        _commands,
        ForwardCommandController.command,
        ForwardCommandController.check,
    ),
    Subscription(
        FreedriveModeController,
        "~/enable_freedrive_mode",
        "std_msgs/msg/Bool",
        _enable,
        FreedriveModeController.enable_freedrive_mode,
    ),
)
