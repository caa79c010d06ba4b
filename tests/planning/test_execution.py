"""What was planned is what the arm does: recorded angles keep clear of the scene."""

import pytest

pytest.importorskip("ompl")

from clearance import Clearance
from driver_rig import HOME, Lab, emulator

from client.errors import PlanningError
from client.planning import Box, CollisionChecker, JointGoal, PlanningScene, PoseGoal


@pytest.mark.parametrize("model", ["ur3", pytest.param("ur5e", marks=pytest.mark.long)])
async def test_the_arm_goes_around_a_post(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The post stands half way between two postures, and the executed way keeps the padding, whatever lags."""
    async with emulator(model, speed=2.0) as robot:
        monkeypatch.setattr("client.driver.endpoint.time", robot.clock)
        lab = Lab(robot)
        async with lab.arm as arm:
            scene = PlanningScene(await arm.planning.model())
            there = (HOME[0] + 1.6, *HOME[1:])
            middle = scene.kinematics.forward((HOME[0] + 0.8, *HOME[1:]))
            scene.add("post", Box((0.08, 0.08, 2.0)), (*middle[:2], 0.0, 0.0, 0.0, 0.0))
            assert not CollisionChecker(scene).way_is_free(HOME, there)
            driven: list[tuple[float, ...]] = []
            arm.driver.robot.on_state.append(lambda state: driven.append(tuple(state["actual_q"])))
            await arm.plan_to(JointGoal(there), scene, velocity_scaling=0.5, acceleration_scaling=0.3)
            assert arm.q == pytest.approx(there, abs=1e-3)
            clearance = Clearance(scene.model, scene)
            assert min(map(clearance, driven)) > scene.padding_m - 0.002
            # back, by the pose of the TCP that the robot has
            pose = arm.tcp_pose_at(HOME)
            plan = await arm.planning.plan(PoseGoal(pose), scene)
            assert arm.tcp_pose_at(plan.way[-1]) == pytest.approx(pose, abs=1e-4)
            await arm.move_j((there[0] + 0.1, *there[1:]))
            with pytest.raises(PlanningError, match=r"0\.100 rad from where the plan begins"):
                await arm.planning.execute(plan)
