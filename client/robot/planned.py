"""Motions planned around obstacles in a scene, then executed by the robot as one trajectory.

Needs the extra ``plan``; nothing else in this package loads it.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from client.blocking import thread_safe
from client.calibration import require_model
from client.errors import PathBlockedError, PlanningError
from client.quantities import checked
from client.robot.motion import MotionRunner
from client.robot.moves import Moves
from client.robot.state import RobotState
from urproto.external_control import TrajectoryPoint
from urproto.robots import Joints, RobotModel
from urproto.robots.pose import Pose

if TYPE_CHECKING:
    from client.planning import CartesianPath, Goal, MotionSequenceItem, Plan, Planner, PlanningScene

_CHECK_PERIOD_S: Final = 0.05  # between checks whether the scene has changed; guess


@checked
class PlannedMotion:
    """Plans for the arm that the robot reports, from its current configuration, and executes the plans."""

    def __init__(self, motion: MotionRunner, moves: Moves) -> None:
        self._motion = motion
        self._driver = motion.driver
        self._moves = moves

    async def model(self) -> RobotModel:
        """The arm for a `PlanningScene`, calibrated if the robot is. Raises PlanningError for an unknown arm."""
        return require_model(self._driver.link.configuration, await self._driver.link.kinematics())

    @thread_safe
    def tcp_offset(self) -> Pose:
        """Flange to the robot's TCP. Raises PlanningError before the robot has reported it."""
        state = self._driver.link.primary_state
        if state is None or state.cartesian is None:
            raise PlanningError("the robot has not reported its TCP yet: give the tcp_offset")
        return state.cartesian.tcp_offset

    async def plan(self, goal: "Goal", scene: "PlanningScene", /, **options: Any) -> "Plan":
        """Plan from the current configuration. Options are those of `client.planning.Planner` and its method ``plan``.

        A pose goal without a TCP refers to the robot's TCP. Other tasks run meanwhile. Raises PlanningError.
        """
        planner = _planner(scene, options)
        return await asyncio.to_thread(planner.plan, await self._q_rad(), self._with_tcp(goal), **options)

    async def plan_sequence(
        self, items: "Sequence[MotionSequenceItem]", scene: "PlanningScene", /, **options: Any
    ) -> "Plan":
        """Plan several motions from the current configuration; see `client.planning.Planner.plan_sequence`."""
        planner = _planner(scene, options)
        items = [replace(item, goal=self._with_tcp(item.goal)) for item in items]
        return await asyncio.to_thread(planner.plan_sequence, await self._q_rad(), items, **options)

    async def compute_cartesian_path(
        self, waypoints: Sequence[Sequence[float]], scene: "PlanningScene", /, *args: Any, **options: Any
    ) -> "CartesianPath":
        """Plan straight lines from waypoint to waypoint; see `client.planning.Planner.compute_cartesian_path`.

        The waypoints are poses of the robot's TCP unless ``tcp_offset`` is given.
        """
        planner = _planner(scene, options)
        options["tcp_offset"] = options.get("tcp_offset") or self.tcp_offset()
        return await asyncio.to_thread(planner.compute_cartesian_path, await self._q_rad(), waypoints, *args, **options)

    async def execute(self, plan: "Plan", *, wait: bool = True) -> None:
        """Execute a plan. Raises PlanningError if the arm is not at the start of the plan."""
        plan.check_start(await self._q_rad())
        trajectory = plan.trajectory
        if len(trajectory.times_s) < 2:
            if plan.stopped_by:
                raise PlanningError(f"the plan is empty: {plan.stopped_by}")
            return  # the arm is already at the goal
        steps = zip(
            trajectory.q[1:],
            trajectory.qd[1:],
            trajectory.qdd[1:],
            trajectory.times_s[1:] - trajectory.times_s[:-1],
            strict=True,
        )
        points = [
            TrajectoryPoint.spline(q.tolist(), qd.tolist(), float(step), qdd.tolist()) for q, qd, qdd, step in steps
        ]
        await self._moves.execute("plan_to", points, wait)

    async def plan_to(
        self, goal: "Goal", scene: "PlanningScene", /, *, wait: bool = True, replan: int = 0, **options: Any
    ) -> None:
        """Move to a goal on a collision-free path in the scene; options are those of `PlannedMotion.plan`.

        If another task changes the scene so that the rest of the path is blocked, the arm stops and continues on
        another path, at most ``replan`` times; after that, PathBlockedError is raised. With ``wait=False`` the path is
        not monitored.
        """
        for left in reversed(range(replan + 1)):
            seen = scene.revision
            plan = await self.plan(goal, scene, **options)
            if not wait:
                return await self.execute(plan, wait=False)
            blocked = await self._execute_monitored(plan, scene, seen)
            if not blocked:
                return
            if not left:
                raise PathBlockedError(blocked)

    async def _execute_monitored(self, plan: "Plan", scene: "PlanningScene", seen: int) -> str:
        """Execute a plan made in this revision of the scene. If its path is blocked, stop the arm and return the
        reason.
        """
        from client.planning import CollisionChecker
        from client.planning.collisions import blocking_reason

        executing = asyncio.ensure_future(self.execute(plan))
        try:
            while not (await asyncio.wait({executing}, timeout=_CHECK_PERIOD_S))[0]:
                if scene.revision == seen:
                    continue
                seen = scene.revision
                checker = CollisionChecker(scene.copy())
                blocked = await asyncio.to_thread(blocking_reason, checker, plan.trajectory, await self._q_rad())
                if blocked and not executing.done():
                    executing.cancel()
                    await asyncio.wait({executing})
                    await self._motion.come_to_rest()
                    return blocked
            await executing
        finally:
            executing.cancel()
        return ""

    async def _q_rad(self) -> Joints:
        return RobotState(await self._driver.link.fresh_state()).q_rad

    def _with_tcp(self, goal: "Goal") -> "Goal":
        from client.planning import CircGoal, GoalSet, PoseGoal

        if isinstance(goal, GoalSet):
            return GoalSet([cast("Any", self._with_tcp(one)) for one in goal.goals])
        if isinstance(goal, PoseGoal | CircGoal) and goal.tcp_offset is None:
            return replace(goal, tcp_offset=self.tcp_offset())
        return goal


def _planner(scene: "PlanningScene", options: dict[str, Any]) -> "Planner":
    """A planner for the scene as it is now, with the limits among the options, which are removed from them."""
    from client.planning import Planner

    return Planner(scene.copy(), options.pop("limits", None), options.pop("cartesian_limits", None))
