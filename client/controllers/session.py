"""Requests that other processes can send to a running controller manager.

Names and results are those of the services of ros2_control's controller manager. Requests are carried out in the event
loop, between two control cycles, so simultaneous switches from two shells are carried out one after the other.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from inspect import signature
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_type_hints

import msgspec

from client.controllers.component import PLUGIN
from client.controllers.configuration import help_of
from client.controllers.control import listen, recorded
from client.controllers.controller import CONTROLLER_TYPES, Controller, LifecycleState
from client.controllers.forward import ForwardCommandController
from client.controllers.goals import GoalHandle, JointTrajectory, JointTrajectoryPoint
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.manager import ControllerManager
from client.controllers.parameters import flat, is_read_only
from client.controllers.passthrough import PassthroughTrajectoryController
from client.controllers.running import RunningManager
from client.errors import ControllerError, ManagerError
from client.recording import BackgroundRecorder
from urproto.structures import converted
from urproto.text import quoted

_MAX_GOALS: Final = 1000
STRICT: Final = "strict"
BEST_EFFORT: Final = "best_effort"


Follower: TypeAlias = JointTrajectoryController | PassthroughTrajectoryController
Answer: TypeAlias = Any
_HANDLERS: dict[str, tuple[Callable[..., Any], type[msgspec.Struct]]] = {}


def _handler(method: Any) -> Any:
    """Mark a method as a request of the same name; the arguments are those of the method, and others are ignored."""
    hints = get_type_hints(method)
    arguments = [
        (name, hints[name], *(() if argument.default is argument.empty else (argument.default,)))
        for name, argument in list(signature(method).parameters.items())[1:]
    ]
    _HANDLERS[method.__name__] = method, msgspec.defstruct(method.__name__, arguments)
    return method


class Session:
    """The session of one client, and what it has started, which `close` ends.

    Each request method returns a JSON value. Raises URError.
    """

    def __init__(self, running: RunningManager) -> None:
        self._running = running
        self._goals: dict[int, tuple[Follower, GoalHandle]] = {}
        self._count = 0
        self._driven: set[ForwardCommandController] = set()
        self._recording = AsyncExitStack()
        self._recorder: BackgroundRecorder | None = None

    async def request(self, do: str, /, **arguments: Any) -> Answer:
        """Carry out a request. Raises ManagerError if it is unknown or has wrong arguments, and its own errors."""
        if do not in _HANDLERS:
            raise ManagerError(f"there is no request {quoted(do)}: this may be another version of ur-client")
        method, kind = _HANDLERS[do]
        checked = {name: value for name, value in arguments.items() if name != "parameters"}  # may be infinite
        given = msgspec.structs.asdict(converted(checked, kind, do, ManagerError))
        if "parameters" in given:
            given["parameters"] = _mapping(arguments.get("parameters"), do)
        answer = method(self, **given)
        return await answer if isinstance(answer, Awaitable) else answer

    async def close(self) -> None:
        """End the session: cancel its goals, set its speeds to zero, and complete its recording."""
        for controller, handle in self._goals.values():
            self._cancel(controller, handle)
        for forward in self._driven:
            self._release(forward)
        await self._recording.aclose()

    @property
    def _manager(self) -> ControllerManager:
        return self._running.manager

    # controllers

    @_handler
    def list_controllers(self) -> Answer:
        """All loaded controllers, with the interfaces that they claim and read, and what they follow."""
        return [self._describe(self._manager.controller(info.name)) for info in self._manager.list_controllers()]

    def _describe(self, controller: Controller[Any]) -> Answer:
        configured = controller.state is not LifecycleState.UNCONFIGURED
        commands = list(controller.command_interfaces)
        return {
            "name": controller.name,
            "type": controller.type_name,
            "state": str(controller.state),
            "update_rate": int(controller.update_rate_hz),
            "claimed_interfaces": commands if controller.active else [],
            "required_command_interfaces": commands if configured else [],
            "required_state_interfaces": self._manager.state_interfaces_of(controller) if configured else [],
            "joints": list(controller.joints) if isinstance(controller, Follower) else [],
        }

    @_handler
    def list_available(self) -> Answer:
        """The controllers in the manager's controllers file, with their types."""
        return dict(self._manager.file.types)

    @_handler
    def list_controller_types(self) -> Answer:
        """All types with descriptions, and the unsupported ones with alternatives."""
        return available_types()

    @_handler
    async def load_controller(
        self,
        name: str,
        type: str | None = None,  # noqa: A002 # as in controllers files
        parameters: dict[str, Any] | None = None,
    ) -> Answer:
        """Load a controller; type and parameters if they differ from the manager's file. Returns notes."""
        known = len(self._manager.notes)
        await self._running.load(name, type, parameters)
        return {"notes": self._manager.notes[known:]}

    @_handler
    def configure_controller(self, name: str) -> Answer:
        """Configure a controller that is unconfigured, or reconfigure an inactive one."""
        if self._manager.controller(name).state is LifecycleState.INACTIVE:
            self._manager.cleanup(name)
        self._manager.configure(name)

    @_handler
    def cleanup_controller(self, name: str) -> Answer:
        """Return an inactive controller to unconfigured."""
        self._manager.cleanup(name)

    @_handler
    async def unload_controller(self, name: str) -> Answer:
        """Unload a controller that is not active."""
        await self._running.unload(name)

    @_handler
    def switch_controller(
        self,
        activate: Sequence[str] = (),
        deactivate: Sequence[str] = (),
        strictness: Literal["strict", "best_effort"] = STRICT,
    ) -> Answer:
        """strictness: all or nothing, or best effort. Returns what has changed."""
        before = {controller.name for controller in self._manager.active()}
        self._manager.switch(activate=activate, deactivate=deactivate, best_effort=strictness == BEST_EFFORT)
        after = {controller.name for controller in self._manager.active()}
        return {"activated": sorted(after - before), "deactivated": sorted(before - after)}

    @_handler
    def moving_controllers(self) -> Answer:
        """Names of the controllers that move the arm, which the next such controller replaces."""
        return [controller.name for controller in self._manager.moving()]

    @_handler
    def list_parameters(self, name: str) -> Answer:
        """Value and read-only flag of each parameter of a controller, by name."""
        controller = self._manager.controller(name)
        values = flat(controller.parameters)
        return {name: {"value": value, "read_only": is_read_only(name)} for name, _, value in values}

    @_handler
    async def set_parameters(self, name: str, parameters: dict[str, Any] | None = None) -> Answer:
        """Set parameters of a controller; on an error, none is changed."""
        await self._running.set_parameters(name, parameters or {})

    # hardware

    @_handler
    def list_hardware_components(self) -> Answer:
        """The hardware components, of which the arm is the only one."""
        component = self._running.component
        return [{"name": component.name, "type": "system", "plugin_name": PLUGIN, "state": str(component.state)}]

    @_handler
    def list_hardware_interfaces(self) -> Answer:
        """All interfaces of the arm, with their values and the controllers that have claimed them."""
        hardware, available = self._manager.hardware, self._running.component.available
        return [
            {
                "name": info.name,
                "kind": info.kind,
                "value": (hardware.commands if info.kind == "command" else hardware.states)[info.name],
                "is_available": available,
                "claimed_by": info.claimed_by,
            }
            for info in self._manager.list_interfaces()
        ]

    @_handler
    async def set_hardware_component_state(self, name: str, state: str) -> Answer:
        """state: active, inactive or unconfigured. Returns the component's state."""
        component = self._running.component
        if name != component.name:
            raise ControllerError(name, f"the only hardware component is {component.name}")
        if state not in map(str, LifecycleState):
            raise ControllerError(name, f"its state must be unconfigured, inactive or active, not {quoted(state)}")
        await component.go_to(LifecycleState(state))
        return str(component.state)

    # motion

    @_handler
    def send_goal(self, controller: str, trajectory: JointTrajectory) -> Answer:
        """Send a goal, which is refused beyond the joint limits. Returns a number for the request `goal`."""
        follower = self._follower(controller)
        follower.check_active()
        self._running.control.check_reach(trajectory)
        if len(self._goals) >= _MAX_GOALS:
            raise ManagerError(f"{_MAX_GOALS} results of goals have not been fetched: request them first")
        self._count += 1
        self._goals[self._count] = follower, follower.send_goal(trajectory)
        return self._count

    @_handler
    def goal(self, goal: int) -> Answer:
        """Progress of a goal, given by number, from 0 to 1, and its result, which is returned only once."""
        if goal not in self._goals:
            raise ManagerError(f"this connection has no goal {goal}, or its result has been returned already")
        controller, handle = self._goals[goal]
        if handle.result is None:
            return {"progress": controller.progress}
        del self._goals[goal]
        return {
            "progress": controller.progress,
            "error_code": int(handle.result.error_code),
            "error_string": handle.result.error_string,
        }

    @_handler
    def cancel_goal(self, goal: int) -> Answer:
        """Cancel a goal, given by number, if it is still under way."""
        if found := self._goals.get(goal):
            self._cancel(*found)

    @_handler
    def joint_trajectory(self, controller: str, trajectory: JointTrajectory) -> Answer:
        """Follow a trajectory without a result, as from the ROS topic of the same name."""
        follower = self._follower(controller)
        if not isinstance(follower, JointTrajectoryController):
            raise follower.error("it takes goals only")
        follower.check_active()
        follower.check(trajectory)
        self._running.control.check_reach(trajectory, speeds=False)  # speeds are judged by the tolerances
        follower.command(trajectory)

    @_handler
    def forward_command(
        self, controller: str, values: tuple[float, ...] = (), time_s: float = 0.0, hold: bool = False
    ) -> Answer:
        """Command values from now on. hold: only as long as this connection lasts.

        time_s: for positions, the duration of the motion, along a cubic; without it they are commanded immediately.
        """
        forward = self._manager.controller(controller)
        if not isinstance(forward, ForwardCommandController):
            raise ControllerError(controller, f"{forward.type_name} takes no commands of this kind")
        forward.check_active()
        forward.check(values)
        if forward.interface_name == "position":
            end = JointTrajectoryPoint(values, (0.0,) * len(values), time_from_start_s=time_s)
            way = JointTrajectory(forward.parameters.joints, (end,))
            self._running.control.check_reach(way, speeds=time_s > 0.0)
        elif time_s:
            raise forward.error("time_s is for positions only")
        if time_s > 0.0:
            scaling = f"{self._running.control.prefix}speed_scaling/speed_scaling_factor"
            states = self._manager.hardware.states
            forward.go_to(values, time_s, lambda: states[scaling])
        else:
            forward.command(values)
        if hold:
            self._driven.add(forward)

    def _follower(self, name: str) -> Follower:
        controller = self._manager.controller(name)
        if isinstance(controller, Follower):
            return controller
        raise ControllerError(controller.name, f"{controller.type_name} follows no trajectories")

    def _cancel(self, controller: Follower, handle: GoalHandle) -> None:
        if controller.active and controller.goal is handle:
            controller.cancel()

    def _release(self, controller: ForwardCommandController) -> None:
        """End speeds and torques; positions are kept."""
        if not controller.active:
            return
        if controller.interface_name == "position":
            controller.hold_position()
        else:
            controller.command((0.0,) * len(controller.parameters.joints))

    # the robot

    @_handler
    def robot_state(self) -> Answer:
        """State of the robot that a client needs to show the progress of a motion; time_s is the robot's time."""
        control = self._running.control
        state, link = control.driver.state, control.driver.link
        return {
            "time_s": self._manager.time_s,
            "positions": dict(zip(control.joints, state["actual_q"], strict=True)),
            "at_rest": control.at_rest,
            "robot_mode": link.robot_mode.name,
            "safety_mode": link.safety_mode.name,
            "target_speed_fraction": state["target_speed_fraction"],
            "program_running": control.driver.program_running,
        }

    @_handler
    async def make_ready(self) -> Answer:
        """Power the arm on, release its brakes, start the control program, as far as still necessary."""
        await self._running.control.robot.make_ready()

    @_handler
    async def set_speed_slider(self, fraction: float) -> Answer:
        """fraction: 0.01 to 1."""
        if not 0.01 <= fraction <= 1.0:
            raise ManagerError(f"the speed slider takes 0.01 to 1, not {fraction:g}")
        await self._running.control.robot.set_speed_slider(fraction)

    @_handler
    async def begin_recording(self, path: str) -> Answer:
        """path: absolute path of the file that records robot and trajectory controllers until this connection ends."""
        file = Path(path)
        if not file.is_absolute():
            raise ManagerError(f"the path of a recording must be absolute, not {quoted(path)}")
        recorder = await self._recording.enter_async_context(recorded(self._running.control.driver, file))
        self._recording.callback(listen(recorder, self._manager))
        self._recorder = recorder

    @_handler
    def record_markers(self, topic: str, markers: list[dict[str, Any]]) -> Answer:
        """markers: fields of visualization_msgs/Marker, for 3D views; recorded with the present time."""
        if self._recorder is None:
            raise ManagerError("there is no recording for the markers: call begin_recording first")
        self._recorder.write_markers(topic, markers, self._manager.time_s)

    @_handler
    async def end_recording(self) -> Answer:
        """End the recording; answered once the file is complete."""
        self._recorder = None
        await self._recording.aclose()


def available_types() -> Answer:
    """Types of controllers, with descriptions."""
    return {"types": {name: help_of(kind) for name, kind in sorted(CONTROLLER_TYPES.items())}}


def _mapping(parameters: Any, do: str) -> Mapping[str, Any] | None:
    if not isinstance(parameters, Mapping | None):
        raise ManagerError(f"{do}: parameters must be a mapping, not {quoted(parameters)}")
    return parameters
