"""The node ``controller_manager``: its services, activity and parameters, as in ros2_control.

Source of names, types and answers: controller_manager and controller_manager_msgs of Humble, Jazzy and Kilted; fields
that a distribution's messages do not have are left out.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from lifecycle_msgs.msg import State

from client.controllers.component import PLUGIN
from client.controllers.configuration import sections, text_of
from client.controllers.controller import CONTROLLER_TYPES, Controller, LifecycleState
from client.controllers.manager import ControllerManager
from client.controllers.running import RunningManager
from client.errors import ClientError, ControllerError
from client.ros2.diagnostics import Diagnostics
from client.ros2.host import LATCHED, NodeHost, interface, interface_if_any
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
_TYPES: Final = (
    ("list_controllers", "ListControllers"),
    ("list_controller_types", "ListControllerTypes"),
    ("load_controller", "LoadController"),
    ("configure_controller", "ConfigureController"),
    ("switch_controller", "SwitchController"),
    ("unload_controller", "UnloadController"),
    ("cleanup_controller", "CleanupController"),
    ("reload_controller_libraries", "ReloadControllerLibraries"),
    ("list_hardware_components", "ListHardwareComponents"),
    ("list_hardware_interfaces", "ListHardwareInterfaces"),
    ("set_hardware_component_state", "SetHardwareComponentState"),
)


class ControllerManagerNode:
    """Offers a controller manager in ROS 2; the node spins from its creation."""

    def __init__(self, host: NodeHost, running: RunningManager) -> None:
        self._host = host
        self._running = running
        self._hardware = running.component
        self.node = host.node(
            "controller_manager",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self._declare()
        for name, type_name in _TYPES:
            if (kind := interface_if_any(f"controller_manager_msgs/srv/{type_name}")) is not None:
                self.node.create_service(kind, f"~/{name}", getattr(self, name))
        Diagnostics(host, self.node, running)
        self._activity: Any = None
        self._last_activity: Any = None
        self._activity_type = interface_if_any("controller_manager_msgs/msg/ControllerManagerActivity")
        if self._activity_type is not None:
            self._activity = self.node.create_publisher(self._activity_type, "~/activity", LATCHED)
            self.node.create_timer(_ACTIVITY_S, self._publish_activity)
        host.spin(self.node)

    @property
    def _manager(self) -> ControllerManager:
        return self._running.manager

    def _declare(self) -> None:
        values: dict[str, Any] = {"update_rate": int(self._manager.update_rate_hz)}
        values.update({f"{name}.type": type_name for name, type_name in self._manager.file.types.items()})
        for name, value in values.items():
            if not self.node.has_parameter(name):
                self.node.declare_parameter(name, value)

    def _log_refusal(self, operation: str, error: URError) -> str:
        self.node.get_logger().error(f"{operation}: {error}")
        return str(error)

    # controllers

    def list_controllers(self, request: Any, response: Any) -> Any:
        """List the loaded controllers, in the order in which they were loaded."""
        response.controller = self._host.do(lambda: [self._state_message(one) for one in self._loaded()])
        return response

    def _loaded(self) -> list[Controller[Any]]:
        return [self._manager.controller(info.name) for info in self._manager.list_controllers()]

    def _state_message(self, controller: Controller[Any]) -> Any:
        message = interface("controller_manager_msgs/msg/ControllerState")()
        message.name = controller.name
        message.type = controller.type_name
        message.state = str(controller.state)
        if controller.active:
            message.claimed_interfaces = list(controller.command_interfaces)
        if controller.state is not LifecycleState.UNCONFIGURED:
            message.required_command_interfaces = list(controller.command_interfaces)
            message.required_state_interfaces = self._manager.state_interfaces_of(controller)
        if hasattr(message, "update_rate"):
            message.update_rate = int(controller.update_rate_hz)
        return message

    def list_controller_types(self, request: Any, response: Any) -> Any:
        """List the types that can be loaded."""
        response.types = sorted(CONTROLLER_TYPES)
        response.base_classes = [_BASE] * len(response.types)
        return response

    def load_controller(self, request: Any, response: Any) -> Any:
        """Load a controller by the parameters NAME.type and NAME.params_file, or as in the controllers file."""
        name = request.name
        try:
            if not name:
                raise ControllerError("load_controller", "the name of the controller is empty")
            type_name, parameters = self._type_and_parameters(name)
            self._host.wait(self._running.load(name, type_name, parameters))
        except (ClientError, OSError) as error:
            self.node.get_logger().error(f"load_controller: {error}")
            response.ok = False
            return response
        response.ok = True
        return response

    def _type_and_parameters(self, name: str) -> tuple[str | None, dict[str, Any] | None]:
        """Type and parameters given by parameters of this node; None for those of the controllers file."""
        type_name = self._text(f"{name}.type") or None
        files = self._texts(f"{name}.params_file")
        if not files:
            return type_name, None
        parameters: dict[str, Any] = {}
        for file in files:
            found = sections(text_of(Path(file)), file, {"tf_prefix": self._running.control.prefix})
            parameters = {**parameters, **found.get("**", {}), **found.get(name, {})}
        return type_name, parameters

    def _text(self, name: str) -> str:
        return str(self.node.get_parameter(name).value or "") if self.node.has_parameter(name) else ""

    def _texts(self, name: str) -> list[str]:
        value = self.node.get_parameter(name).value if self.node.has_parameter(name) else None
        return [value] if isinstance(value, str) and value else list(value or ())

    def configure_controller(self, request: Any, response: Any) -> Any:
        """Configure an unconfigured controller, or an inactive one once more; it is then inactive."""

        def configure() -> None:
            if self._manager.controller(request.name).state is LifecycleState.INACTIVE:
                self._manager.cleanup(request.name)
            self._manager.configure(request.name)

        return self._try("configure_controller", configure, response)

    def cleanup_controller(self, request: Any, response: Any) -> Any:
        """Take a controller from inactive to unconfigured."""
        return self._try("cleanup_controller", lambda: self._manager.cleanup(request.name), response)

    def unload_controller(self, request: Any, response: Any) -> Any:
        """Unload a controller, and end its node."""
        try:
            self._host.wait(self._running.unload(request.name))
            response.ok = True
        except ClientError as error:
            self._log_refusal("unload_controller", error)
            response.ok = False
        return response

    def reload_controller_libraries(self, request: Any, response: Any) -> Any:
        """Refused, because there are no libraries: controllers are part of this program."""
        self.node.get_logger().error("reload_controller_libraries: controllers are part of this program, not libraries")
        response.ok = False
        return response

    def _try(self, operation: str, work: Callable[[], object], response: Any) -> Any:
        try:
            self._host.do(work)
        except ClientError as error:
            self._log_refusal(operation, error)
            response.ok = False
        else:
            response.ok = True
        return response

    def switch_controller(self, request: Any, response: Any) -> Any:
        """Switch controllers: with STRICT all or none, with BEST_EFFORT as many as possible."""
        best_effort = request.strictness != request.STRICT
        start = [*request.activate_controllers, *getattr(request, "start_controllers", ())]
        stop = [*request.deactivate_controllers, *getattr(request, "stop_controllers", ())]
        text = "Successfully switched controllers!"
        try:
            self._host.do(lambda: self._manager.switch(activate=start, deactivate=stop, best_effort=best_effort))
            response.ok = True
        except ClientError as error:
            text, response.ok = self._log_refusal("switch_controller", error), False
        if hasattr(response, "message"):
            response.message = text
        return response

    # hardware

    def list_hardware_components(self, request: Any, response: Any) -> Any:
        """List the arm, which is the only component."""
        component = interface("controller_manager_msgs/msg/HardwareComponentState")()
        component.name = self._hardware.name
        component.type = "system"
        for field in ("plugin_name", "class_type"):
            if hasattr(component, field):
                setattr(component, field, PLUGIN)
        if hasattr(component, "rw_rate"):
            component.rw_rate = int(self._manager.update_rate_hz)
        component.state = _message(self._hardware.state)
        component.command_interfaces, component.state_interfaces = self._interfaces()
        response.component = [component]
        return response

    def list_hardware_interfaces(self, request: Any, response: Any) -> Any:
        """List the interfaces of the arm."""
        response.command_interfaces, response.state_interfaces = self._interfaces()
        return response

    def _interfaces(self) -> tuple[list[Any], list[Any]]:
        kind = interface("controller_manager_msgs/msg/HardwareInterface")
        infos = self._host.do(self._manager.list_interfaces)
        messages: dict[str, list[Any]] = {"command": [], "state": []}
        for info in infos:
            message = kind(name=info.name, is_available=self._hardware.available, is_claimed=bool(info.claimed_by))
            if hasattr(message, "data_type"):
                message.data_type = "double"
            messages[info.kind].append(message)
        return messages["command"], messages["state"]

    def set_hardware_component_state(self, request: Any, response: Any) -> Any:
        """Take the arm to active, inactive or unconfigured."""
        try:
            if request.name != self._hardware.name:
                raise ControllerError(request.name, f"unknown hardware component: use {self._hardware.name}")
            self._host.wait(self._hardware.go_to(self._target_state(request.target_state)))
            response.ok = True
        except URError as error:
            self._log_refusal("set_hardware_component_state", error)
            response.ok = False
        response.state = _message(self._hardware.state)
        return response

    def _target_state(self, message: State) -> LifecycleState:
        """The requested state, by its number or else its label. Raises ControllerError."""
        if message.id in _PRIMARY:
            return _PRIMARY[message.id]
        if not message.id and message.label in map(str, LifecycleState):
            return LifecycleState(message.label)
        reason = f"state {message.id} {message.label!r} is not unconfigured, inactive or active"
        raise ControllerError(self._hardware.name, reason)

    # what is published without a request

    def _publish_activity(self) -> None:
        states = self._host.do(lambda: [(info.name, info.state) for info in self._manager.list_controllers()])
        hardware = _message(self._hardware.state)
        key = (tuple(states), hardware.id)
        if key == self._last_activity:
            return
        self._last_activity = key
        named = interface("controller_manager_msgs/msg/NamedLifecycleState")
        message = self._activity_type()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.controllers = [named(name=name, state=_message(state)) for name, state in states]
        message.hardware_components = [named(name=self._hardware.name, state=hardware)]
        self._activity.publish(message)


def _message(state: LifecycleState) -> State:
    return State(id=_STATES[state], label=str(state))
