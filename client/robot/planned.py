"""Motions around what is in the way: planned in a scene, then executed by the robot as one trajectory.

Needs the extra ``plan``, which nothing else of this package loads.
"""

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from client.calibration import calibration_of, described
from client.errors import PlanningError
from client.robot.moves import Moves
from client.robot.state import RobotState
from urproto.external_control import TrajectoryPoint
from urproto.robots import RobotModel

if TYPE_CHECKING:
    from client.driver import URDriver
    from client.planning import Goal, Plan, PlanningScene


class PlannedMotion:
    """Plans for the arm as it says it is, from where it stands, and executes them."""

    def __init__(self, driver: "URDriver", moves: Moves) -> None:
        self._driver = driver
        self._moves = moves

    async def model(self) -> RobotModel:
        """The arm, calibrated if it is, for a `PlanningScene`. Raises PlanningError for one that is not known here."""
        arm = self._driver.robot.configuration
        model = described(arm, calibration_of(await self._driver.robot.kinematics())) if arm else None
        if model is None:
            raise PlanningError("this arm is no model that is known here, so its shape is not known either")
        return model

    async def plan(self, goal: "Goal", scene: "PlanningScene", /, **options: Any) -> "Plan":
        """A way from where the arm stands; options are those of `client.planning.Planner.plan`.

        A `PoseGoal` without a TCP is one of the robot's TCP. Other tasks go on meanwhile. Raises PlanningError.
        """
        from client.planning import Planner, PoseGoal

        q_rad = RobotState(self._driver.state).q_rad
        if isinstance(goal, PoseGoal) and goal.tcp_offset is None:
            state = self._driver.robot.primary_state
            if state is None or state.cartesian is None:
                raise PlanningError("the robot has not said yet which TCP it has: give the goal's tcp_offset")
            goal = replace(goal, tcp_offset=state.cartesian.tcp_offset)
        return await asyncio.to_thread(Planner(scene).plan, q_rad, goal, **options)

    async def execute(self, plan: "Plan", *, wait: bool = True) -> None:
        """Let the robot follow a plan, from where it begins. Raises PlanningError when the arm stands elsewhere."""
        plan.check_start(self._driver.state["actual_q"])
        timed = plan.timed
        steps = zip(timed.q[1:], timed.qd[1:], timed.qdd[1:], timed.times_s[1:] - timed.times_s[:-1], strict=True)
        points = [
            TrajectoryPoint.spline(q.tolist(), qd.tolist(), float(step), qdd.tolist()) for q, qd, qdd, step in steps
        ]
        await self._moves.execute("plan_to", points, wait)
