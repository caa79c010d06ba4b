"""Definitions of the ROS 2 messages in recordings.

They are the fields of common_interfaces, tf2_msgs, control_msgs (Jazzy), ur_msgs and ur_dashboard_msgs. Recordings
include them, so none of these packages needs to be installed.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Final

from client.recording.cdr import Message, MessageType
from urproto.rtde.fields import OUTPUT_FIELDS

RTDE_TYPE: Final = "ur_client_msgs/msg/RTDEState"
"""Type of the topic with every recorded variable; its fields are those variables."""

_SEPARATOR: Final = "=" * 80
_STAMPED: Final = "std_msgs/Header header"
_POINT: Final = "trajectory_msgs/JointTrajectoryPoint"
_MULTI_POINT: Final = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_ROS_TYPES: Final = {
    "BOOL": "bool",
    "UINT8": "uint8",
    "UINT32": "uint32",
    "UINT64": "uint64",
    "INT32": "int32",
    "DOUBLE": "float64",
    "VECTOR3D": "float64[3]",
    "VECTOR6D": "float64[6]",
    "VECTOR6INT32": "int32[6]",
    "VECTOR6UINT32": "uint32[6]",
}
_FIELDS: Final = {
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "builtin_interfaces/Duration": ("int32 sec", "uint32 nanosec"),
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "std_msgs/Bool": ("bool data",),
    "std_msgs/Float64": ("float64 data",),
    "std_msgs/String": ("string data",),
    "std_msgs/MultiArrayDimension": ("string label", "uint32 size", "uint32 stride"),
    "std_msgs/MultiArrayLayout": ("std_msgs/MultiArrayDimension[] dim", "uint32 data_offset"),
    "std_msgs/Float64MultiArray": ("std_msgs/MultiArrayLayout layout", "float64[] data"),
    "geometry_msgs/Point": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "geometry_msgs/Pose": ("geometry_msgs/Point position", "geometry_msgs/Quaternion orientation"),
    "geometry_msgs/PoseStamped": (_STAMPED, "geometry_msgs/Pose pose"),
    "geometry_msgs/Transform": ("geometry_msgs/Vector3 translation", "geometry_msgs/Quaternion rotation"),
    "geometry_msgs/TransformStamped": (
        _STAMPED,
        "string child_frame_id",
        "geometry_msgs/Transform transform",
    ),
    "geometry_msgs/Twist": ("geometry_msgs/Vector3 linear", "geometry_msgs/Vector3 angular"),
    "geometry_msgs/Wrench": ("geometry_msgs/Vector3 force", "geometry_msgs/Vector3 torque"),
    "geometry_msgs/WrenchStamped": (_STAMPED, "geometry_msgs/Wrench wrench"),
    "tf2_msgs/TFMessage": ("geometry_msgs/TransformStamped[] transforms",),
    "sensor_msgs/JointState": (
        _STAMPED,
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
    ),
    _POINT: (
        "float64[] positions",
        "float64[] velocities",
        "float64[] accelerations",
        "float64[] effort",
        "builtin_interfaces/Duration time_from_start",
    ),
    "trajectory_msgs/JointTrajectory": (_STAMPED, "string[] joint_names", f"{_POINT}[] points"),
    _MULTI_POINT: (
        "geometry_msgs/Transform[] transforms",
        "geometry_msgs/Twist[] velocities",
        "geometry_msgs/Twist[] accelerations",
        "builtin_interfaces/Duration time_from_start",
    ),
    "control_msgs/JointTrajectoryControllerState": (
        _STAMPED,
        "string[] joint_names",
        *(f"{_POINT} {name}" for name in ("reference", "feedback", "error", "output")),
        "string[] multi_dof_joint_names",
        *(f"{_MULTI_POINT} multi_dof_{name}" for name in ("reference", "feedback", "error", "output")),
        "float64 speed_scaling_factor",
    ),
    "std_msgs/ColorRGBA": ("float32 r", "float32 g", "float32 b", "float32 a"),
    "sensor_msgs/Image": (
        _STAMPED,
        "uint32 height",
        "uint32 width",
        "string encoding",
        "uint8 is_bigendian",
        "uint32 step",
        "uint8[] data",
    ),
    "sensor_msgs/RegionOfInterest": (
        "uint32 x_offset",
        "uint32 y_offset",
        "uint32 height",
        "uint32 width",
        "bool do_rectify",
    ),
    "sensor_msgs/CameraInfo": (
        _STAMPED,
        "uint32 height",
        "uint32 width",
        "string distortion_model",
        "float64[] d",
        "float64[9] k",
        "float64[9] r",
        "float64[12] p",
        "uint32 binning_x",
        "uint32 binning_y",
        "sensor_msgs/RegionOfInterest roi",
    ),
    "sensor_msgs/CompressedImage": (_STAMPED, "string format", "uint8[] data"),
    "visualization_msgs/UVCoordinate": ("float32 u", "float32 v"),
    "visualization_msgs/MeshFile": ("string filename", "uint8[] data"),
    "visualization_msgs/Marker": (
        _STAMPED,
        "string ns",
        *(f"int32 {name}" for name in ("id", "type", "action")),
        "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 scale",
        "std_msgs/ColorRGBA color",
        "builtin_interfaces/Duration lifetime",
        "bool frame_locked",
        "geometry_msgs/Point[] points",
        "std_msgs/ColorRGBA[] colors",
        "string texture_resource",
        "sensor_msgs/CompressedImage texture",
        "visualization_msgs/UVCoordinate[] uv_coordinates",
        "string text",
        "string mesh_resource",
        "visualization_msgs/MeshFile mesh_file",
        "bool mesh_use_embedded_materials",
    ),
    "visualization_msgs/MarkerArray": ("visualization_msgs/Marker[] markers",),
    "ur_msgs/Digital": ("uint8 pin", "bool state"),
    "ur_msgs/Analog": ("uint8 CURRENT=0", "uint8 VOLTAGE=1", "uint8 pin", "uint8 domain", "float32 state"),
    "ur_msgs/IOStates": (
        "ur_msgs/Digital[] digital_in_states",
        "ur_msgs/Digital[] digital_out_states",
        "ur_msgs/Digital[] flag_states",
        "ur_msgs/Analog[] analog_in_states",
        "ur_msgs/Analog[] analog_out_states",
    ),
    "ur_msgs/ToolDataMsg": (
        "int8 ANALOG_INPUT_RANGE_CURRENT=0",
        "int8 ANALOG_INPUT_RANGE_VOLTAGE=1",
        "int8 analog_input_range2",
        "int8 analog_input_range3",
        "float64 analog_input2",
        "float64 analog_input3",
        "float32 tool_voltage_48v",
        "uint8 tool_output_voltage",
        "float32 tool_current",
        "float32 tool_temperature",
        "uint8 TOOL_BOOTLOADER_MODE=249",
        "uint8 TOOL_RUNNING_MODE=253",
        "uint8 TOOL_IDLE_MODE=255",
        "uint8 tool_mode",
    ),
    "ur_dashboard_msgs/RobotMode": ("int8 mode",),
    "ur_dashboard_msgs/SafetyMode": ("uint8 mode",),
}


@cache
def message_type(name: str) -> MessageType:
    """Look up a message type by name, such as ``sensor_msgs/msg/JointState``."""
    return _complete(name, _FIELDS[name.replace("/msg/", "/")])


def message(topic: str, type_name: str, values: Mapping[str, Any]) -> Message:
    """Encode a message; fields left out are zero or empty."""
    kind = message_type(type_name)
    return Message(topic, kind, kind.encode(values))


def xyz(values: Sequence[float]) -> dict[str, float]:
    """The fields of a geometry_msgs/Point or Vector3."""
    return dict(zip("xyz", values, strict=True))


def xyzw(values: Sequence[float]) -> dict[str, float]:
    """The fields of a geometry_msgs/Quaternion."""
    return dict(zip("xyzw", values, strict=True))


def rtde_type(names: Iterable[str]) -> MessageType:
    """The message type with these RTDE variables as fields."""
    fields = (f"{_ROS_TYPES[OUTPUT_FIELDS[name].type.name]} {ros_name(name)}{_comment(name)}" for name in names)
    return _complete(RTDE_TYPE, (_STAMPED, *fields))


def ros_name(name: str) -> str:
    """The field name of an RTDE variable; ROS allows no capital letters."""
    return name.lower()


def _comment(name: str) -> str:
    field = OUTPUT_FIELDS[name]
    unit = f" [{field.unit}]" if field.unit else ""
    return f"  # {name}{unit}: {field.doc}"


def _complete(name: str, fields: Iterable[str]) -> MessageType:
    own = tuple(fields)
    parts = ["\n".join(own)]
    for used in _used(own):
        parts.append("\n".join((_SEPARATOR, f"MSG: {used}", *_FIELDS[used])))
    return MessageType(name, "\n".join(parts) + "\n")


def _used(fields: Iterable[str]) -> tuple[str, ...]:
    """All message types used by the fields, recursively, each once."""
    found: dict[str, None] = {}
    for field in fields:
        kind = field.split()[0].split("[")[0]
        if kind in _FIELDS:
            found |= dict.fromkeys((kind, *_used(_FIELDS[kind])))
    return tuple(found)
