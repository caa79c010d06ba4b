"""The arm executes plans as planned: recorded angles keep clear of the scene."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from math import dist, hypot
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ompl")

from clearance import Clearance
from driver_rig import HOME, Lab, emulator

from client.errors import PathBlockedError, PlanningError
from client.planning import (
    Box,
    CircGoal,
    CollisionChecker,
    JointGoal,
    MotionSequenceItem,
    PlanningScene,
    PoseGoal,
    Sphere,
    default_limits,
)


@asynccontextmanager
async def laboratory(model: str, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Lab, PlanningScene]]:
    """An arm that is ready, at twice real time, and its empty scene."""
    async with emulator(model, speed=2.0) as robot:
        monkeypatch.setattr("client.driver.reverse.time", robot.clock)
        lab = Lab(robot)
        async with lab.arm as arm:
            yield lab, PlanningScene(await arm.planning.model())


@pytest.mark.parametrize("model", ["ur3", pytest.param("ur5e", marks=pytest.mark.long)])
async def test_the_arm_goes_around_a_post(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The post stands halfway between two configurations, and the executed path keeps the padding despite any lag."""
    async with laboratory(model, monkeypatch) as (lab, scene):
        arm = lab.arm
        there = (HOME[0] + 1.6, *HOME[1:])
        middle = scene.kinematics.forward((HOME[0] + 0.8, *HOME[1:]))
        scene.add("post", Box((0.08, 0.08, 2.0)), (*middle[:2], 0.0, 0.0, 0.0, 0.0))
        assert not CollisionChecker(scene).path_is_free(HOME, there)
        driven: list[tuple[float, ...]] = []
        arm.driver.link.on_state.append(lambda state: driven.append(tuple(state["actual_q"])))
        await arm.plan_to(JointGoal(there), scene, velocity_scaling=0.5, acceleration_scaling=0.3)
        assert arm.q == pytest.approx(there, abs=1e-3)
        clearance = Clearance(scene.model, scene)
        assert min(map(clearance, driven)) > scene.padding_m - 0.002
        # back, by the pose of the TCP that the robot has
        pose = arm.tcp_pose_at(HOME)
        plan = await arm.planning.plan(PoseGoal(pose), scene)
        assert arm.tcp_pose_at(plan.path[-1]) == pytest.approx(pose, abs=1e-4)
        await arm.move_j((there[0] + 0.1, *there[1:]))
        with pytest.raises(PlanningError, match=r"0\.100 rad from the start of the plan"):
            await arm.planning.execute(plan)


@pytest.mark.long
async def test_an_obstacle_on_the_path_stops_the_arm_which_continues_on_another_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with laboratory("ur3", monkeypatch) as (lab, scene):
        arm = lab.arm
        there = (HOME[0] + 1.8, *HOME[1:])
        ahead = scene.kinematics.forward((HOME[0] + 1.3, *HOME[1:]))
        limits = replace(default_limits(scene.model), velocity=np.full(6, 0.5))

        async def meets_a_post(**options: Any) -> None:
            going = asyncio.create_task(arm.plan_to(JointGoal(there), scene, limits=limits, **options))
            scene.add("far", Sphere(0.05), (2.0, 0.0, 0.0, 0.0, 0.0, 0.0))  # has no effect
            await lab.until(lambda: lab.distance() > 0.15)
            scene.add("post", Box((0.08, 0.08, 2.0)), (*ahead[:2], 0.0, 0.0, 0.0, 0.0))
            await going

        with pytest.raises(PathBlockedError, match="the scene has changed, and the path is blocked"):
            await meets_a_post()
        assert lab.at_rest
        assert 0.15 < lab.distance() < 1.0
        scene.remove("post")
        await arm.plan_to(JointGoal(HOME), scene)
        driven: list[tuple[float, ...]] = []
        arm.driver.link.on_state.append(lambda state: driven.append(tuple(state["actual_q"])))
        await meets_a_post(replan=1)
        assert arm.q == pytest.approx(there, abs=1e-3)
        clearance = Clearance(scene.model, scene)
        assert min(map(clearance, driven[::4])) > scene.padding_m - 0.002


async def test_the_arm_follows_a_line_and_an_arc_without_stopping_in_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorded angles keep to the line, the arc and the blend that were planned."""
    async with laboratory("ur5e", monkeypatch) as (lab, scene):
        arm = lab.arm
        x, y, z, *turn = start = arm.tcp_pose_at(HOME)
        corner, radius = (x, y + 0.15, z), 0.03
        middle = (x, y + 0.15, z + 0.1)
        items = [
            MotionSequenceItem(PoseGoal((*corner, *turn)), "LIN", radius),
            MotionSequenceItem(CircGoal((x, y + 0.15, z + 0.2, *turn), (x, y + 0.25, z + 0.1)), "CIRC"),
        ]
        driven: list[tuple[float, ...]] = []
        arm.driver.link.on_state.append(lambda state: driven.append(tuple(state["actual_q"])))
        plan = await arm.planning.plan_sequence(items, scene, velocity_scaling=0.5, acceleration_scaling=0.5)
        await arm.planning.execute(plan)
        places = [arm.tcp_pose_at(q)[:3] for q in driven]
        for place in places:
            if dist(place, corner) > radius:
                beside = hypot(place[0] - x, place[2] - z)
                outside = hypot(place[0] - x, dist(place, middle) - 0.1)
                assert min(beside, outside) < 0.001
        assert 0 < sum(dist(place, corner) < 0.005 for place in places) < 40  # 1 cm, in 80 ms: it does not stop
        assert dist(places[-1], (x, y + 0.15, z + 0.2)) < 0.001
        back, fraction = await arm.planning.compute_cartesian_path([start, (x + 3.0, y, z, *turn)], scene)
        assert 0.5 < fraction < 1.0
        assert "out of the reach" in back.stopped_by
        stays, fraction = await arm.planning.compute_cartesian_path([(x + 3.0, y, z + 3.0, *turn)], scene, 1.0)
        assert fraction < 0.2
        assert stays.stopped_by
