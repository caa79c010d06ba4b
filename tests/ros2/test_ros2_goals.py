"""Goals and commands of a plain rclpy program in another process: how the arm follows them, and what is refused."""

import math
import time
from collections.abc import Sequence
from typing import Any

import pytest
from driver_rig import HOME
from ros2_requests import (
    ABORTED,
    CANCELED,
    FOLLOW,
    SUCCEEDED,
    begin,
    follow,
    needs,
    only,
    q,
    result,
    settled,
    shifted,
    trajectory,
)
from ros2_rig import SCALED, Lab

from client.ros2.host import interface_if_any
from urproto.joints import JOINT_NAMES
from urproto.robots.pose import point_dist, pose_inv, pose_trans, rotvec_to_quaternion

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

UNTIL = "/trajectory_until_node/execute"
TRIGGERED, NOT_TRIGGERED = 0, 1


async def test_a_goal_moves_the_arm_and_reports_progress(lab: Lab) -> None:
    answer = await follow(lab, SCALED, shifted(0.4), 1.5)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["error_string"] == "Goal successfully reached!"
    assert answer["feedback_messages"] > 5
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)


@pytest.mark.long
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
        assert not (await lab.peer.request(goal=action, type=FOLLOW, request={"trajectory": bad}))["accepted"], bad
    assert not await begin(lab, "joint_trajectory_controller", HOME, 1.0)  # it is not active
    assert not await begin(lab, SCALED, HOME, 1.0, path_tolerance=[{"name": "knee_joint", "position": 1.0}])
    assert q(lab) == pytest.approx(HOME, abs=1e-3)


