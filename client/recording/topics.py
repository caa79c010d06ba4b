"""RTDE variables as ROS 2 messages, on the topics and in the units of the ROS 2 driver for UR."""

import struct
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from client.errors import RecordingError
from client.recording.cdr import Message, MessageType
from client.recording.definitions import message, message_type, ros_name, rtde_type, xyz, xyzw
from client.recording.timestamps import header
from urproto.joints import JOINT_NAMES
from urproto.modes import RuntimeState
from urproto.robots.pose import rotvec_to_quaternion, wrench_trans

RTDE_TOPIC: Final = "/rtde"
POINTS: Final = ("reference", "feedback", "error", "output")
POINT_FIELDS: Final = ("positions", "velocities", "accelerations", "effort")
"""The points in the state of a trajectory controller, and what each has."""

_CONTROLLER_STATE: Final = "control_msgs/msg/JointTrajectoryControllerState"
_REPEAT_NS: Final = 1_000_000_000  # guess: unchanged messages are repeated once a second, for late subscribers
_TCP_FRAME: Final = "tool0_controller"  # the ROS 2 driver's name for the TCP as the controller has it

Values = Mapping[str, Any]

_RUNNING: Final = (RuntimeState.PLAYING, RuntimeState.RESUMING)
_IO: Final = "/io_and_status_controller"


@dataclass(frozen=True, slots=True)
class RosTopic:
    """A topic, the variables it needs, and the function that computes the fields of its messages.

    slowly: published only when the message changes, and once a second.
    """

    name: str
    type: MessageType
    needs: frozenset[str]
    content: Callable[[Values], Values]
    slowly: bool = False

    @property
    def stamped(self) -> bool:
        """Whether its messages have a header."""
        return self.type.definition.startswith("std_msgs/Header header")


def markers_message(topic: str, markers: Sequence[Values]) -> Message:
    """A visualization_msgs/msg/MarkerArray. markers: their fields; those left out are zero or empty.

    Raises RecordingError for other fields or values.
    """
    try:
        return message(topic, "visualization_msgs/msg/MarkerArray", {"markers": markers})
    except (struct.error, ArithmeticError, AttributeError, TypeError, ValueError) as error:
        raise RecordingError(f"these are not fields of visualization_msgs/Marker: {error}") from error


class Topics:
    """The topics that a set of RTDE variables allows, and the messages for each state."""

    def __init__(self, names: Collection[str]) -> None:
        everything = RosTopic(RTDE_TOPIC, rtde_type(names), frozenset(names), _with_ros_names)
        self.topics = (everything, *(topic for topic in _TOPICS if topic.needs <= set(names)))
        self._published: dict[str, tuple[int, Values]] = {}

    def encoded(self, values: Values, time_ns: int) -> Iterable[Message]:
        """The messages of one state. A message that cannot represent it, such as a mode of 1000, is left out."""
        for topic in self.topics:
            try:
                yield from self._encoded(topic, values, time_ns)
            except (struct.error, ArithmeticError, ValueError):
                if topic.name == RTDE_TOPIC:
                    raise

    def _encoded(self, topic: RosTopic, values: Values, time_ns: int) -> Iterable[Message]:
        content = topic.content(values)
        if topic.slowly and not self._is_due(topic.name, content, time_ns):
            return
        if topic.stamped:
            content = {**content, "header": header(time_ns, content.get("frame_id", ""))}
        yield Message(topic.name, topic.type, topic.type.encode(content))

    def _is_due(self, name: str, content: Values, time_ns: int) -> bool:
        published_ns, published = self._published.get(name, (0, {}))
        if published == content and 0 <= time_ns - published_ns < _REPEAT_NS:
            return False
        self._published[name] = (time_ns, content)
        return True


def controller_message(controller: str, state: Any, time_ns: int) -> Message:
    """The message of a controller's state: joint_names, points reference, feedback, error, output, maybe a scaling.

    A point has positions, velocities, accelerations and effort.
    """
    values = {
        "header": header(time_ns, ""),
        "joint_names": state.joint_names,
        **{name: _point(getattr(state, name)) for name in POINTS},
        "speed_scaling_factor": getattr(state, "speed_scaling_factor", 1.0),
    }
    return message(f"/{controller}/controller_state", _CONTROLLER_STATE, values)


def _point(point: Any) -> Values:
    return {name: getattr(point, name) for name in POINT_FIELDS}


def _with_ros_names(values: Values) -> Values:
    return {ros_name(name): value for name, value in values.items()}


def _joint_states(values: Values) -> Values:
    velocity, effort = values.get("actual_qd", ()), values.get("actual_current", ())
    return {"name": JOINT_NAMES, "position": values["actual_q"], "velocity": velocity, "effort": effort}


