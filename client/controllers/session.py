"""Requests that other processes can send to a running controller manager.

Names and results are those of the services of ros2_control's controller manager. Requests are carried out in the event
loop, between two control cycles, so simultaneous switches from two shells are carried out one after the other.
"""

from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final, TypeAlias

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
from urproto.text import quoted
from urproto.vectors import is_number

_MAX_GOALS: Final = 1000
_POINT: Final = ("positions", "velocities", "accelerations", "effort")
STRICT: Final = "strict"
BEST_EFFORT: Final = "best_effort"


class Request:
    """The arguments of a request. Raises ManagerError for arguments that are missing or have the wrong type."""

    def __init__(self, message: Mapping[str, Any]) -> None:
        self._message = message

    def __contains__(self, name: str) -> bool:
        return self._message.get(name) is not None

    def text(self, name: str) -> str:
        """A string that is not empty."""
        value = self._message.get(name)
        if isinstance(value, str) and value:
            return value
        raise self._wrong(name, "a text")

    def texts(self, name: str) -> list[str]:
        """A list of strings; empty if left out."""
        value = self._message.get(name, [])
        if isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
            return list(value)
        raise self._wrong(name, "a list of strings")

    def number(self, name: str, default: float | None = None) -> float:
        """A finite number."""
        value = self._message.get(name, default)
        if is_number(value):
            return float(value)
        raise self._wrong(name, "a finite number")

    def numbers(self, name: str) -> tuple[float, ...]:
        """A list of finite numbers; empty if left out."""
        value = self._message.get(name, [])
        if isinstance(value, list | tuple) and all(map(is_number, value)):
            return tuple(map(float, value))
        raise self._wrong(name, "a list of finite numbers")

    def flag(self, name: str) -> bool:
        """A boolean; False if left out."""
        value = self._message.get(name, False)
        if isinstance(value, bool):
            return value
        raise self._wrong(name, "true or false")

    def group(self, name: str) -> "Request":
        """A JSON object, as a `Request`."""
        return Request(self.mapping(name))

    def groups(self, name: str) -> list["Request"]:
        """A list of JSON objects, as `Request`s."""
        return [Request(item) for item in self.mappings(name)]

    def mappings(self, name: str) -> list[Mapping[str, Any]]:
        """A list of JSON objects, unchanged."""
        value = self._message.get(name)
        if isinstance(value, list | tuple) and all(isinstance(item, Mapping) for item in value):
            return list(value)
        raise self._wrong(name, "a list of objects")

    def mapping(self, name: str) -> Mapping[str, Any]:
        """A JSON object, unchanged."""
        value = self._message.get(name)
        if isinstance(value, Mapping):
            return value
        raise self._wrong(name, "an object")

    def _wrong(self, name: str, kind: str) -> ManagerError:
        return ManagerError(f"the argument {name} must be {kind}, not {quoted(self._message.get(name))}")


Follower: TypeAlias = JointTrajectoryController | PassthroughTrajectoryController
Answer: TypeAlias = Any
_Handler = Callable[["Session", Request], Answer | Awaitable[Answer]]
_HANDLERS: dict[str, _Handler] = {}


def _handler(method: Any) -> Any:
    """Mark a method as a request of the same name."""
    _HANDLERS[method.__name__] = method
    return method


