"""The nodes ``robotiq_gripper_controller`` and ``robotiq_activation_controller`` for a Robotiq gripper on the arm.

Names, types, joints and units are those of PickNik's ros2_robotiq_gripper, and those of robotiq_hande_description for
the Hand-E; parameters, and when a goal has ended, are those of ros2_controllers' gripper controllers. The gripper is
read 20 times a second through its own port, far from the control loop, whose cycle is shorter than one answer.

Its joint is in the messages of joint_state_broadcaster, as officially. Separate messages on ``joint_states`` would be
lost among those of the arm, which come 500 times a second: many subscribers keep only the newest message.
"""

import asyncio
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from std_srvs.srv import Trigger

from client.errors import Ros2Error
from client.gripper import GripperClient, GripperState
from client.ros2.host import NodeHost, interface_if_any
from client.ros2.topics import PublishingContext
from urproto.errors import URError
from urproto.robotiq import FULL, MODELS, GripperModel, ObjectStatus, Status

NAME: Final = "robotiq_gripper_controller"
ACTIVATION: Final = "robotiq_activation_controller"
# types of the controller, by which its action has the one or the other type
_SINGLE: Final = "position_controllers/GripperActionController"
_PARALLEL: Final = "parallel_gripper_action_controller/GripperActionController"
_ACTIONS: Final = {
    _SINGLE: "control_msgs/action/GripperCommand",
    _PARALLEL: "control_msgs/action/ParallelGripperCommand",
}
# Source: ros2_robotiq_gripper; stall_timeout: ros2_controllers, because 0.05 s is hardly more than one read.
_PARAMETERS: Final[Mapping[str, Any]] = {
    "action_monitor_rate": 20.0,  # Hz
    "allow_stalling": True,
    "stall_velocity_threshold": 0.001,
    "stall_timeout": 1.0,  # s; an object that the gripper itself detects counts immediately
    "max_effort": 50.0,  # N, of goals without
    "max_velocity": 0.5,  # m/s, the same; faster than any of the models
}
_CANCELLED: Final = "cancelled"
_RETRY_S: Final = 1.0  # after an error (guess)
_FIXED: Final = ParameterDescriptor(read_only=True)
_RATE: Final = ParameterDescriptor(
    read_only=True, floating_point_range=[FloatingPointRange(from_value=0.1, to_value=1000.0)]
)


@dataclass(frozen=True, slots=True)
class _Joint:
    """The joint that stands for the fingers [rad, or m if prismatic]. tolerance: default of goal_tolerance."""

    name: str
    opened: float
    closed: float
    tolerance: float = 0.02

    def position(self, model: GripperModel, count: float) -> float:
        return self.closed + (self.opened - self.closed) * model.width_mm(count) / model.stroke_mm

    def count(self, model: GripperModel, position: float) -> int:
        share = (position - self.closed) / (self.opened - self.closed)
        return round(min(max(model.count(model.stroke_mm * share), 0), FULL))


_JOINTS: Final[Mapping[str, _Joint]] = {
    "robotiq-2f-85": _Joint("robotiq_85_left_knuckle_joint", 0.0, 0.7929),
    "robotiq-2f-140": _Joint("finger_joint", 0.0, 0.695),
    "robotiq-hand-e": _Joint("robotiq_hande_left_finger_joint", 0.025, 0.0, 0.001),
}


@dataclass(frozen=True, slots=True)
class _Command:
    """What a goal requests; max_effort [N] and max_velocity [m/s]: 0 or less for the parameters of these names."""

    position: float
    max_effort: float = 0.0
    max_velocity: float = 0.0

    @classmethod
    def of(cls, command: Any) -> "_Command | None":
        """The command of a goal of either type; None if it is not one position."""
        if hasattr(command, "max_effort"):
            one = cls(command.position, command.max_effort)
        elif len(command.position) == 1:
            limits = (values[0] if values else 0.0 for values in (command.effort, command.velocity))
            one = cls(command.position[0], *limits)
        else:
            return None
        return one if all(map(math.isfinite, (one.position, one.max_effort, one.max_velocity))) else None


