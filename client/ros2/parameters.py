"""Parameters of controllers, dataclasses, as parameters of nodes."""

from collections.abc import Callable, Collection
from typing import Any, Final, get_args

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from client.controllers.parameters import Reading, flat, is_read_only, read_parameters
from client.errors import ClientError

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


def declare(node: Node, values: Any, apply: Callable[[Any], object], *, owner: str, prefix: str = "") -> None:
    """Declare parameters on a node, and apply changes of those that are not read-only.

    values: a dataclass with the values at first. apply: called with a changed one; raises ClientError for values that
    are refused. owner: named in errors. prefix: of the names.
    """
    kinds = {}
    for name, hint, value in flat(values):
        kinds[prefix + name] = kind = _ARRAYS[get_args(hint)[0]] if get_args(hint) else _TYPES[hint]
        descriptor = ParameterDescriptor(type=kind.value, read_only=is_read_only(name))
        node.declare_parameter(prefix + name, value, descriptor)
    node.add_on_set_parameters_callback(_setter(node, kinds.keys(), type(values), apply, owner, prefix))


def _setter(
    node: Node,
    names: Collection[str],
    kind: type[Any],
    apply: Callable[[Any], object],
    owner: str,
    prefix: str,
) -> Callable[[list[Parameter]], SetParametersResult]:
    def set_parameters(changed: list[Parameter]) -> SetParametersResult:
        if not any(parameter.name in names for parameter in changed):
            return SetParametersResult(successful=True)
        values = {name: node.get_parameter(name).value for name in names}
        values.update({parameter.name: parameter.value for parameter in changed if parameter.name in names})
        try:
            given = {name.removeprefix(prefix): value for name, value in values.items()}
            apply(read_parameters(kind, given, owner, Reading()))
        except ClientError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    return set_parameters
