"""Control of a robot by controllers: connects, makes the robot ready, and runs the control loop.

async with RobotControl("192.168.1.10", make_ready=True) as control:
    control.activate("scaled_joint_trajectory_controller")
    result = await control.follow("scaled_joint_trajectory_controller", trajectory)
"""

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar

from client.controllers.configuration import ControllersFile
from client.controllers.controller import LifecycleState
from client.controllers.goals import (
    FollowJointTrajectory,
    JointTrajectory,
    JointTrajectoryPoint,
    MotionPrimitive,
    Result,
)
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.loop import ControlLoop
from client.controllers.manager import ControllerManager
from client.controllers.motion_primitives import point_of
from client.controllers.ur_states import RTDE_OUTPUTS
from client.driver import URDriver, points
from client.errors import MotionError
from client.recording import DEFAULT_FIELDS, BackgroundRecorder
from client.robot import AsyncRobot
from client.robot.reach import Reach, reach_of
from urproto.compat import Self
from urproto.joints import JOINT_NAMES

_WITH_CONTROLLERS = ".mcap"  # other formats cannot store controller states
_SMOOTH: Final = 1.5  # ratio of the maximum to the mean speed of a cubic from rest to rest


@asynccontextmanager
async def recorded(driver: URDriver, path: Path) -> AsyncIterator[BackgroundRecorder]:
    """Record the robot's states for the duration of the context; the driver must receive `DEFAULT_FIELDS`.

    A separate process writes the file, so that the control loop is not delayed. Raises RecordingError.
    """
    info = {"robot": driver.config.host, "polyscope": str(driver.version)}
    recorder = await asyncio.to_thread(BackgroundRecorder, path, DEFAULT_FIELDS, info)
    driver.link.on_state.append(recorder.write)
    try:
        yield recorder
    finally:
        driver.link.on_state.remove(recorder.write)
        await asyncio.to_thread(recorder.close)


def listen(recorder: BackgroundRecorder, manager: ControllerManager) -> Callable[[], None]:
    """Also record the states of all trajectory controllers, loaded now or later. Returns a function that ends this."""
    ends: list[Callable[[], None]] = []

    def begin(controller: object) -> None:
        if isinstance(controller, JointTrajectoryController):
            name = controller.name
            ends.append(controller.state_topic.subscribe(lambda state: recorder.write_controller(name, state)))

    def end() -> None:
        manager.on_load.remove(begin)
        for unsubscribe in ends:
            unsubscribe()

    if recorder.path.suffix.lower() != _WITH_CONTROLLERS:
        return lambda: None
    manager.on_load.append(begin)
    for info in manager.list_controllers():
        begin(manager.controller(info.name))
    return end


Answer = TypeVar("Answer")