async def test_a_goal_is_canceled(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    answer = await lab.peer.request(cancel=f"/{SCALED}/follow_joint_trajectory")
    assert len(answer["goals_canceling"]) == 1
    assert (await result(lab, SCALED))["status"] == CANCELED


async def test_a_goal_is_replaced(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    first = lab.control.manager.controller(SCALED).goal
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
    answer = await lab.peer.request(goal=UNTIL, type="ur_msgs/action/FollowJointTrajectoryUntil", request=goal)
    return bool(answer["accepted"])


@pytest.mark.long
async def test_a_trajectory_until_the_tool_touches_something(lab: Lab) -> None:
    watching = lab.control.manager.controller("tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0)  # nobody watches
    await only(lab, SCALED, "tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0, until_type=1)
    assert not await until_contact(lab, HOME[:3], 2.0)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(0.4), 1.0)
    answer = await lab.peer.request(result=UNTIL)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == NOT_TRIGGERED
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(-1.0), 10.0)
    assert not await until_contact(lab, shifted(0.4), 1.0)  # one at a time
    assert len((await lab.peer.request(cancel=UNTIL))["goals_canceling"]) == 1
    answer = await lab.peer.request(result=UNTIL)
    assert answer["status"] == CANCELED
    assert "Trajectory action was canceled." in answer["result"]["error_string"]
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, moved_down(), 10.0)
    lab.robot.controller.external_wrench = (0.0, 0.0, 60.0, 0.0, 0.0, 0.0)
    answer = await lab.peer.request(result=UNTIL)
    lab.robot.controller.external_wrench = (0.0,) * 6
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == TRIGGERED
    assert q(lab) != pytest.approx(moved_down(), abs=0.2)
    await settled(lambda: not watching.watching)
    await only(lab, SCALED)


def moved_down() -> list[float]:
    return [angle + (0.4 if place == 1 else 0.0) for place, angle in enumerate(HOME)]


SEQUENCE = "/motion_primitive_forward_controller/motion_sequence"
EXECUTE_SEQUENCE = "control_msgs/action/ExecuteMotionPrimitiveSequence"
PRIMITIVES = "motion_primitive_forward_controller"
JOINT, LINE, ARC = 0, 50, 51
TABLE = (0.3, -0.2, 0.1, 0.0, 0.0, math.pi / 2)  # in the world, which is half a metre below the arm
WORLD = (0.0, 0.0, -0.5, 0.0, 0.0, 0.0)  # in base_link
BASE = (0.0, 0.0, 0.0, 0.0, 0.0, math.pi)  # in base_link


def stamped(pose: Sequence[float], frame: str = "") -> dict[str, Any]:
    return {"header": {"frame_id": frame}, "pose": message_of(pose, "position", "orientation")}


def message_of(pose: Sequence[float], place: str, turn: str) -> dict[str, Any]:
    x, y, z, w = rotvec_to_quaternion(*pose[3:])
    return {place: dict(zip("xyz", pose[:3], strict=True)), turn: {"x": x, "y": y, "z": z, "w": w}}


def link(parent: str, child: str, pose: Sequence[float]) -> dict[str, Any]:
    transform = message_of(pose, "translation", "rotation")
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": transform}


def primitive(kind: int, *targets: Any, blend: float = 0.0, **arguments: float) -> dict[str, Any]:
    named = [{"name": name, "value": value} for name, value in arguments.items()]
    where = {"joint_positions": list(targets[0])} if kind == JOINT else {"poses": list(targets)}
    return {"type": kind, "blend_radius": blend, "additional_arguments": named, **where}


async def begin_sequence(lab: Lab, *primitives: dict[str, Any]) -> bool:
    goal = {"trajectory": {"motions": list(primitives)}}
    return bool((await lab.peer.request(goal=SEQUENCE, type=EXECUTE_SEQUENCE, request=goal))["accepted"])


def tcp(lab: Lab) -> tuple[float, ...]:
    return tuple(lab.robot.controller.snapshot.actual_TCP_pose)


@pytest.mark.long
async def test_motion_primitives_in_frames_of_the_arm_and_of_others(lab: Lab) -> None:
    needs(EXECUTE_SEQUENCE)
    await only(lab, PRIMITIVES)
    start = tcp(lab)
    up = pose_trans((0.0, 0.0, 0.05, 0.0, 0.0, 0.0), start)
    aside = pose_trans((0.0, 0.04, 0.02, 0.0, 0.0, 0.0), start)
    links = [link("world", "table", TABLE), link("base_link", "world", WORLD)]
    await lab.peer.request(
        publish="/tf_static", type="tf2_msgs/msg/TFMessage", latched=True, message={"transforms": links}
    )
    table_in_base = pose_trans(pose_inv(BASE), pose_trans(WORLD, TABLE))
    in_table = stamped(pose_trans(pose_inv(table_in_base), up), "table")
    assert await begin_sequence(
        lab,
        primitive(JOINT, shifted(0.3), move_time=1.0),
        primitive(LINE, in_table, blend=0.01, velocity=0.2, acceleration=0.8, zeal=1.0),
        primitive(ARC, stamped(start), stamped(aside, "base"), velocity=0.2, acceleration=0.8),
    )
    answer = await lab.peer.request(result=SEQUENCE)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert point_dist(tcp(lab), start) < 1e-3
    assert await begin_sequence(lab, primitive(LINE, in_table, velocity=0.2, acceleration=0.8))
    assert (await lab.peer.request(result=SEQUENCE))["status"] == SUCCEEDED
    assert point_dist(tcp(lab), up) < 1e-3


@pytest.mark.long
async def test_motion_primitives_that_make_no_sense_or_are_canceled(lab: Lab) -> None:
    needs(EXECUTE_SEQUENCE)
    good = primitive(JOINT, shifted(0.1), move_time=1.0)
    assert not await begin_sequence(lab, good)  # it is not active
    await only(lab, PRIMITIVES)
    for bad in (
        (),
        (good, primitive(7, stamped(tcp(lab)), move_time=1.0)),
        (good, primitive(JOINT, HOME[:5], move_time=1.0)),
        (primitive(JOINT, shifted(99.0, joint=2), move_time=1.0),),
        (primitive(LINE, stamped((9.0, 0.0, 0.0, 0.0, 0.0, 0.0)), velocity=1.0, acceleration=1.0),),
        (primitive(ARC, stamped(tcp(lab)), velocity=1.0, acceleration=1.0),),
        (primitive(JOINT, HOME),),
        (primitive(JOINT, HOME, velocity=1e30, acceleration=1.0),),
    ):
        assert not await begin_sequence(lab, *bad), bad
    assert q(lab) == pytest.approx(HOME, abs=1e-3)
    assert await begin_sequence(lab, primitive(JOINT, shifted(1.5), move_time=20.0))
    assert not await begin_sequence(lab, good)  # one at a time
    assert len((await lab.peer.request(cancel=SEQUENCE))["goals_canceling"]) == 1
    assert (await lab.peer.request(result=SEQUENCE))["status"] == CANCELED
    assert await begin_sequence(lab, good)
    assert (await lab.peer.request(result=SEQUENCE))["status"] == SUCCEEDED


@pytest.mark.long
async def test_where_a_trajectory_will_be_and_how_fast_its_time_passes(lab: Lab) -> None:
    controller, kind = "joint_trajectory_controller", "control_msgs/srv/QueryTrajectoryState"
    await only(lab, controller)
    assert not (await lab.peer.call(f"/{controller}/query_state", kind))["success"]  # it follows none
    assert await begin(lab, controller, shifted(1.0), 20.0)
    now = time.time()
    answer = await lab.peer.call(f"/{controller}/query_state", kind, time={"sec": int(now) + 10})
    assert answer["success"], answer
    assert answer["name"] == list(JOINT_NAMES)
    assert HOME[5] + 0.2 < answer["position"][5] < HOME[5] + 0.8
    assert answer["velocity"][5] > 0.0
    for seconds in (-100, 100):
        answer = await lab.peer.call(f"/{controller}/query_state", kind, time={"sec": int(now) + seconds})
        assert not answer["success"]
        assert "of the trajectory" in answer["message"]
    scaling, factor = f"/{controller}/speed_scaling_input", "control_msgs/msg/SpeedScalingFactor"
    its = lab.control.manager.controller(controller)
    for number in (0.25, -1.0, 1.0) if interface_if_any(factor) else ():  # Humble has none
        await lab.peer.request(publish=scaling, type=factor, latched=True, message={"factor": number})
        if number > 0.0:
            await settled(lambda number=number: its.scaling == number)  # type: ignore[misc]
    await lab.peer.request(cancel=f"/{controller}/follow_joint_trajectory")
