"""Goals and commands of a plain rclpy program in another process: how the arm follows them, and what is refused."""

import math
from typing import Any

import pytest
from driver_rig import HOME
from ros2_rig import SCALED, Lab
from ros2_talk import ABORTED, CANCELED, FOLLOW, SUCCEEDED, begin, follow, only, q, result, settled, shifted, trajectory

from urproto.joints import JOINT_NAMES

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

UNTIL = "/trajectory_until_node/execute"
TRIGGERED, NOT_TRIGGERED = 0, 1


async def test_a_goal_moves_the_arm_and_tells_how_it_goes(lab: Lab) -> None:
    answer = await follow(lab, SCALED, shifted(0.4), 1.5)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["error_string"] == "Goal successfully reached!"
    assert answer["told"] > 5
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)


async def test_the_robot_interpolates_what_passes_through(lab: Lab) -> None:
    await only(lab, "passthrough_trajectory_controller")
    answer = await follow(lab, "passthrough_trajectory_controller", shifted(-0.3), 1.5)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert q(lab) == pytest.approx(shifted(-0.3), abs=5e-3)


async def test_goals_that_make_no_sense_are_refused_and_move_nothing(lab: Lab) -> None:
    action = f"/{SCALED}/follow_joint_trajectory"
    for bad in (
        trajectory((HOME, 1.0), names=[*JOINT_NAMES[:5], "knee_joint"]),
        trajectory((HOME, 2.0), (HOME, 1.0)),
        trajectory((shifted(math.nan), 1.0)),
        trajectory((shifted(5.0, joint=2), 60.0)),
        trajectory((HOME[:3], 1.0)),
        {},
    ):
        assert not (await lab.peer.ask(goal=action, type=FOLLOW, request={"trajectory": bad}))["accepted"], bad
    assert not await begin(lab, "joint_trajectory_controller", HOME, 1.0)  # it is not active
    assert not await begin(lab, SCALED, HOME, 1.0, path_tolerance=[{"name": "knee_joint", "position": 1.0}])
    assert q(lab) == pytest.approx(HOME, abs=1e-3)


async def test_a_goal_is_canceled(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    answer = await lab.peer.ask(cancel=f"/{SCALED}/follow_joint_trajectory")
    assert len(answer["goals_canceling"]) == 1
    assert (await result(lab, SCALED))["status"] == CANCELED


async def test_a_goal_is_replaced(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    first = lab.driver.robot.manager.controller(SCALED).goal
    assert await begin(lab, SCALED, shifted(0.1), 1.0)
    assert (first.result.error_code, first.result.error_string) == (
        -1, "Current goal preempted by new incoming action.",
    )  # fmt: skip
    assert (await result(lab, SCALED))["status"] == SUCCEEDED


async def test_a_violated_tolerance_aborts(lab: Lab) -> None:
    tight = [{"name": "wrist_3_joint", "position": 1e-6}]
    assert await begin(lab, SCALED, shifted(1.0), 1.5, path_tolerance=tight)
    answer = await result(lab, SCALED)
    assert (answer["status"], answer["result"]["error_code"]) == (ABORTED, -4)


async def until_contact(lab: Lab, target: Any, seconds: float, **more: Any) -> bool:
    goal = {"trajectory": trajectory((target, seconds)), **more}
    answer = await lab.peer.ask(goal=UNTIL, type="ur_msgs/action/FollowJointTrajectoryUntil", request=goal)
    return bool(answer["accepted"])


async def test_a_trajectory_until_the_tool_touches_something(lab: Lab) -> None:
    watching = lab.driver.robot.manager.controller("tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0)  # nobody watches
    await only(lab, SCALED, "tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0, until_type=1)
    assert not await until_contact(lab, HOME[:3], 2.0)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(0.4), 1.0)
    answer = await lab.peer.ask(result=UNTIL)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == NOT_TRIGGERED
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(-1.0), 10.0)
    assert not await until_contact(lab, shifted(0.4), 1.0)  # one at a time
    assert len((await lab.peer.ask(cancel=UNTIL))["goals_canceling"]) == 1
    answer = await lab.peer.ask(result=UNTIL)
    assert answer["status"] == CANCELED
    assert "Trajectory action was canceled." in answer["result"]["error_string"]
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, moved_down(), 10.0)
    lab.robot.controller.external_wrench = (0.0, 0.0, 60.0, 0.0, 0.0, 0.0)
    answer = await lab.peer.ask(result=UNTIL)
    lab.robot.controller.external_wrench = (0.0,) * 6
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == TRIGGERED
    assert q(lab) != pytest.approx(moved_down(), abs=0.2)
    await settled(lambda: not watching.watching)
    await only(lab, SCALED)


def moved_down() -> list[float]:
    return [angle + (0.4 if place == 1 else 0.0) for place, angle in enumerate(HOME)]