class RobotControl(ControlLoop):
    """A control loop that also connects to its robot; options are those of `client.driver.DriverConfig`.

    make_ready: power the arm on and release its brakes if necessary; without it, a robot that is not ready raises
    RobotRefused. start: start the control program; without it, the arm cannot move until the program is started in
    another way. file: the controllers file; None for the usual controllers. record: a file that records the robot and
    its trajectory controllers (.mcap; .csv and .npz contain the robot only).
    """

    def __init__(
        self,
        host: str,
        file: ControllersFile | None = None,
        *,
        prefix: str = "",
        make_ready: bool = False,
        start: bool = True,
        record: Path | str | None = None,
        **options: Any,
    ) -> None:
        wanted = DEFAULT_FIELDS if record else ()
        outputs = tuple(dict.fromkeys((*RTDE_OUTPUTS, *wanted, *options.pop("outputs", ()))))
        self.robot = AsyncRobot(host, outputs=outputs, **options)
        super().__init__(self.robot.driver, file, prefix=prefix)
        self._make_ready = make_ready
        self._start = start
        self._record = Path(record) if record else None
        self._opened = AsyncExitStack()

    async def __aenter__(self) -> Self:
        async with AsyncExitStack() as opening:
            await opening.enter_async_context(self.robot)
            if self._make_ready:
                await self.robot.make_ready(program=self._start)
            elif self._start:
                await self.driver.start_program()
            recorder = None
            if self._record is not None:
                recorder = await opening.enter_async_context(recorded(self.driver, self._record))
            await super().__aenter__()
            if recorder is not None:
                listen(recorder, self.manager)
            self._opened = opening.pop_all()
        return self

    async def __aexit__(self, *reason: object) -> None:
        try:
            await super().__aexit__(*reason)
        finally:
            await self._opened.aclose()

    async def follow(self, name: str, goal: FollowJointTrajectory | JointTrajectory) -> Result:
        """Like `ControlLoop.follow`, but check the joint limits before anything moves.

        Raises OutOfReachError for angles, and MotionError for speeds, beyond the limits.
        """
        self.check_reach(goal.trajectory if isinstance(goal, FollowJointTrajectory) else goal)
        return await super().follow(name, goal)

    def check_reach(self, trajectory: JointTrajectory, *, speeds: bool = True) -> None:
        """Raise OutOfReachError or MotionError for the first point beyond the limits that the robot reports.

        speeds: also check that no joint needs more than its maximum speed between two points.
        """
        link = self.driver.link
        if link.configuration is None:
            return
        current = dict(zip((self.prefix + joint for joint in JOINT_NAMES), self.driver.state["actual_q"], strict=True))
        names = trajectory.joint_names
        targets = [current | dict(zip(names, point.positions, strict=False)) for point in trajectory.points]
        moves = [points.movej([target[joint] for joint in current]) for target in targets]
        Reach(link.configuration, (0.0,) * 6, tuple(current.values())).check("the trajectory", moves)
        if not speeds:
            return
        start = JointTrajectoryPoint((), (0.0,) * len(names))
        check_speeds([current, *targets], [start, *trajectory.points], link.configuration.qd_max)

    def check_primitives(self, primitives: Sequence[MotionPrimitive]) -> None:
        """Raise OutOfReachError for the first primitive out of reach, and LocalProtocolError for numbers too large.

        The primitives must have passed their controller's ``check``.
        """
        moves = [point_of(primitive) for primitive in primitives]
        for move in moves:
            move.encode()
        if reach := reach_of(self.driver.link, self.driver.state["actual_q"]):
            reach.check("the sequence", moves)

    def activate(self, *names: str) -> None:
        """Load, configure and activate controllers. Raises ControllerError."""
        self.manager.activate(*names)

    def deactivate(self, *names: str) -> None:
        """Deactivate controllers. Raises ControllerError."""
        self.manager.deactivate(*names)

    def switch(self, activate: Sequence[str] = (), deactivate: Sequence[str] = ()) -> None:
        """Deactivate some controllers and activate others in one cycle, loading them first. Raises ControllerError."""
        loaded = {info.name: info.state for info in self.manager.list_controllers()}
        for name in activate:
            if name not in loaded:
                self.manager.load(name)
            if loaded.get(name, LifecycleState.UNCONFIGURED) is LifecycleState.UNCONFIGURED:
                self.manager.configure(name)
        self.manager.switch(activate=activate, deactivate=deactivate)

    def command(self, name: str, values: Sequence[float] | JointTrajectory) -> None:
        """Send commands to a forward controller, or a trajectory without a result to a trajectory controller."""
        self.manager.controller(name).command(values)

    def do(self, work: Callable[[ControllerManager], Answer]) -> Answer:
        """Call ``work`` with the manager, between two cycles, and return its result."""
        return work(self.manager)


def check_speeds(
    places: Sequence[Mapping[str, float]], points: Sequence[JointTrajectoryPoint], limits_rad_s: Sequence[float]
) -> None:
    """Raise MotionError if a joint needs more than its maximum speed from one point to the next.

    places: joint angles of the points, by joint. Between two points at rest the speed of a cubic counts, otherwise the
    mean speed.
    """
    for (before, begin), (after, end) in pairwise(zip(places, points, strict=True)):
        time_s = end.time_from_start_s - begin.time_from_start_s
        factor = _SMOOTH if _rests(begin) and _rests(end) else 1.0
        for (joint, q), limit in zip(after.items(), limits_rad_s, strict=True):
            angle_rad = abs(q - before[joint])
            if limit > 0.0 and factor * angle_rad > limit * time_s:
                raise MotionError(
                    "the trajectory",
                    f"{joint} has {time_s:g} s for {angle_rad:.2f} rad, and its limit is {limit:.2f} rad/s: "
                    f"give it {math.ceil(20.0 * _SMOOTH * angle_rad / limit) / 20.0:g} s or more",
                )


def _rests(point: JointTrajectoryPoint) -> bool:
    return bool(point.velocities) and not any(point.velocities)
