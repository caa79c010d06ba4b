"""Parameters of controllers as ROS 2 has them: names with dots, and which of them may be set.

Source of what is read-only: the parameter files of ros2_controllers and ur_controllers.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final, get_args, get_type_hints

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from client.controllers.controller import Controller
from client.controllers.parameters import BY_NAME, Reading, read_parameters
from client.errors import ControllerError
from client.ros2.host import NodeHost

_READ_ONLY: Final = frozenset(
    (
        "action_monitor_rate",
        "command_interfaces",
        "command_joints",
        "constraints.decelerate_on_cancel",
        "frame_id",
        "initial_scaling_factor",
        "interface_name",
        "interfaces",
        "interpolate_from_desired_state",
        "interpolation_method",
        "joints",
        "max_deceleration_on_cancel",
        "pose_name",
        "sensor_name",
        "speed_scaling.command_interface",
        "speed_scaling.state_interface",
        "speed_scaling_interface_name",
        "state_interfaces",
        "state_publish_rate",
        "tf_prefix",
    )
)
_TYPES: Final = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_ARRAYS: Final = {
    bool: Parameter.Type.BOOL_ARRAY,
    int: Parameter.Type.INTEGER_ARRAY,
    float: Parameter.Type.DOUBLE_ARRAY,
    str: Parameter.Type.STRING_ARRAY,
}


def declare(host: NodeHost, node: Node, controller: Controller[Any]) -> None:
    """Declare a controller's parameters on its node, and let those that may be set take effect."""
    kinds = {}
    for name, kind, value in _flat(controller.parameters, getattr(controller.parameters, "joints", ())):
        kinds[name] = kind
        descriptor = ParameterDescriptor(type=kind.value, read_only=_is_read_only(name))
        node.declare_parameter(name, value, descriptor)
    node.add_on_set_parameters_callback(_setter(host, node, controller, kinds))


def _is_read_only(name: str) -> bool:
    parts = name.split(".")
    return any(".".join(parts[place:]) in _READ_ONLY for place in range(len(parts)))


def _flat(parameters: Any, joints: Sequence[str], prefix: str = "") -> Iterator[tuple[str, Parameter.Type, Any]]:
    """Names with dots, types and values; groups by joint are there for every joint."""
    hints = get_type_hints(type(parameters))
    for entry in fields(parameters):
        value, hint = getattr(parameters, entry.name), hints[entry.name]
        name = prefix + entry.name
        if set(BY_NAME) <= set(entry.metadata):
            group = get_args(hint)[1]
            for joint in dict.fromkeys((*joints, *value)):
                yield from _flat(value.get(joint) or group(), joints, f"{prefix}{joint}.")
        elif is_dataclass(value):
            yield from _flat(value, joints, f"{name}.")
        elif isinstance(value, tuple):
            yield name, _ARRAYS[get_args(hint)[0]], list(value)
        else:
            yield name, _TYPES[hint], value


def _setter(
    host: NodeHost, node: Node, controller: Controller[Any], kinds: Mapping[str, Parameter.Type]
) -> Callable[[list[Parameter]], SetParametersResult]:
    def set_parameters(changed: list[Parameter]) -> SetParametersResult:
        if not any(parameter.name in kinds for parameter in changed):
            return SetParametersResult(successful=True)
        values = {name: node.get_parameter(name).value for name in kinds}
        values.update({parameter.name: parameter.value for parameter in changed if parameter.name in kinds})
        try:
            read = read_parameters(controller.parameters_type, values, controller.name, Reading())
            host.do(lambda: controller.reconfigure(read))
        except ControllerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    return set_parameters