class Session:
    """The session of one client, and what it has started, which `close` ends.

    Each request method takes a `Request` and returns a JSON value. Raises URError.
    """

    def __init__(self, running: RunningManager) -> None:
        self._running = running
        self._goals: dict[int, tuple[Follower, GoalHandle]] = {}
        self._count = 0
        self._driven: set[ForwardCommandController] = set()
        self._recording = AsyncExitStack()
        self._recorder: BackgroundRecorder | None = None

    async def request(self, do: str, /, **arguments: Any) -> Answer:
        """Carry out a request. Raises ManagerError for an unknown request, and the errors of the request itself."""
        if do not in _HANDLERS:
            raise ManagerError(f"there is no request {quoted(do)}: this may be another version of ur-client")
        answer = _HANDLERS[do](self, Request(arguments))
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
    def list_controllers(self, request: Request) -> Answer:
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
    def list_available(self, request: Request) -> Answer:
        """The controllers in the manager's controllers file, with their types."""
        return dict(self._manager.file.types)

    @_handler
    def list_controller_types(self, request: Request) -> Answer:
        """All types with descriptions, and the unsupported ones with alternatives."""
        return available_types()

    @_handler
    async def load_controller(self, request: Request) -> Answer:
        """name; type and parameters if they differ from the manager's file. Returns notes."""
        known = len(self._manager.notes)
        await self._running.load(
            request.text("name"),
            request.text("type") if "type" in request else None,
            request.mapping("parameters") if "parameters" in request else None,
        )
        return {"notes": self._manager.notes[known:]}

    @_handler
    def configure_controller(self, request: Request) -> Answer:
        """Configure a controller that is unconfigured, or reconfigure an inactive one."""
        name = request.text("name")
        if self._manager.controller(name).state is LifecycleState.INACTIVE:
            self._manager.cleanup(name)
        self._manager.configure(name)

    @_handler
    def cleanup_controller(self, request: Request) -> Answer:
        """Return an inactive controller to unconfigured."""
        self._manager.cleanup(request.text("name"))

    @_handler
    async def unload_controller(self, request: Request) -> Answer:
        """Unload a controller that is not active."""
        await self._running.unload(request.text("name"))

    @_handler
    def switch_controller(self, request: Request) -> Answer:
        """activate, deactivate: names. strictness: all or nothing, or best effort. Returns what has changed."""
        strictness = request.text("strictness") if "strictness" in request else STRICT
        if strictness not in (STRICT, BEST_EFFORT):
            raise ManagerError(f"strictness must be {STRICT} or {BEST_EFFORT}, not {quoted(strictness)}")
        activate, deactivate = request.texts("activate"), request.texts("deactivate")
        before = {controller.name for controller in self._manager.active()}
        self._manager.switch(activate=activate, deactivate=deactivate, best_effort=strictness == BEST_EFFORT)
        after = {controller.name for controller in self._manager.active()}
        return {"activated": sorted(after - before), "deactivated": sorted(before - after)}

    @_handler
    def moving_controllers(self, request: Request) -> Answer:
        """Names of the controllers that move the arm, which the next such controller replaces."""
        return [controller.name for controller in self._manager.moving()]

    @_handler
    def list_parameters(self, request: Request) -> Answer:
        """name: of a controller. Returns value and read-only flag of each parameter, by name."""
        controller = self._manager.controller(request.text("name"))
        values = flat(controller.parameters)
        return {name: {"value": value, "read_only": is_read_only(name)} for name, _, value in values}

    @_handler
    async def set_parameters(self, request: Request) -> Answer:
        """name, parameters: on an error, none is changed."""
        await self._running.set_parameters(request.text("name"), request.mapping("parameters"))

    # hardware

    @_handler
    def list_hardware_components(self, request: Request) -> Answer:
        """The hardware components, of which the arm is the only one."""
        component = self._running.component
        return [{"name": component.name, "type": "system", "plugin_name": PLUGIN, "state": str(component.state)}]

    @_handler
    def list_hardware_interfaces(self, request: Request) -> Answer:
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
    async def set_hardware_component_state(self, request: Request) -> Answer:
        """name, state: active, inactive or unconfigured. Returns its state."""
        component, name, state = self._running.component, request.text("name"), request.text("state")
        if name != component.name:
            raise ControllerError(name, f"the only hardware component is {component.name}")
        if state not in map(str, LifecycleState):
            raise ControllerError(name, f"its state must be unconfigured, inactive or active, not {quoted(state)}")
        await component.go_to(LifecycleState(state))
        return str(component.state)

    # motion

    @_handler
    def send_goal(self, request: Request) -> Answer:
        """controller, trajectory: refused beyond the joint limits. Returns a number for the request `goal`."""
        controller = self._follower(request)
        trajectory = _trajectory(request.group("trajectory"))
        controller.check_active()
        self._running.control.check_reach(trajectory)
        if len(self._goals) >= _MAX_GOALS:
            raise ManagerError(f"{_MAX_GOALS} results of goals have not been fetched: request them first")
        self._count += 1
        self._goals[self._count] = controller, controller.send_goal(trajectory)
        return self._count

    @_handler
    def goal(self, request: Request) -> Answer:
        """Progress of a goal, given by number, from 0 to 1, and its result, which is returned only once."""
        number = int(request.number("goal"))
        if number not in self._goals:
            raise ManagerError(f"this connection has no goal {number}, or its result has been returned already")
        controller, handle = self._goals[number]
        if handle.result is None:
            return {"progress": controller.progress}
        del self._goals[number]
        return {
            "progress": controller.progress,
            "error_code": int(handle.result.error_code),
            "error_string": handle.result.error_string,
        }

    @_handler
    def cancel_goal(self, request: Request) -> Answer:
        """Cancel a goal, given by number, if it is still under way."""
        if found := self._goals.get(int(request.number("goal"))):
            self._cancel(*found)

    @_handler
    def joint_trajectory(self, request: Request) -> Answer:
        """controller, trajectory: followed without a result, as from the ROS topic of the same name."""
        controller = self._follower(request)
        if not isinstance(controller, JointTrajectoryController):
            raise controller.error("it takes goals only")
        trajectory = _trajectory(request.group("trajectory"))
        controller.check_active()
        controller.check(trajectory)
        self._running.control.check_reach(trajectory, speeds=False)  # speeds are judged by the tolerances
        controller.command(trajectory)

    @_handler
    def forward_command(self, request: Request) -> Answer:
        """controller, values: commanded from now on. hold: only as long as this connection lasts.

        time_s: for positions, the duration of the motion, along a cubic; without it they are commanded immediately.
        """
        controller = self._manager.controller(request.text("controller"))
        if not isinstance(controller, ForwardCommandController):
            raise ControllerError(controller.name, f"{controller.type_name} takes no commands of this kind")
        values, time_s = request.numbers("values"), request.number("time_s", 0.0)
        controller.check_active()
        controller.check(values)
        if controller.interface_name == "position":
            end = JointTrajectoryPoint(values, (0.0,) * len(values), time_from_start_s=time_s)
            way = JointTrajectory(controller.parameters.joints, (end,))
            self._running.control.check_reach(way, speeds=time_s > 0.0)
        elif time_s:
            raise controller.error("time_s is for positions only")
        if time_s > 0.0:
            scaling = f"{self._running.control.prefix}speed_scaling/speed_scaling_factor"
            states = self._manager.hardware.states
            controller.go_to(values, time_s, lambda: states[scaling])
        else:
            controller.command(values)
        if request.flag("hold"):
            self._driven.add(controller)

    def _follower(self, request: Request) -> Follower:
        controller = self._manager.controller(request.text("controller"))
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
    def robot_state(self, request: Request) -> Answer:
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
    async def make_ready(self, request: Request) -> Answer:
        """Power the arm on, release its brakes, start the control program, as far as still necessary."""
        await self._running.control.robot.make_ready()

    @_handler
    async def set_speed_slider(self, request: Request) -> Answer:
        """fraction: 0.01 to 1."""
        fraction = request.number("fraction")
        if not 0.01 <= fraction <= 1.0:
            raise ManagerError(f"the speed slider takes 0.01 to 1, not {fraction:g}")
        await self._running.control.robot.set_speed_slider(fraction)

    @_handler
    async def begin_recording(self, request: Request) -> Answer:
        """path: absolute path of the file that records robot and trajectory controllers until this connection ends."""
        path = Path(request.text("path"))
        if not path.is_absolute():
            raise ManagerError(f"the path of a recording must be absolute, not {quoted(str(path))}")
        recorder = await self._recording.enter_async_context(recorded(self._running.control.driver, path))
        self._recording.callback(listen(recorder, self._manager))
        self._recorder = recorder

    @_handler
    def record_markers(self, request: Request) -> Answer:
        """topic, markers: fields of visualization_msgs/Marker, for 3D views; recorded with the present time."""
        if self._recorder is None:
            raise ManagerError("there is no recording for the markers: call begin_recording first")
        self._recorder.write_markers(request.text("topic"), request.mappings("markers"), self._manager.time_s)

    @_handler
    async def end_recording(self, request: Request) -> Answer:
        """End the recording; answered once the file is complete."""
        self._recorder = None
        await self._recording.aclose()


def available_types() -> Answer:
    """Types of controllers, with descriptions."""
    return {"types": {name: help_of(kind) for name, kind in sorted(CONTROLLER_TYPES.items())}}


def _trajectory(request: Request) -> JointTrajectory:
    points = tuple(
        JointTrajectoryPoint(
            **{part: point.numbers(part) for part in _POINT}, time_from_start_s=point.number("time_from_start_s", 0.0)
        )
        for point in request.groups("points")
    )
    return JointTrajectory(tuple(request.texts("joint_names")), points)