def _controller_state(values: Values) -> Values:
    """Targets of the robot's own controller, and the actual joint states."""
    target_q, actual_q = values["target_q"], values["actual_q"]
    target_qd, actual_qd = values.get("target_qd", ()), values.get("actual_qd", ())
    reference = {"positions": target_q, "velocities": target_qd, "accelerations": values.get("target_qdd", ())}
    return {
        "joint_names": JOINT_NAMES,
        "reference": reference,
        "feedback": {"positions": actual_q, "velocities": actual_qd},
        "error": {"positions": _difference(target_q, actual_q), "velocities": _difference(target_qd, actual_qd)},
        "output": reference,
        "speed_scaling_factor": values.get("speed_scaling", 1.0) * values.get("target_speed_fraction", 1.0),
    }


def _difference(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(x - y for x, y in zip(a, b, strict=False))


def _wrench(values: Values) -> Values:
    turn = (0.0, 0.0, 0.0, *values["actual_TCP_pose"][3:])
    wrench = wrench_trans(turn, values["actual_TCP_force"])
    return {"frame_id": _TCP_FRAME, "wrench": {"force": xyz(wrench[:3]), "torque": xyz(wrench[3:])}}


def _pose(values: Values) -> Values:
    pose = values["actual_TCP_pose"]
    return {
        "frame_id": "base",
        "pose": {"position": xyz(pose[:3]), "orientation": xyzw(rotvec_to_quaternion(*pose[3:]))},
    }


def _speed_scaling(values: Values) -> Values:
    return {"data": 100.0 * values["speed_scaling"] * values["target_speed_fraction"]}


def _io_states(values: Values) -> Values:
    return {
        "digital_in_states": _digital(values["actual_digital_input_bits"]),
        "digital_out_states": _digital(values["actual_digital_output_bits"]),
        "analog_in_states": _analog(values, "standard_analog_input", 0) + _tool_analog(values),
        "analog_out_states": _analog(values, "standard_analog_output", 2),
    }


def _digital(bits: int) -> list[Values]:
    return [{"pin": pin, "state": bool(bits >> pin & 1)} for pin in range(18)]


def _analog(values: Values, name: str, first_bit: int) -> list[Values]:
    domains = values.get("analog_io_types", 0) >> first_bit
    return [
        {"pin": pin, "domain": domains >> pin & 1, "state": values[f"{name}{pin}"]}
        for pin in range(2)
        if f"{name}{pin}" in values
    ]


def _tool_analog(values: Values) -> list[Values]:
    """The tool's analog inputs, numbered after the two standard ones."""
    domains = values.get("tool_analog_input_types", 0)
    names = ("tool_analog_input0", "tool_analog_input1")
    return [
        {"pin": 2 + pin, "domain": domains >> pin & 1, "state": values[name]}
        for pin, name in enumerate(names)
        if name in values
    ]


def _topic(name: str, kind: str, needs: str, content: Callable[[Values], Values], slowly: bool = False) -> RosTopic:
    return RosTopic(name, message_type(kind), frozenset(needs.split()), content, slowly)


_TOPICS: Final = (
    _topic("/joint_states", "sensor_msgs/msg/JointState", "actual_q", _joint_states),
    _topic("/robot/controller_state", _CONTROLLER_STATE, "target_q actual_q", _controller_state),
    _topic(
        "/force_torque_sensor_broadcaster/wrench",
        "geometry_msgs/msg/WrenchStamped",
        "actual_TCP_force actual_TCP_pose",
        _wrench,
    ),
    _topic("/tcp_pose_broadcaster/pose", "geometry_msgs/msg/PoseStamped", "actual_TCP_pose", _pose),
    _topic(
        "/speed_scaling_state_broadcaster/speed_scaling",
        "std_msgs/msg/Float64",
        "speed_scaling target_speed_fraction",
        _speed_scaling,
    ),
    _topic(
        f"{_IO}/robot_mode",
        "ur_dashboard_msgs/msg/RobotMode",
        "robot_mode",
        lambda values: {"mode": values["robot_mode"]},
        slowly=True,
    ),
    _topic(
        f"{_IO}/safety_mode",
        "ur_dashboard_msgs/msg/SafetyMode",
        "safety_mode",
        lambda values: {"mode": values["safety_mode"]},
        slowly=True,
    ),
    _topic(
        f"{_IO}/robot_program_running",
        "std_msgs/msg/Bool",
        "runtime_state",
        lambda values: {"data": values["runtime_state"] in _RUNNING},
        slowly=True,
    ),
    _topic(
        f"{_IO}/io_states",
        "ur_msgs/msg/IOStates",
        "actual_digital_input_bits actual_digital_output_bits",
        _io_states,
        slowly=True,
    ),
)
