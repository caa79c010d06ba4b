"""The node ``controller_manager``: its services, activity and parameters, as in ros2_control.

Source of names, types and answers: controller_manager and controller_manager_msgs of Humble, Jazzy and Kilted, whose
messages Lyrical has too; fields that a distribution's messages do not have are left out.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from lifecycle_msgs.msg import State

from client.controllers.configuration import sections, text_of
from client.controllers.controller import CONTROLLER_TYPES, LifecycleState
from client.controllers.session import BEST_EFFORT, STRICT, Session
from client.errors import ClientError, ControllerError
from client.ros2.control_side import SESSION, SIDE, ControlSide, RobotFacts
from client.ros2.diagnostics import Diagnostics
from client.ros2.host import LATCHED, NodeHost, interface, interface_if_any, stamp
from urproto.errors import URError

_STATES: Final = {
    LifecycleState.UNCONFIGURED: State.PRIMARY_STATE_UNCONFIGURED,
    LifecycleState.INACTIVE: State.PRIMARY_STATE_INACTIVE,
    LifecycleState.ACTIVE: State.PRIMARY_STATE_ACTIVE,
    LifecycleState.FINALIZED: State.PRIMARY_STATE_FINALIZED,
}
_PRIMARY: Final = {number: state for state, number in _STATES.items()}
_BASE: Final = "controller_interface::ControllerInterface"
_ACTIVITY_S: Final = 0.1  # interval at which changes are checked; guess
_SERVICES: Final = (  # each with the type of the same name
    *("list_controllers", "list_controller_types", "load_controller", "switch_controller"),
    *("reload_controller_libraries", "list_hardware_components", "list_hardware_interfaces"),
    "set_hardware_component_state",
)
_BY_NAME: Final = ("configure_controller", "cleanup_controller", "unload_controller")


class ControllerManagerNode:
    """Offers a controller manager in ROS 2; the node spins from its creation. prefix: of joints and interfaces."""

    def __init__(self, host: NodeHost, facts: RobotFacts, prefix: str = "") -> None:
        self._host = host
        self._facts = facts
        self._prefix = prefix
        self.node = host.node(
            "controller_manager",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self._declare()
        handlers = {name: getattr(self, name) for name in _SERVICES}
        handlers |= {name: partial(self._handle_by_name, name) for name in _BY_NAME}
        for name, handler in handlers.items():
            type_name = name.title().replace("_", "")
            if (kind := interface_if_any(f"controller_manager_msgs/srv/{type_name}")) is not None:
                self.node.create_service(kind, f"~/{name}", handler)
        Diagnostics(host, self.node, facts)
        self._activity: Any = None
        self._last_activity: Any = None
        self._activity_type = interface_if_any("controller_manager_msgs/msg/ControllerManagerActivity")
        if self._activity_type is not None:
            self._activity = self.node.create_publisher(self._activity_type, "~/activity", LATCHED)
            self.node.create_timer(_ACTIVITY_S, self._publish_activity)
        host.spin(self.node)

    def _request(self, do: str, **arguments: Any) -> Any:
        """Send a request of `client.controllers.session`. Raises URError."""
        return self._host.do(Session.request, SESSION, do, **arguments)

    def _declare(self) -> None:
        values: dict[str, Any] = {"update_rate": int(self._facts.update_rate_hz)}
        values.update({f"{name}.type": type_name for name, type_name in self._facts.types.items()})
        for name, value in values.items():
            if not self.node.has_parameter(name):
                self.node.declare_parameter(name, value)

    def _log_refusal(self, operation: str, error: URError) -> str:
        self.node.get_logger().error(f"{operation}: {error}")
        return str(error)

    # controllers

    def list_controllers(self, request: Any, response: Any) -> Any:
        """List the loaded controllers, in the order in which they were loaded."""
        response.controller = [_state_message(one) for one in self._request("list_controllers")]
        return response

    def list_controller_types(self, request: Any, response: Any) -> Any:
        response.types = sorted(CONTROLLER_TYPES)
        response.base_classes = [_BASE] * len(response.types)
        return response

    def load_controller(self, request: Any, response: Any) -> Any:
        """Load a controller by the parameters NAME.type and NAME.params_file, or as in the controllers file."""
        return self._try("load_controller", response, lambda: self._load(request.name))

    def _load(self, name: str) -> None:
        if not name:
            raise ControllerError("load_controller", "the name of the controller is empty")
        try:
            type_name, parameters = self._type_and_parameters(name)
        except OSError as error:
            raise ControllerError(name, str(error)) from None
        self._request("load_controller", name=name, type=type_name, parameters=parameters)

    def _type_and_parameters(self, name: str) -> tuple[str | None, dict[str, Any] | None]:
        """Type and parameters given by parameters of this node; None for those of the controllers file."""
        type_name = self._text(f"{name}.type") or None
        files = self._texts(f"{name}.params_file")
        if not files:
            return type_name, None
        parameters: dict[str, Any] = {}
        for file in files:
            found = sections(text_of(Path(file)), file, {"tf_prefix": self._prefix})
            parameters = {**parameters, **found.get("**", {}), **found.get(name, {})}
        return type_name, parameters

    def _text(self, name: str) -> str:
        return str(self.node.get_parameter(name).value or "") if self.node.has_parameter(name) else ""

    def _texts(self, name: str) -> list[str]:
        value = self.node.get_parameter(name).value if self.node.has_parameter(name) else None
        return [value] if isinstance(value, str) and value else list(value or ())

    def _handle_by_name(self, operation: str, request: Any, response: Any) -> Any:
        """Configure, clean up or unload the controller that a request names."""
        return self._try(operation, response, lambda: self._request(operation, name=request.name))

    def reload_controller_libraries(self, request: Any, response: Any) -> Any:
        """Refused, because there are no libraries: controllers are part of this program."""
        self.node.get_logger().error("reload_controller_libraries: controllers are part of this program, not libraries")
        response.ok = False
        return response

    def _try(self, operation: str, response: Any, work: Callable[[], object]) -> Any:
        try:
            work()
        except URError as error:
            self._log_refusal(operation, error)
            response.ok = False
        else:
            response.ok = True
        return response

    def switch_controller(self, request: Any, response: Any) -> Any:
        """Switch controllers: with STRICT all or none, with BEST_EFFORT as many as possible."""
        strictness = STRICT if request.strictness == request.STRICT else BEST_EFFORT
        start = [*request.activate_controllers, *getattr(request, "start_controllers", ())]
        stop = [*request.deactivate_controllers, *getattr(request, "stop_controllers", ())]
        text = "Successfully switched controllers!"
        try:
            self._request("switch_controller", activate=start, deactivate=stop, strictness=strictness)
            response.ok = True
        except ClientError as error:
            text, response.ok = self._log_refusal("switch_controller", error), False
        if hasattr(response, "message"):
            response.message = text
        return response

    # hardware

    def list_hardware_components(self, request: Any, response: Any) -> Any:
        """List the arm, which is the only component."""
        (arm,) = self._request("list_hardware_components")
        component = interface("controller_manager_msgs/msg/HardwareComponentState")()
        component.name, component.type = arm["name"], arm["type"]
        for field in ("plugin_name", "class_type"):
            if hasattr(component, field):
                setattr(component, field, arm["plugin_name"])
        if hasattr(component, "rw_rate"):
            component.rw_rate = int(self._facts.update_rate_hz)
        component.state = _message(arm["state"])
        component.command_interfaces, component.state_interfaces = self._interfaces()
        response.component = [component]
        return response

    def list_hardware_interfaces(self, request: Any, response: Any) -> Any:
        response.command_interfaces, response.state_interfaces = self._interfaces()
        return response

    def _interfaces(self) -> tuple[list[Any], list[Any]]:
        kind = interface("controller_manager_msgs/msg/HardwareInterface")
        messages: dict[str, list[Any]] = {"command": [], "state": []}
        for one in self._request("list_hardware_interfaces"):
            message = kind(name=one["name"], is_available=one["is_available"], is_claimed=bool(one["claimed_by"]))
            if hasattr(message, "data_type"):
                message.data_type = "double"
            messages[one["kind"]].append(message)
        return messages["command"], messages["state"]

    def set_hardware_component_state(self, request: Any, response: Any) -> Any:
        """Take the arm to active, inactive or unconfigured."""
        operation = "set_hardware_component_state"

        def set_state() -> None:
            self._request(operation, name=request.name, state=self._target_state(request))

        self._try(operation, response, set_state)
        response.state = _message(self._host.do(ControlSide.states, SIDE)[1])
        return response

    def _target_state(self, request: Any) -> str:
        """The requested state, by its number or else its label. Raises ControllerError."""
        message = request.target_state
        if message.id in _PRIMARY:
            return str(_PRIMARY[message.id])
        if not message.id and message.label in map(str, LifecycleState):
            return str(message.label)
        reason = f"state {message.id} {message.label!r} is not unconfigured, inactive or active"
        raise ControllerError(request.name, reason)

    # what is published without a request

    def _publish_activity(self) -> None:
        states, hardware = found = self._host.do(ControlSide.states, SIDE)
        if found == self._last_activity:
            return
        self._last_activity = found
        named = interface("controller_manager_msgs/msg/NamedLifecycleState")
        message = self._activity_type()
        stamp(message.header.stamp, self._host.now_ns())
        message.controllers = [named(name=name, state=_message(state)) for name, state in states]
        message.hardware_components = [named(name=self._facts.component, state=_message(hardware))]
        self._activity.publish(message)


def _state_message(controller: Mapping[str, Any]) -> Any:
    """A ControllerState; controller: as `client.controllers.session` describes it."""
    message = interface("controller_manager_msgs/msg/ControllerState")()
    for field in ("name", "type", "state", "claimed_interfaces", "update_rate"):
        if hasattr(message, field):
            setattr(message, field, controller[field])
    message.required_command_interfaces = controller["required_command_interfaces"]
    message.required_state_interfaces = controller["required_state_interfaces"]
    return message


def _message(state: str) -> State:
    return State(id=_STATES[LifecycleState(state)], label=state)
