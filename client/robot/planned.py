"""Motions around what is in the way: planned in a scene, then executed by the robot as one trajectory.

Needs the extra ``plan``, which nothing else of this package loads.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from client.calibration import shaped
from client.errors import PathBlockedError, PlanningError
from client.robot.moves import Moves
from client.robot.state import RobotState
from urproto.external_control import TrajectoryPoint
from urproto.robots import Joints, RobotModel
from urproto.robots.pose import Pose

if TYPE_CHECKING:
    from client.driver import URDriver
    from client.planning import CartesianPath, Goal, MotionSequenceItem, Plan, Planner, PlanningScene

_LOOK_S: Final = 0.05  # between two looks whether the scene has changed; guess


class PlannedMotion:
    """Plans for the arm as it says it is, from where it stands, and executes them."""

    def __init__(self, driver: "URDriver", moves: Moves) -> None:
        self._driver = driver
        self._moves = moves

    async def model(self) -> RobotModel:
        """The arm, calibrated if it is, for a `PlanningScene`. Raises PlanningError for one that is not known here."""
        return shaped(self._driver.robot.configuration, await self._driver.robot.kinematics())

    def tcp_offset(self) -> Pose:
        """Flange to the TCP that the robot has. Raises PlanningError before it has said so."""
        state = self._driver.robot.primary_state
        if state is None or state.cartesian is None:
            raise PlanningError("the robot has not said yet which TCP it has: give the tcp_offset")
        return state.cartesian.tcp_offset

    async def plan(self, goal: "Goal", scene: "PlanningScene", /, **options: Any) -> "Plan":
        """A way from where the arm stands; options are those of `client.planning.Planner` and its method ``plan``.

        A goal that is a pose without a TCP is one of the robot's TCP. Other tasks go on meanwhile. Raises
        PlanningError.
        """
        planner = _planner(scene, options)
        return await asyncio.to_thread(planner.plan, self._q_rad, self._with_tcp(goal), **options)

    async def plan_sequence(
        self, items: "Sequence[MotionSequenceItem]", scene: "PlanningScene", /, **options: Any
    ) -> "Plan":
        """Motions one after the other from where the arm stands; see `client.planning.Planner.plan_sequence`."""
        planner = _planner(scene, options)
        items = [replace(item, goal=self._with_tcp(item.goal)) for item in items]
        return await asyncio.to_thread(planner.plan_sequence, self._q_rad, items, **options)

    async def compute_cartesian_path(
        self, waypoints: Sequence[Sequence[float]], scene: "PlanningScene", /, *args: Any, **options: Any
    ) -> "CartesianPath[Plan]":
        """Straight from waypoint to waypoint; see `client.planning.Planner.compute_cartesian_path`.

        The waypoints are poses of the robot's TCP unless a tcp_offset is given.
        """
        planner = _planner(scene, options)
        options["tcp_offset"] = options.get("tcp_offset") or self.tcp_offset()
        return await asyncio.to_thread(planner.compute_cartesian_path, self._q_rad, waypoints, *args, **options)

    async def execute(self, plan: "Plan", *, wait: bool = True) -> None:
        """Let the robot follow a plan, from where it begins. Raises PlanningError when the arm stands elsewhere."""
        plan.check_start(self._driver.state["actual_q"])
        trajectory = plan.trajectory
        if len(trajectory.times_s) < 2:
            if plan.stopped_by:
                raise PlanningError(f"there is nothing to execute: {plan.stopped_by}")
            return  # the arm is there
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

    async def go_to(
        self, goal: "Goal", scene: "PlanningScene", /, *, wait: bool = True, replan: int = 0, **options: Any
    ) -> None:
        """Plan and execute; options are those of `plan`.

        When another task changes the scene so that the rest of the way is blocked, the arm stops, and goes on by
        another way, ``replan`` times at most; then that is a PathBlockedError. With ``wait=False`` nobody looks.
        """
        for left in reversed(range(replan + 1)):
            seen = scene.revision
            plan = await self.plan(goal, scene, **options)
            if not wait:
                return await self.execute(plan, wait=False)
            blocked = await self._watched(plan, scene, seen)
            if not blocked:
                return
            if not left:
                raise PathBlockedError(blocked)

    async def _watched(self, plan: "Plan", scene: "PlanningScene", seen: int) -> str:
        """Execute a plan of a scene of this revision. If something comes into the way, the arm stops; this is what."""
        from client.planning import CollisionChecker
        from client.planning.monitoring import blocking_reason

        executing = asyncio.ensure_future(self.execute(plan))
        try:
            while not (await asyncio.wait({executing}, timeout=_LOOK_S))[0]:
                if scene.revision == seen:
                    continue
                seen = scene.revision
                checker = CollisionChecker(scene.copy())
                blocked = await asyncio.to_thread(blocking_reason, checker, plan.trajectory, self._q_rad)
                if blocked and not executing.done():
                    executing.cancel()
                    await asyncio.wait({executing})
                    await self._moves.come_to_rest()
                    return blocked
            await executing
        finally:
            executing.cancel()
        return ""

    @property
    def _q_rad(self) -> Joints:
        return RobotState(self._driver.state).q_rad

    def _with_tcp(self, goal: "Goal") -> "Goal":
        from client.planning import CircGoal, GoalSet, PoseGoal

        if isinstance(goal, GoalSet):
            return GoalSet([cast("Any", self._with_tcp(one)) for one in goal.goals])
        if isinstance(goal, PoseGoal | CircGoal) and goal.tcp_offset is None:
            return replace(goal, tcp_offset=self.tcp_offset())
        return goal


def _planner(scene: "PlanningScene", options: dict[str, Any]) -> "Planner":
    """In the scene as it is now, with the limits that are among the options, and taken out of them."""
    from client.planning import Planner

    return Planner(scene.copy(), options.pop("limits", None), options.pop("cartesian_limits", None))
