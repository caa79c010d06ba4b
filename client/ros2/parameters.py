"""Controller parameters as parameters of the controllers' nodes."""

from collections.abc import Callable, Mapping
from typing import Final, get_args

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from client.controllers.controller import Controller
from client.controllers.parameters import Reading, flat, is_read_only, read_parameters
from client.errors import ControllerError
from client.ros2.host import RemoteController

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


def declare(node: Node, controller: RemoteController) -> None:
    """Declare a controller's parameters on its node, and apply changes of those that are not read-only."""
    kinds = {}
    for name, hint, value in flat(controller.parameters):
        kinds[name] = kind = _ARRAYS[get_args(hint)[0]] if get_args(hint) else _TYPES[hint]
        descriptor = ParameterDescriptor(type=kind.value, read_only=is_read_only(name))
        node.declare_parameter(name, value, descriptor)
    node.add_on_set_parameters_callback(_setter(node, controller, kinds))


def _setter(
    node: Node, controller: RemoteController, kinds: Mapping[str, Parameter.Type]
) -> Callable[[list[Parameter]], SetParametersResult]:
    def set_parameters(changed: list[Parameter]) -> SetParametersResult:
        if not any(parameter.name in kinds for parameter in changed):
            return SetParametersResult(successful=True)
        values = {name: node.get_parameter(name).value for name in kinds}
        values.update({parameter.name: parameter.value for parameter in changed if parameter.name in kinds})
        try:
            read = read_parameters(controller.kind.parameters_type, values, controller.name, Reading())
            controller.do(Controller.reconfigure, read)
        except ControllerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    return set_parameters
