"""The control loop as the nodes see it: everything that they call in its process.

Nodes call its methods through `NodeHost.do` and `NodeHost.call`, with `SIDE` as first argument. Methods that do not
wait are executed between two cycles. Like `client.ros2.remote_calls`, this module is free of rclpy.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from itertools import count
from operator import attrgetter
from typing import Any, Final

from client.calibration import calibrated_model, calibration_of
from client.controllers.calls import Call
from client.controllers.compliance import ToolContactController
from client.controllers.controller import Controller, Topic
from client.controllers.goals import (
    Feedback,
    FollowJointTrajectory,
    GoalHandle,
    GoalStatus,
    JointTrajectory,
    MotionPrimitive,
    Result,
)
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.manager import ControllerManager
from client.controllers.passthrough import PassthroughTrajectoryController
from client.controllers.running import Change, ManagerOptions, RunningManager, reached
from client.controllers.serving import ManagerServer, claim
from client.controllers.servo import Servo
from client.controllers.session import Session
from client.driver import DriverConfig
from client.driver.scheduling import real_time
from client.errors import ClientError, ControllerError
from client.robot import AsyncRobot
from client.ros2.mode_setter import ModeRequest, ModeSetter
from client.ros2.remote_calls import Callee, Reference
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.robots import RobotModel
from urproto.versions import PolyscopeVersion

SIDE: Final[Any] = Reference("")
"""Stands for the `ControlSide` in calls of its methods; the following stand for parts of it."""
RUNNING: Final[Any] = Reference("running")
SESSION: Final[Any] = Reference("session")
STATES: Final[Any] = Reference("running.manager.hardware.states")
LINK: Final[Any] = Reference("robot.driver.link")
FEED: Final[Any] = Reference("robot.driver.link.feed")
SERVO: Final[Any] = Reference("servo")

CLOCK: Final = "clock"
"""Key of the messages with the robot's time [s], which come with those of each cycle if it is ROS' time."""
SERVO_STATUS: Final = "servo status"
"""Key of the messages with the status of `ControlSide.servo` when it changes."""

_ANSWER_S: Final = 15.0  # above what starting the control program may take; guess
_ACTIVE_S: Final = 2.0  # guess: once the program runs, controllers are activated within a few cycles
_FEEDBACK_S: Final = 0.05  # action_monitor_rate is 20 Hz
_MAX_CYCLES: Final = 10_000  # between two messages of diagnostics; guess: a message is never later than this
_START_RAD: Final = 0.01  # MoveIt's allowed_start_tolerance
_FOLLOWING: Final = (JointTrajectoryController, PassthroughTrajectoryController)


@dataclass(frozen=True)
class ControllerFacts:
    """A loaded controller. joints: of a controller that follows trajectories. active: when it was described."""

    name: str
    kind: type[Controller[Any]]
    parameters: Any
    joints: tuple[str, ...]
    active: bool

    @classmethod
    def of(cls, controller: Controller[Any]) -> Self:
        joints = tuple(getattr(controller, "joints", ()))
        return cls(controller.name, type(controller), controller.parameters, joints, controller.active)


@dataclass(frozen=True)
class RobotFacts:
    """What nodes have to know of a robot. model: None if unknown. states: names of all state interfaces.

    types: of the controllers in the controllers file. component: name of the hardware component.
    """

    config: DriverConfig
    version: PolyscopeVersion
    model: RobotModel | None
    states: tuple[str, ...]
    update_rate_hz: float
    types: Mapping[str, str]
    component: str
    controllers: tuple[ControllerFacts, ...]


class ControlSide:
    """Runs the controllers of a robot once `start` is called; close it with `aclose`. calls: executes the calls."""

    def __init__(self) -> None:
        self.calls = Callee(self._resolve)
        self.robot: AsyncRobot
        self.running: RunningManager
        self.session: Session
        self.servo: Servo | None = None  # of an arm whose model is known
        self._opened = AsyncExitStack()
        self._changes: asyncio.Queue[Any] = asyncio.Queue()
        self._change_done: asyncio.Future[None] | None = None
        self._subscriptions: dict[Hashable, Callable[[], None]] = {}
        self._goals: dict[int, tuple[Any, GoalHandle | Call]] = {}
        self._numbers = count(1)
        self._times_s: deque[float] = deque(maxlen=_MAX_CYCLES)  # of the cycles since the last diagnostics
        self._use_sim_time = False

    async def aclose(self) -> None:
        """Bring the arm to rest, and close everything."""
        await self._opened.aclose()

    def _resolve(self, key: Any) -> Any:
        """A part of this object by its path, or a controller by its name."""
        if isinstance(key, str):
            return attrgetter(key)(self) if key else self
        return self._manager.controller(*key)

    @property
    def _manager(self) -> ControllerManager:
        return self.running.manager

    # life cycle

    async def start(self, options: ManagerOptions, use_sim_time: bool = False) -> RobotFacts:
        """Connect to the robot and run its controllers, as soon as it answers. use_sim_time: its time is that of ROS.

        If the control program runs, the controller that is to move the arm is active already.
        """
        async with AsyncExitStack() as opening:
            place = opening.enter_context(claim(options.robot_ip, options.rtde_port))
            control = await opening.enter_async_context(reached(options))
            self.robot, self.running = control.robot, RunningManager(control, headless=options.headless)
            link = control.driver.link
            arm = link.configuration
            model = calibrated_model(arm, calibration_of(await link.kinematics())) if arm else None
            loaded = self.running.load_all()
            self.running.on_change.append(self._on_change)
            self._manager.on_cycle.append(lambda: self._times_s.append(self._manager.time_s))
            if use_sim_time:
                self._use_sim_time = True
                self._manager.on_cycle.append(self._publish_time)
            if model is not None:
                self._start_servo(model, options.tf_prefix)
            self.session = Session(self.running)
            opening.push_async_callback(self.session.close)
            opening.enter_context(real_time(control.driver.config.realtime))
            await opening.enter_async_context(self.running.at_work(options))
            await opening.enter_async_context(ManagerServer(self.running, place))
            if (initial := options.initial_controller) and control.driver.program_running:
                await self._wait_active(initial)
            self._opened = opening.pop_all()
        manager = self._manager
        return RobotFacts(
            control.driver.config,
            control.driver.version,
            model,
            manager.hardware.states.names,
            manager.update_rate_hz,
            dict(manager.file.types),
            self.running.component.name,
            tuple(map(ControllerFacts.of, loaded)),
        )

    def _start_servo(self, model: RobotModel, prefix: str) -> None:
        self.servo = Servo(self._manager, model, prefix)
        self.servo.on_status.append(lambda status: self.calls.publish(SERVO_STATUS, lambda: status))
        self._manager.on_cycle.append(self.servo.update)

    async def _wait_active(self, name: str) -> None:
        controller = self._manager.controller(name)
        with suppress(TimeoutError):
            async with timeout(_ACTIVE_S):
                while not controller.active:
                    await self.running.control.cycles()

    # controllers

    async def _on_change(self, controller: Controller[Any], change: Change, values: Mapping[str, Any]) -> None:
        """Wait until the nodes have followed: whoever has loaded a controller finds its node."""
        done = asyncio.get_running_loop().create_future()
        self._changes.put_nowait((ControllerFacts.of(controller), change, dict(values), done))
        await done

    async def next_change(self) -> tuple[ControllerFacts, Change, dict[str, Any]]:
        """Wait for the next change of a controller; the nodes have followed the one before."""
        if self._change_done is not None and not self._change_done.done():
            self._change_done.set_result(None)
        *change, self._change_done = await self._changes.get()
        return tuple(change)

    def states(self) -> tuple[list[tuple[str, str]], str]:
        """States of all controllers, by name, and of the hardware component."""
        infos = self._manager.list_controllers()
        return [(info.name, str(info.state)) for info in infos], str(self.running.component.state)

    def take_cycle_times(self) -> list[float]:
        """The robot's time of each cycle since the last call [s]."""
        times_s = list(self._times_s)
        self._times_s.clear()
        return times_s

    async def answer(self, method: Callable[..., Call], controller: Any, *args: Any, **kwargs: Any) -> None:
        """Send a request to the robot and wait for its answer. Raises ControllerError."""
        call = method(controller, *args, **kwargs)
        try:
            async with timeout(_ANSWER_S):
                await self.running.control.answer(call)
        except TimeoutError:
            call.end(False)
            raise ControllerError(controller.name, f"the robot does not answer within {_ANSWER_S:g} s") from None

    def deliver(self, controller: Any, hand_over: Callable[[Any, Any], object], command: Any) -> None:
        """Pass a command to a controller. Raises ClientError for one that is refused."""
        if isinstance(command, JointTrajectory):
            self._check(controller, command)
        hand_over(controller, command)

    def _check(self, controller: Any, trajectory: JointTrajectory) -> None:
        controller.check_active()
        controller.check(trajectory)
        control = self.running.control
        control.check_reach(trajectory, speeds=False)  # speeds: by tolerances, as in ros2_controllers

    # topics

    def subscribe(
        self,
        key: Hashable,
        controller: Any,
        source: str,
        every_s: float,
        latched: bool,
        all_states: bool,
    ) -> None:
        """Send a topic's messages from now on, at most one in ``every_s`` of robot time; latched: its newest, too.

        all_states: send the values of all state interfaces instead.
        """
        self.unsubscribe(key)
        topic: Topic[Any] = getattr(controller, source)
        due = _Pace(every_s)

        def publish(message: Any) -> None:
            if due.is_time(self._manager.time_s):
                self.calls.publish(key, self._manager.hardware.states.get if all_states else lambda: message)

        self._subscriptions[key] = topic.subscribe(publish)
        if latched and topic.latest is not None:
            publish(topic.latest)

    def unsubscribe(self, key: Hashable) -> None:
        """Send no more messages of a topic."""
        if (end := self._subscriptions.pop(key, None)) is not None:
            end()
        self.calls.withdraw(key)

    # goals

    def begin_trajectory(self, controller: Any, goal: FollowJointTrajectory) -> int:
        """Send a goal to a trajectory controller; returns its number. Raises ClientError for a goal that is refused."""
        self._check(controller, goal.trajectory)
        handle: GoalHandle = controller.send_goal(goal)
        number, due = self._add_goal(controller, handle), _Pace(_FEEDBACK_S)

        def publish(progress: Feedback) -> None:
            if due.is_time(progress.time_s):
                self.calls.publish(feedback_key(number), lambda: progress)

        handle.on_feedback.append(publish)
        return number

    def begin_primitives(self, controller: Any, primitives: Sequence[MotionPrimitive]) -> int:
        """The same for a sequence of motion primitives."""
        controller.check_active()
        controller.check(primitives)
        self.running.control.check_primitives(primitives)
        return self._add_goal(controller, controller.send_goal(primitives))

    def begin_contact(self, controller: ToolContactController) -> int:
        """The same for tool contact detection."""
        return self._add_goal(controller, controller.detect_tool_contact())

    def _add_goal(self, controller: Any, goal: GoalHandle | Call) -> int:
        number = next(self._numbers)
        self._goals[number] = controller, goal
        return number

    async def end_of(self, number: int) -> tuple[GoalStatus, Result]:
        """Wait for the end of a goal; it is reported once."""
        try:
            _, handle = self._goals[number]
            assert isinstance(handle, GoalHandle)
            result = await self.running.control.result(handle)
            return handle.status, result
        finally:
            del self._goals[number]

    async def end_of_contact(self, number: int) -> None:
        """Wait until tool contact detection has succeeded. Raises ControllerError if it ends in another way."""
        try:
            _, call = self._goals[number]
            assert isinstance(call, Call)
            await self.running.control.answer(call)
        finally:
            del self._goals[number]

    def cancel(self, number: int) -> None:
        """Cancel a goal, unless it was replaced or has ended. Raises ControllerError."""
        controller, goal = self._goals.get(number, (None, None))
        if controller is not None and (isinstance(goal, Call) or controller.goal is goal):
            controller.cancel()

    async def follow(self, names: Sequence[str], trajectory: JointTrajectory) -> tuple[str, GoalStatus, Result]:
        """Follow a trajectory with the active controller, or with the one named; canceled with this call.

        A first point at 0 s is where the arm must be. Returns the controller's name. Raises ClientError.
        """
        controller = self._following(names)
        points = trajectory.points
        if points and points[0].time_from_start_s == 0.0:
            self._check_start(trajectory)
            points = points[1:] or points
        goal = JointTrajectory(trajectory.joint_names, points, trajectory.stamp_s)
        self._check(controller, goal)
        handle: GoalHandle = controller.send_goal(FollowJointTrajectory(goal))
        try:
            result = await self.running.control.result(handle)
            return controller.name, handle.status, result
        finally:
            if controller.goal is handle and not handle.done:
                controller.cancel()

    def _following(self, names: Sequence[str]) -> Any:
        following = {one.name: one for one in self._manager.active() if isinstance(one, _FOLLOWING)}
        wanted = [one for name, one in following.items() if not names or name in names]
        if len(names) > 1 or not wanted:
            raise ClientError(
                f"no trajectory controller {' and '.join(names) or 'of any name'} is active; "
                f"{', '.join(following) or 'none'} is: switch with /controller_manager/switch_controller"
            )
        return wanted[0]

    def _check_start(self, given: JointTrajectory) -> None:
        control = self.running.control
        current = dict(zip(control.joints, control.driver.state["actual_q"], strict=True))
        begins = dict(zip(given.joint_names, given.points[0].positions, strict=False))
        for name, q in begins.items():
            if abs(q - current.get(name, q)) > _START_RAD:
                raise ClientError(
                    f"{name} is at {current[name]:.4f} rad, but the trajectory begins at {q:.4f}: it has moved "
                    "since; plan again from where it is"
                )

    # the robot

    def robot_time(self) -> tuple[float, int]:
        """The current time by the robot's clock [s] and that of ROS [ns]: the same, or this machine's since 1970."""
        time_s = self._manager.time_s
        return time_s, round(time_s * 1e9) if self._use_sim_time else time.time_ns()

    def _publish_time(self) -> None:
        time_s = self._manager.time_s
        self.calls.publish(CLOCK, lambda: time_s)

    def configuration(self) -> tuple[float, ...]:
        """The current joint angles [rad]. Raises StaleStateError."""
        return tuple(map(float, self.robot.driver.link.feed.fresh()["actual_q"]))

    async def set_mode(self, feedback: Hashable, request: ModeRequest) -> None:
        """Bring the arm to a mode. feedback: key of the messages with its modes. Raises URError."""
        setter = ModeSetter(self.robot.driver, request)
        await setter.execute(lambda modes: self.calls.publish(feedback, lambda: modes))


def feedback_key(number: int) -> Hashable:
    """Key of the messages that report the progress of a goal, given by number."""
    return "feedback", number


class _Pace:
    """When a message is due of those that come every cycle; every_s: interval by the robot's clock."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._next_s = 0.0

    def is_time(self, time_s: float) -> bool:
        """Whether enough time has passed since the last message; if so, this one counts as sent."""
        wait_s = self._next_s - time_s
        if 0.0 < wait_s <= self._every_s:
            return False
        in_step = -self._every_s < wait_s <= 0.0  # otherwise: no subscribers for a while, or a jump of the clock
        self._next_s = (self._next_s if in_step else time_s) + self._every_s
        return True