class _Goal:
    """A goal under way. count: of its position. moved_ns: when the fingers moved last; None until it is sent."""

    def __init__(self, handle: Any, command: _Command, count: int) -> None:
        self.handle = handle
        self.command = command
        self.count = count
        self.moved_ns: int | None = None
        self.stalled = self.reached = False
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def end(self, why: str = "", *, stalled: bool = False, reached: bool = False) -> None:
        """End it. why: the reason if it does not succeed."""
        if not self.ended.done():
            self.stalled, self.reached = stalled, reached
            self.ended.set_result(why)


class GripperNode:
    """Both nodes; they spin from their creation until `close`, which leaves the fingers as they are.

    name: of a model in `urproto.robotiq.MODELS`. scene: gets the joint while the gripper answers. A gripper that is not
    active when it answers for the first time is activated. A new goal replaces the one under way, which is aborted.
    """

    def __init__(self, host: NodeHost, client: GripperClient, name: str, scene: PublishingContext) -> None:
        self.node = host.node(NAME)
        self._host = host
        self._client = client
        self._scene = scene
        self._model, self._joint = MODELS[name], _JOINTS[name]
        declare = self.node.declare_parameter
        self._joint_name = str(declare("joint", scene.prefix + self._joint.name, _FIXED).value)
        kind = declare("type", _SINGLE, _FIXED).value
        for parameter, value in {**_PARAMETERS, "goal_tolerance": self._joint.tolerance}.items():
            declare(parameter, value, _RATE if parameter == "action_monitor_rate" else None)
        self._problem = "it has not answered yet"  # why there are no goals; empty if nothing is wrong
        self._position, self._velocity, self._read_ns = math.nan, 0.0, 0
        self._activating = False
        self._goal: _Goal | None = None
        self._action = interface_if_any(_ACTIONS.get(str(kind), "control_msgs/action/"))
        if self._action is None:
            raise Ros2Error(f"{NAME}: the type {kind} is not offered: choose {_SINGLE}")
        self._server: ActionServer | None = None  # until the gripper is active, as officially
        self._activation = host.node(ACTIVATION)
        self._advice = f"call {self._activation.get_fully_qualified_name()}/reactivate_gripper"
        self._activation.create_service(Trigger, "~/reactivate_gripper", self._reactivate)
        host.spin(self.node)
        host.spin(self._activation)
        self._following = host.task(self.node, self._follow())

    def close(self) -> None:
        """End the nodes; goals under way are abandoned."""
        for node in (self._activation, self.node):
            self._host.close(node)

    def _parameter(self, name: str) -> Any:
        return self.node.get_parameter(name).value

    # in the nodes' threads

    def _accept(self, request: Any) -> GoalResponse:
        why = self._problem
        if _Command.of(request.command) is None:
            why = "it needs exactly one position, and only finite numbers"
        if why:
            self.node.get_logger().error(f"gripper_cmd: goal rejected: {why}")
        return GoalResponse.REJECT if why else GoalResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        goal, why = await self._host.task(self.node, self._carry_out(handle))
        if why == _CANCELLED:
            handle.canceled()
        elif why:
            self.node.get_logger().error(f"gripper_cmd: {why}")
            handle.abort()
        else:
            handle.succeed()
        return self._filled(self._action.Result(), goal)

    def _cancel(self, handle: Any) -> CancelResponse:
        self._host.task(self.node, self._stop(handle))
        return CancelResponse.ACCEPT

    async def _reactivate(self, request: Any, response: Any) -> Any:
        why = await self._host.task(self._activation, self._activate())
        response.success, response.message = not why, why or "the gripper is active"
        return response

    # in the event loop

    async def _carry_out(self, handle: Any) -> tuple[_Goal, str]:
        """Carry out a goal; return it, and why it did not succeed."""
        command, model = _Command.of(handle.request.command), self._model
        assert command is not None
        goal, before = _Goal(handle, command, self._joint.count(model, command.position)), self._goal
        if before is not None:
            before.end("replaced by a new goal")
        if handle.is_cancel_requested:
            return goal, _CANCELLED
        self._goal = goal
        speed_m_s = command.max_velocity if command.max_velocity > 0.0 else self._parameter("max_velocity")
        effort_n = command.max_effort if command.max_effort > 0.0 else self._parameter("max_effort")
        try:
            await self._client.move(goal.count, model.spe(1e3 * speed_m_s), model.force(effort_n))
            goal.moved_ns = self._host.now_ns()
            return goal, await goal.ended
        except URError as error:
            return goal, str(error)
        finally:
            if self._goal is goal:
                self._goal = None

    async def _stop(self, handle: Any) -> None:
        """Stop the fingers and end a goal, unless another one has replaced it."""
        goal = self._goal
        if goal is None or goal.handle is not handle:
            return
        try:
            await self._client.stop()
        except URError as error:
            goal.end(f"the fingers were not stopped: {error}")
        else:
            goal.end(_CANCELLED)

    async def _activate(self) -> str:
        """Reset and activate the gripper; return why it could not be, empty if it is active."""
        try:
            self._activating = True
            await self._client.activate()
            self._activating = False
            self._update(await self._client.state())
        except URError as error:
            self._activation.get_logger().error(f"reactivate_gripper: {error}")
            return str(error)
        finally:
            self._activating = False
        return ""

    async def _follow(self) -> None:
        """Read the gripper's state again and again."""
        answered = False
        while True:
            pause_s = 1.0 / self._parameter("action_monitor_rate")
            try:
                state = await self._client.state()
            except URError as error:
                pause_s = _RETRY_S
                self._scene.joints.pop(self._joint_name, None)
                self._note(str(error))
            else:
                if not answered and state.status is Status.RESET:
                    self._host.task(self._activation, self._activate())
                else:
                    self._update(state)
                answered = True
            await asyncio.sleep(pause_s)

    def _note(self, problem: str) -> None:
        """Note what keeps the gripper from moving; empty for nothing. A new problem is logged."""
        if problem and problem != self._problem:
            self.node.get_logger().warning(problem)
        self._problem = problem
        if problem and self._goal is not None:
            self._goal.end(problem)

    def _update(self, state: GripperState) -> None:
        now_ns, position = self._host.now_ns(), self._joint.position(self._model, state.position_count)
        if now_ns > self._read_ns:  # otherwise the robot's time stands still
            since_s = (now_ns - self._read_ns) * 1e-9
            self._velocity = 0.0 if math.isnan(self._position) else (position - self._position) / since_s
            self._read_ns = now_ns
        self._position = position
        self._scene.joints[self._joint_name] = position, self._velocity
        if self._activating or state.status is Status.ACTIVATING:
            self._note("the gripper is being activated: wait")
        else:
            self._note(f"the gripper {state.problem}: {self._advice}" if state.problem else "")
        if self._server is None and not self._problem:
            self._serve()
        if self._goal is not None and self._goal.moved_ns is not None:
            self._check(self._goal, state, now_ns)

    def _serve(self) -> None:
        self.node.get_logger().info(f"the {self._model.title} is active")
        callbacks = {"goal_callback": self._accept, "cancel_callback": self._cancel}
        self._server = ActionServer(self.node, self._action, "~/gripper_cmd", self._execute, **callbacks)

    def _check(self, goal: _Goal, state: GripperState, now_ns: int) -> None:
        """End a goal that is reached or stalled; publish the feedback of another."""
        assert goal.moved_ns is not None
        if abs(goal.command.position - self._position) < self._parameter("goal_tolerance"):
            return goal.end(reached=True)
        moving = state.object_status is ObjectStatus.MOVING
        if moving or abs(self._velocity) > self._parameter("stall_velocity_threshold"):
            goal.moved_ns = now_ns
        held = state.holds_object and state.requested_count == goal.count
        if held or now_ns - goal.moved_ns > 1e9 * self._parameter("stall_timeout"):
            where = f"the fingers stand at {self._position:.4f}, not at {goal.command.position:.4f}"
            return goal.end("" if self._parameter("allow_stalling") else where, stalled=True)
        if goal.handle.is_active:
            goal.handle.publish_feedback(self._filled(self._action.Feedback(), goal))
        return None

    def _filled(self, message: Any, goal: _Goal) -> Any:
        """Fill a result or feedback of either type; the gripper does not measure the effort."""
        if hasattr(message, "state"):
            message.state.name = [self._joint_name]
            message.state.position, message.state.velocity = [self._position], [self._velocity]
            message.state.effort = [0.0]
        else:
            message.position = self._position
        if hasattr(message, "stalled"):
            message.stalled, message.reached_goal = goal.stalled, goal.reached
        return message
