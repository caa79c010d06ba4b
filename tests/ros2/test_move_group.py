"""The node move_group before a plain rclpy program in another process: what MoveIt's clients ask, move and change."""

import math
import sys
from collections.abc import AsyncIterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import pytest_asyncio
from driver_rig import HOME, driver_options, emulator
from ros2_requests import mentions, needs
from ros2_rig import Lab, laboratory

from client.planning import Box, CollisionChecker, PlanningScene, Sphere
from client.ros2.driver import can_plan
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES
from urproto.robots import kinematics_of, load_model
from urproto.robots.description import urdf
from urproto.robots.pose import pose_trans, rotvec_to_matrix, rotvec_to_quaternion

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

SUCCESS = 1
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
BOX, SPHERE, CYLINDER, CONE = 1, 2, 3, 4
START = (-0.6, -1.2, 1.4, -1.7, -1.5, 0.0)
SLOW = 0.02  # of full speed: whatever a busy machine does meanwhile, the arm is still under way
GOAL = (0.6, -1.2, 1.4, -1.7, -1.5, 0.0)
PILZ = "pilz_industrial_motion_planner"
ARM = kinematics_of(load_model("ur5e"))
POST = {"primitives": [{"type": BOX, "dimensions": [0.1, 0.1, 1.0]}]}
SRV, MSG, ACTION = "moveit_msgs/srv", "moveit_msgs/msg", "moveit_msgs/action"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def laboratory_() -> AsyncIterator[Lab]:
    async with emulator("ur5e") as robot, laboratory(robot, driver_options(robot)) as lab:
        yield lab


@pytest_asyncio.fixture(loop_scope="module")
async def lab(laboratory_: Lab) -> Lab:
    """With nothing around the arm."""
    assert (await laboratory_.peer.call("/apply_planning_scene", f"{SRV}/ApplyPlanningScene"))["success"]
    return laboratory_


def stands(lab: Lab) -> list[float]:
    return list(lab.robot.controller.snapshot.actual_q)


async def rests(lab: Lab, q: Any) -> None:
    """The arm is there, or soon will be: a controller's goal ends within its tolerances."""
    async with timeout(30.0):
        while max(abs(one - other) for one, other in zip(stands(lab), q, strict=True)) > 1e-3:
            await lab.control.driver.link.next_state()


def state(q: Any = START, names: Any = JOINT_NAMES) -> dict[str, Any]:
    return {"joint_state": {"name": list(names), "position": list(q)}}


def pose(xyz: Any, xyzw: Any = (0.0, 0.0, 0.0, 1.0)) -> dict[str, Any]:
    return {"position": dict(zip("xyz", xyz, strict=True)), "orientation": dict(zip("xyzw", xyzw, strict=True))}


def joint_goal(q: Any = GOAL) -> dict[str, Any]:
    joints = [{"joint_name": name, "position": angle} for name, angle in zip(JOINT_NAMES, q, strict=True)]
    return {"joint_constraints": joints}


def request(goal: dict[str, Any] | None = None, start: Any = START, **more: Any) -> dict[str, Any]:
    return {
        "group_name": "ur_manipulator",
        "start_state": state(start),
        "goal_constraints": [joint_goal() if goal is None else goal],
        "allowed_planning_time": 10.0,
        "max_velocity_scaling_factor": 0.5,  # at full speed a busy machine may be later than a controller lets it
        **more,
    }


async def plan(lab: Lab, **more: Any) -> dict[str, Any]:
    answer = await lab.peer.call("/plan_kinematic_path", f"{SRV}/GetMotionPlan", motion_plan_request=request(**more))
    return answer["motion_plan_response"]


async def apply(lab: Lab, **scene: Any) -> bool:
    answer = await lab.peer.call("/apply_planning_scene", f"{SRV}/ApplyPlanningScene", scene={"is_diff": True} | scene)
    return bool(answer["success"])


async def scene_of(lab: Lab, components: int = 0) -> dict[str, Any]:
    fields = {"components": components}
    return (await lab.peer.call("/get_planning_scene", f"{SRV}/GetPlanningScene", components=fields))["scene"]


async def put(lab: Lab, name: str = "post", at: Any = (0.5, 0.0, 0.5), frame: str = "base_link", **more: Any) -> bool:
    obj = {"id": name, "header": {"frame_id": frame}, "pose": pose(at), **(more or POST)}
    return await apply(lab, world={"collision_objects": [obj]})


def end_s(answer: dict[str, Any]) -> float:
    last = answer["trajectory"]["joint_trajectory"]["points"][-1]["time_from_start"]
    return float(last["sec"] + last["nanosec"] * 1e-9)


def points(answer: dict[str, Any]) -> np.ndarray:
    trajectory = answer["trajectory"]["joint_trajectory"]
    assert trajectory["joint_names"] == list(JOINT_NAMES)
    return np.array([point["positions"] for point in trajectory["points"]])


async def test_without_ompl_the_driver_goes_on(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert can_plan()
    monkeypatch.setitem(sys.modules, "ompl", None)
    assert not can_plan()
    assert "[plan]'" in caplog.text


async def test_names_and_types_are_those_of_moveit(lab: Lab) -> None:
    services = {
        "apply_planning_scene": "ApplyPlanningScene",
        "check_state_validity": "GetStateValidity",
        "compute_cartesian_path": "GetCartesianPath",
        "compute_fk": "GetPositionFK",
        "compute_ik": "GetPositionIK",
        "get_planning_scene": "GetPlanningScene",
        "plan_kinematic_path": "GetMotionPlan",
        "query_planner_interface": "QueryPlannerInterfaces",
    }
    actions = {
        "move_action": "MoveGroup",
        "execute_trajectory": "ExecuteTrajectory",
        "sequence_move_group": "MoveGroupSequence",
    }
    wanted = {f"/{name}": [f"{SRV}/{kind}"] for name, kind in services.items()}
    wanted |= {f"/{name}/_action/send_goal": [f"{ACTION}/{kind}_SendGoal"] for name, kind in actions.items()}
    graph = await lab.peer.graph(lambda graph: wanted.items() <= graph["services"].items())
    assert "/move_group" in graph["nodes"]
    assert {name: graph["services"].get(name) for name in wanted} == wanted
    description = (await lab.peer.echo("/robot_description_semantic", "std_msgs/msg/String", latched=True))["data"]
    root = ElementTree.fromstring(description)
    assert root.get("name") == ElementTree.fromstring(urdf(load_model("ur5e"))).get("name")
    assert root.find("group/chain").attrib == {"base_link": "base_link", "tip_link": "tool0"}
    assert {one.get("name") for one in root.iterfind("group_state")} == {"home", "up", "test_configuration"}
    answer = await lab.peer.call("/query_planner_interface", f"{SRV}/QueryPlannerInterfaces")
    assert "RRTConnectkConfigDefault" in answer["planner_interfaces"][0]["planner_ids"]


async def test_the_description_is_the_one_that_is_published(lab: Lab) -> None:
    needs(f"{SRV}/GetGroupUrdf")
    answer = await lab.peer.call("/get_urdf", f"{SRV}/GetGroupUrdf", group_name="ur_manipulator")
    assert (
        answer["urdf_string"]
        == (await lab.peer.echo("/robot_description", "std_msgs/msg/String", latched=True))["data"]
    )
    assert (await lab.peer.call("/get_urdf", f"{SRV}/GetGroupUrdf"))["error_code"]["val"] == -15


async def test_forward_kinematics_are_the_robots(lab: Lab) -> None:
    answer = await lab.peer.call(
        "/compute_fk", f"{SRV}/GetPositionFK", header={"frame_id": "base"}, fk_link_names=["tool0", "base_link"],
        robot_state=state(GOAL),
    )  # fmt: skip
    assert answer["error_code"]["val"] == SUCCESS
    tool, root = (stamped["pose"] for stamped in answer["pose_stamped"])
    expected = ARM.forward(GOAL)
    assert list(tool["position"].values()) == pytest.approx(expected[:3], abs=1e-9)
    turn = np.array(list(tool["orientation"].values()))
    assert abs(turn @ rotvec_to_quaternion(*expected[3:])) == pytest.approx(1.0)
    assert abs(root["orientation"]["z"]) == pytest.approx(1.0)  # base is turned by pi
    for wrong, code in (({"fk_link_names": ["gripper"]}, -18), ({"header": {"frame_id": "moon"}}, -21)):
        fields: dict[str, Any] = {"fk_link_names": ["tool0"], **wrong}
        answer = await lab.peer.call("/compute_fk", f"{SRV}/GetPositionFK", **fields)
        assert answer["error_code"]["val"] == code, answer


async def test_inverse_kinematics(lab: Lab) -> None:
    forward = await lab.peer.call(
        "/compute_fk", f"{SRV}/GetPositionFK", fk_link_names=["tool0"], robot_state=state(GOAL)
    )
    (target,) = forward["pose_stamped"]
    assert target["header"]["frame_id"] == "base_link"
    target["header"].pop("stamp")

    async def ik(**more: Any) -> dict[str, Any]:
        fields = {"group_name": "ur_manipulator", "robot_state": state(GOAL), "pose_stamped": target, **more}
        return await lab.peer.call("/compute_ik", f"{SRV}/GetPositionIK", ik_request=fields)

    answer = await ik()
    assert answer["error_code"]["val"] == SUCCESS
    assert answer["solution"]["joint_state"]["position"] == pytest.approx(GOAL, abs=1e-6)
    elbow = {"joint_name": "elbow_joint", "position": -1.4, "tolerance_above": 1.0, "tolerance_below": 1.0}
    other = (await ik(constraints={"joint_constraints": [elbow]}))["solution"]["joint_state"]["position"]
    assert other[2] < 0.0
    again = await lab.peer.call(
        "/compute_fk", f"{SRV}/GetPositionFK", fk_link_names=["tool0"], robot_state=state(other)
    )
    assert list(again["pose_stamped"][0]["pose"]["position"].values()) == pytest.approx(
        list(target["pose"]["position"].values()), abs=1e-6
    )
    # on the arm as it is with this posture, and not with all others
    assert await put(lab, "wall", [target["pose"]["position"][axis] for axis in "xyz"])
    assert (await ik(avoid_collisions=True))["error_code"]["val"] == -31
    assert (await ik())["error_code"]["val"] == SUCCESS
    far = {"header": {"frame_id": "base_link"}, "pose": pose((3.0, 0.0, 0.0))}
    assert (await ik(pose_stamped=far))["error_code"]["val"] == -31
    assert (await ik(group_name="left_arm"))["error_code"]["val"] == -15
    assert (await ik(ik_link_name="elbow"))["error_code"]["val"] == -18
    assert (await ik(robot_state=state(GOAL, [f"left_{name}" for name in JOINT_NAMES])))["error_code"]["val"] == -17


async def test_a_plan_goes_around_what_the_scene_has(lab: Lab) -> None:
    """Looked at in a scene of its own, since planning judges by its own."""
    straight = await plan(lab)
    assert straight["error_code"]["val"] == SUCCESS
    assert await put(lab, "post", (0.5, 0.0, 0.5))
    answer = await plan(lab)
    assert answer["error_code"]["val"] == SUCCESS, answer["error_code"]
    assert answer["group_name"] == "ur_manipulator"
    assert answer["trajectory_start"]["joint_state"]["position"] == pytest.approx(START)
    path = points(answer)
    assert path[0] == pytest.approx(START)
    assert path[-1] == pytest.approx(GOAL, abs=1e-9)
    own = PlanningScene("ur5e")
    own.add("post", Box((0.1, 0.1, 1.0)), (-0.5, 0.0, 0.5, 0.0, 0.0, 0.0))  # base is turned by pi
    checker = CollisionChecker(own)
    assert min(checker.clearance(q) for q in points(straight)) < 0.0
    assert min(checker.clearance(q) for q in path) > 0.009


def tool_at(q: Any) -> dict[str, Any]:
    """Of tool0, in base_link."""
    in_root = pose_trans((0.0, 0.0, 0.0, 0.0, 0.0, math.pi), ARM.forward(q))
    return pose(in_root[:3], rotvec_to_quaternion(*in_root[3:]))


def position(xyz: Any, name: str = "") -> dict[str, Any]:
    """Constraints of that name with one position of tool0."""
    region = {"primitives": [{"type": SPHERE, "dimensions": [0.001]}], "primitive_poses": [pose(xyz)]}
    place = {"header": {"frame_id": "base_link"}, "link_name": "tool0", "constraint_region": region}
    return {"name": name, "position_constraints": [place]}


def pose_goal(q: Any = GOAL) -> dict[str, Any]:
    place = tool_at(q)
    turn = {"header": {"frame_id": "base_link"}, "link_name": "tool0", "orientation": place["orientation"]}
    return {**position(place["position"].values()), "orientation_constraints": [turn]}


def tool_path(answer: dict[str, Any]) -> np.ndarray:
    """Where the flange goes, in base."""
    return np.array([ARM.forward(q)[:3] for q in points(answer)])


async def test_a_pose_goal_is_reached(lab: Lab) -> None:
    goal = pose_goal()
    answer = await plan(lab, goal=goal)
    assert answer["error_code"]["val"] == SUCCESS, answer["error_code"]
    assert tool_path(answer)[-1] == pytest.approx(ARM.forward(GOAL)[:3], abs=1e-6)
    goal["orientation_constraints"].clear()
    assert (await plan(lab, goal=goal))["error_code"]["val"] == -16


async def test_lines_and_arcs_of_pilz_planner(lab: Lab) -> None:
    line = await plan(lab, goal=pose_goal(), pipeline_id=PILZ, planner_id="LIN")
    assert line["error_code"]["val"] == SUCCESS, line["error_code"]
    path = tool_path(line)
    along = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    off = (path - path[0]) - np.outer((path - path[0]) @ along, along)
    assert abs(off).max() < 1e-4
    slow = await plan(lab, goal=joint_goal(), pipeline_id=PILZ, planner_id="LIN", max_cartesian_speed=0.05)
    assert end_s(slow) > np.linalg.norm(path[-1] - path[0]) / 0.05 > end_s(line)
    middle = ARM.forward(((START[0] + GOAL[0]) / 2, *GOAL[1:]))[:3]
    arc = await plan(
        lab, goal=pose_goal(), pipeline_id=PILZ, planner_id="CIRC",
        path_constraints=position((-middle[0], -middle[1], middle[2]), "interim"),
    )  # fmt: skip
    assert arc["error_code"]["val"] == SUCCESS, arc["error_code"]
    assert np.linalg.norm(tool_path(arc) - middle, axis=1).min() < 0.01
    assert np.linalg.norm(tool_path(arc)[:, :2], axis=1) == pytest.approx(math.hypot(*middle[:2]), abs=1e-3)


async def test_path_constraints_are_kept_to(lab: Lab) -> None:
    """The tool stays upright, at any angle about its own axis, on a path around an obstacle."""
    level = (-0.6, -1.4, 1.7, -1.8707963, -1.5707963, 0.0)
    there = (0.6, *level[1:])
    assert await put(lab, "post", (0.5, 0.0, 0.5))
    turn = {**pose_goal(level)["orientation_constraints"][0], "absolute_x_axis_tolerance": 0.1,
            "absolute_y_axis_tolerance": 0.1, "absolute_z_axis_tolerance": math.pi}  # fmt: skip
    fields = {"start": level, "goal": joint_goal(there)}
    answer = await plan(lab, **fields, path_constraints={"orientation_constraints": [turn]})
    assert answer["error_code"]["val"] == SUCCESS, answer["error_code"]

    def leaning(q: Any) -> float:
        wanted, now = (rotvec_to_matrix(*ARM.forward(one)[3:]) for one in (level, q))
        return math.acos(min(1.0, sum(wanted[i] * now[i] for i in (2, 5, 8))))

    assert max(map(leaning, points(answer))) < 0.15
    assert max(map(leaning, points(await plan(lab, **fields)))) > 0.2
    narrow = {**turn, "parameterization": 1}
    for wrong, code in ((narrow, -16), ({**turn, "link_name": "forearm_link"}, -18)):
        answer = await plan(lab, **fields, path_constraints={"orientation_constraints": [wrong]})
        assert answer["error_code"]["val"] == code, answer["error_code"]
    answer = await plan(lab, start=START, path_constraints={"orientation_constraints": [
        {**turn, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}]})  # fmt: skip
    assert answer["error_code"]["val"] == -11, answer["error_code"]


async def test_a_sequence_blends(lab: Lab) -> None:
    linear = {"pipeline_id": PILZ, "planner_id": "LIN"}
    corner = (START[0], -1.0, *START[2:])
    first, second = request(pose_goal(corner), **linear), request(pose_goal((-0.3, -1.0, *START[2:])), **linear)
    second.pop("start_state")
    items = [{"req": first, "blend_radius": 0.03}, {"req": second}]
    kind = f"{SRV}/GetMotionSequence"
    blended = (await lab.peer.call("/plan_sequence_path", kind, request={"items": items}))["response"]
    assert blended["error_code"]["val"] == SUCCESS, blended["error_code"]
    (trajectory,) = blended["planned_trajectories"]
    nearest = np.linalg.norm(tool_path({"trajectory": trajectory}) - ARM.forward(corner)[:3], axis=1).min()
    assert 0.001 < nearest < 0.03
    items[0].pop("blend_radius")
    stopped = (await lab.peer.call("/plan_sequence_path", kind, request={"items": items}))["response"]
    (other,) = stopped["planned_trajectories"]
    assert end_s({"trajectory": other}) > end_s({"trajectory": trajectory})


async def test_a_sequence_is_taken(lab: Lab) -> None:
    """Recorded angles pass the corner within its blend radius, and not through it."""
    assert (await move(lab, goal=joint_goal(START)))["status"] == SUCCEEDED
    corner, end = (START[0], -1.0, *START[2:]), (-0.3, -1.0, *START[2:])
    linear = {"pipeline_id": PILZ, "planner_id": "LIN"}
    first, second = (request(pose_goal(q), **linear) for q in (corner, end))
    second.pop("start_state")
    kind = f"{ACTION}/MoveGroupSequence"
    states: list[Any] = []
    listeners = lab.control.driver.link.on_state
    listeners.append(watch := lambda state: states.append(state["actual_q"]))
    try:
        goal = {"request": {"items": [{"req": first, "blend_radius": 0.03}, {"req": second}]}}
        assert (await lab.peer.request(goal="/sequence_move_group", type=kind, request=goal))["accepted"]
        answer = await lab.peer.request(result="/sequence_move_group")
    finally:
        listeners.remove(watch)
    assert answer["status"] == SUCCEEDED, answer
    response = answer["result"]["response"]
    assert response["error_code"]["val"] == SUCCESS
    assert len(response["planned_trajectories"]) == 1
    await rests(lab, points({"trajectory": response["planned_trajectories"][0]})[-1])
    middle = ARM.forward(corner)[:3]
    assert 0.001 < min(math.dist(ARM.forward(q)[:3], middle) for q in states) < 0.03
    assert (await lab.peer.request(goal="/sequence_move_group", type=kind, request={}))["accepted"]
    assert (await lab.peer.request(result="/sequence_move_group"))["status"] == SUCCEEDED
    goal["request"]["items"][1]["blend_radius"] = 0.1
    assert (await lab.peer.request(goal="/sequence_move_group", type=kind, request=goal))["accepted"]
    answer = await lab.peer.request(result="/sequence_move_group")
    assert answer["status"] == ABORTED
    assert answer["result"]["response"]["error_code"]["val"] < 0


async def test_a_cartesian_path_goes_as_far_as_it_can(lab: Lab) -> None:
    def moved(x: float, z: float) -> dict[str, Any]:
        place = tool_at(START)
        there = [place["position"]["x"] + x, place["position"]["y"], place["position"]["z"] + z]
        return {"position": dict(zip("xyz", there, strict=True)), "orientation": place["orientation"]}

    async def path(*waypoints: Any, frame: str = "base_link", **more: Any) -> dict[str, Any]:
        fields = {"header": {"frame_id": frame}, "start_state": state(), "group_name": "ur_manipulator",
                 "link_name": "tool0", "waypoints": list(waypoints), "max_step": 0.01, "avoid_collisions": True,
                 **more}  # fmt: skip
        answer = await lab.peer.call("/compute_cartesian_path", f"{SRV}/GetCartesianPath", **fields)
        return {**answer, "trajectory": answer["solution"]}

    whole = await path(moved(0.0, 0.1), moved(-0.1, 0.1))
    assert (whole["error_code"]["val"], whole["fraction"]) == (SUCCESS, 1.0)
    begin = np.array(ARM.forward(START)[:3])
    assert tool_path(whole)[-1] - begin == pytest.approx((0.1, 0.0, 0.1), abs=1e-6)  # base is turned by pi
    assert (whole["start_state"]["joint_state"]["position"]) == pytest.approx(START)
    far = await path(moved(0.0, 0.1), moved(2.0, 0.1))
    assert far["error_code"]["val"] == SUCCESS
    assert 0.5 < far["fraction"] < 0.9
    along = await path(pose((0.0, 0.0, -0.05)), pose((0.0, 0.0, -0.05)), frame="tool0")
    axis = pose_trans((0.0, 0.0, 0.0, *ARM.forward(START)[3:]), (0.0, 0.0, -0.1, 0.0, 0.0, 0.0))[:3]
    assert tool_path(along)[-1] - begin == pytest.approx(axis, abs=1e-6)
    place = moved(0.0, 0.35)["position"]
    assert await put(lab, "lid", [place["x"], place["y"], place["z"] + 0.1], **{
        "primitives": [{"type": BOX, "dimensions": [0.4, 0.4, 0.02]}]})  # fmt: skip
    blocked = await path(moved(0.0, 0.5))
    free = await path(moved(0.0, 0.5), avoid_collisions=False)
    assert blocked["fraction"] < free["fraction"]
    assert (await path(moved(0.0, 0.1), max_step=0.0))["error_code"]["val"] < 0
    assert (await path(moved(0.0, 0.1), link_name="forearm_link"))["error_code"]["val"] == -18
    assert (await path(moved(0.0, 0.1), path_constraints=joint_goal()))["error_code"]["val"] == -16


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ({"group_name": "gripper"}, -15, "ur_manipulator"),
        ({"pipeline_id": "chomp"}, 99999, "ompl"),
        ({"goal": {}}, -16, "joint constraints"),
        ({"goal": joint_goal((7.0, *GOAL[1:]))}, -27, "limits"),
        ({"goal": joint_goal((0.0, 0.6, 0.9, 0.0, 0.0, 0.0))}, -12, "table"),
        ({"start": (0.0, 0.6, 0.9, 0.0, 0.0, 0.0)}, -10, "table"),
        ({"goal": pose_goal() | position((3.0, 0.0, 0.0))}, -31, "out of the reach"),
        ({"path_constraints": joint_goal()}, -16, "path constraints"),
        ({"pipeline_id": PILZ, "planner_id": "RRTConnect"}, 99999, "CIRC"),
        ({"pipeline_id": PILZ, "planner_id": "CIRC"}, -2, "interim"),
        ({"max_cartesian_speed": 0.1}, 99999, "LIN and CIRC"),
    ],
)
async def test_what_cannot_be_planned_has_a_code_and_a_message(lab: Lab, more: Any, code: int, words: str) -> None:
    table = {"primitives": [{"type": BOX, "dimensions": [3.0, 3.0, 0.1]}]}
    assert await put(lab, "table", (0.0, 0.0, -0.2), **table)
    answer = await plan(lab, **more)
    assert answer["error_code"]["val"] == code, answer["error_code"]
    assert mentions(answer["error_code"], words)
    assert answer["error_code"].get("source", "move_group") == "move_group"  # Humble has none


async def tool_at_goal(lab: Lab) -> dict[str, float]:
    answer = await lab.peer.call(
        "/compute_fk", f"{SRV}/GetPositionFK", fk_link_names=["tool0"], robot_state=state(GOAL)
    )
    position: dict[str, float] = answer["pose_stamped"][0]["pose"]["position"]
    return position


async def test_validity_names_what_touches(lab: Lab) -> None:
    async def judged(q: Any) -> dict[str, Any]:
        return await lab.peer.call("/check_state_validity", f"{SRV}/GetStateValidity", robot_state=state(q))

    assert (await judged(GOAL))["valid"]
    tool = await tool_at_goal(lab)
    ball = {"primitives": [{"type": SPHERE, "dimensions": [0.05]}]}
    assert await put(lab, "ball", list(tool.values()), **ball)
    answer = await judged(GOAL)
    assert not answer["valid"]
    contact = answer["contacts"][0]
    assert {contact["contact_body_1"], contact["contact_body_2"]} & {"ball"}
    assert math.dist(contact["position"].values(), tool.values()) < 0.1
    assert contact["depth"] > 0.0


async def test_validity_of_many_states(lab: Lab) -> None:
    needs(kind := f"{SRV}/GetMultiStateValidity")

    async def all_judged(*states: Any) -> bool:
        joints = [state(q)["joint_state"] for q in states]
        return bool((await lab.peer.call("/check_multi_state_validity", kind, joint_states=joints))["valid"])

    tool = await tool_at_goal(lab)
    assert await put(lab, "ball", list(tool.values()), primitives=[{"type": SPHERE, "dimensions": [0.05]}])
    assert await all_judged(START, HOME)
    assert not await all_judged(START, GOAL, HOME)


async def test_the_scene_is_reported_as_it_was_given(lab: Lab) -> None:
    objects = [
        {"id": "pipe", "header": {"frame_id": "base"}, "pose": pose((0.4, 0.4, 0.2)),
         "primitives": [{"type": CYLINDER, "dimensions": [0.3, 0.02]}, {"type": SPHERE, "dimensions": [0.04]}],
         "primitive_poses": [pose((0.0, 0.0, 0.0)), pose((0.0, 0.0, 0.15))]},
        {"id": "wedge", "header": {"frame_id": "pipe"},
         "meshes": [{"vertices": [dict(zip("xyz", v, strict=True)) for v in
                                  ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))],
                     "triangles": []}], "mesh_poses": [pose((0.2, 0.0, 0.0))]},
        {"id": "ceiling", "header": {"frame_id": "base_link"}, "planes": [{"coef": [0.0, 0.0, 1.0, -1.5]}]},
    ]  # fmt: skip
    assert await apply(lab, world={"collision_objects": objects}, name="cell")
    scene = await scene_of(lab)
    assert scene["name"] == "cell"
    pipe, wedge, ceiling = scene["world"]["collision_objects"]
    assert pipe["header"]["frame_id"] == "base_link"
    assert list(pipe["pose"]["position"].values()) == pytest.approx((-0.4, -0.4, 0.2))
    assert [one["dimensions"] for one in pipe["primitives"]] == [[0.3, 0.02], [0.04]]
    assert pipe["primitive_poses"][1]["position"]["z"] == pytest.approx(0.15)
    assert list(wedge["pose"]["position"].values()) == pytest.approx((-0.6, -0.4, 0.2))
    assert ceiling["planes"][0]["coef"] == [0.0, 0.0, 1.0, -1.5]
    assert scene["robot_state"]["joint_state"]["position"] == pytest.approx(stands(lab), abs=1e-3)
    names = (await scene_of(lab, 8))["world"]["collision_objects"]
    assert [one["id"] for one in names] == ["pipe", "wedge", "ceiling"]
    assert not names[0]["primitives"]
    # and applied as a whole it is the same
    assert await apply(lab, **{**scene, "is_diff": False})
    assert (await scene_of(lab))["world"]["collision_objects"][0]["pose"] == pipe["pose"]


async def test_scene_and_path_are_drawn(lab: Lab) -> None:
    assert await put(lab, "post", (0.5, 0.0, 0.5))
    carried = {"link_name": "tool0", "object": {"id": "probe", "primitives": [{"type": SPHERE, "dimensions": [0.02]}]}}
    assert await apply(lab, robot_state={"is_diff": True, "attached_collision_objects": [carried]})
    array = "visualization_msgs/msg/MarkerArray"
    wiped, *drawn = (await lab.peer.echo("/move_group/scene_markers", array, latched=True))["markers"]
    assert wiped["action"] == 3
    assert [(one["ns"], one["type"], one["header"]["frame_id"]) for one in drawn] == [
        ("post", 1, "base"), ("probe", 2, "tool0")]  # fmt: skip
    assert drawn[0]["pose"]["position"]["x"] == pytest.approx(-0.5)
    answer = await plan(lab)
    (line,) = (await lab.peer.echo("/move_group/path_markers", array, latched=True))["markers"]
    assert np.array([list(point.values()) for point in line["points"]]) == pytest.approx(tool_path(answer))


async def test_objects_come_move_and_go_on_topics(lab: Lab) -> None:
    topic = {"publish": "/collision_object", "type": f"{MSG}/CollisionObject"}
    monitored = {"echo": "/monitored_planning_scene", "type": f"{MSG}/PlanningScene", "latched": True}

    async def ids() -> dict[str, float]:
        objects = (await lab.peer.request(**monitored))["world"]["collision_objects"]
        return {one["id"]: one["pose"]["position"]["x"] for one in objects}

    await lab.peer.request(**monitored)
    post = {"id": "post", "header": {"frame_id": "base_link"}, "pose": pose((0.5, 0.0, 0.5)), **POST}
    await lab.peer.request(**topic, message=post)
    assert await ids() == {"post": pytest.approx(0.5)}
    moved = {"id": "post", "header": {"frame_id": "base_link"}, "pose": pose((0.6, 0.0, 0.5)), "operation": "MOVE"}
    await lab.peer.request(**topic, message=moved)
    assert await ids() == {"post": pytest.approx(0.6)}
    lid = {"primitives": [{"type": BOX, "dimensions": [0.3, 0.3, 0.02]}], "primitive_poses": [pose((0.0, 0.0, 0.5))]}
    await lab.peer.request(**topic, message={**moved, "operation": "APPEND", **lid})
    (grown,) = (await lab.peer.request(**monitored))["world"]["collision_objects"]
    assert [one["dimensions"][0] for one in grown["primitives"]] == [0.1, 0.3]
    await lab.peer.request(**topic, message={"id": "post", "operation": "REMOVE"})
    assert await ids() == {}


async def test_a_refused_scene_changes_nothing(lab: Lab) -> None:
    assert await put(lab)
    cone = {"id": "cone", "primitives": [{"type": CONE, "dimensions": [0.1, 0.1]}]}
    flat = {"id": "flat", "meshes": [{"vertices": [{"x": 0.0}, {"x": 1.0}, {"y": 1.0}]}]}
    moon = {"id": "moon", "header": {"frame_id": "moon"}, **POST}
    for wrong in (cone, flat, moon, {"id": "elbow", "operation": "REMOVE"}, {"id": "", **POST},
                  {"id": "forearm_link", **POST}):  # fmt: skip
        other = {"id": "other", **POST}
        assert not await apply(lab, world={"collision_objects": [other, wrong]}), wrong
    assert not await apply(lab, link_scale=[{"link_name": "forearm_link", "scale": 2.0}])
    assert not await apply(lab, world={"octomap": {"octomap": {"data": [1, 2, 3]}}})
    assert [one["id"] for one in (await scene_of(lab))["world"]["collision_objects"]] == ["post"]


async def test_what_may_touch_may(lab: Lab) -> None:
    """As pymoveit2 does it: a row and a column in the matrix that the scene has."""
    table = {"primitives": [{"type": BOX, "dimensions": [3.0, 3.0, 0.1]}]}
    assert await put(lab, "table", (0.0, 0.0, -0.2), **table)
    low = (0.0, 0.6, 0.9, 0.0, 0.0, 0.0)
    assert (await plan(lab, start=low))["error_code"]["val"] == -10
    matrix = (await scene_of(lab, 128))["allowed_collision_matrix"]
    at = matrix["entry_names"].index("table")
    adjacent = matrix["entry_names"].index("base_link_inertia"), matrix["entry_names"].index("shoulder_link")
    assert matrix["entry_values"][adjacent[0]]["enabled"][adjacent[1]]
    for row in matrix["entry_values"]:
        row["enabled"][at] = True
    matrix["entry_values"][at]["enabled"] = [True] * len(matrix["entry_names"])
    assert await apply(lab, allowed_collision_matrix=matrix)
    assert (await plan(lab, start=low))["error_code"]["val"] == SUCCESS
    assert not await apply(lab, allowed_collision_matrix={**matrix, "entry_names": matrix["entry_names"][:-1]})


async def test_an_attached_object_moves_with_the_arm(lab: Lab) -> None:
    long_box = {"primitives": [{"type": BOX, "dimensions": [0.05, 0.05, 0.6]}]}
    carried = {"link_name": "tool0", "touch_links": ["wrist_3_link"],
               "object": {"id": "rod", "pose": pose((0.0, 0.0, 0.33)), **long_box}}  # fmt: skip
    free = await plan(lab)
    ball = {"primitives": [{"type": SPHERE, "dimensions": [0.08]}]}
    assert await put(lab, "ball", (0.6, 0.16, 0.0), **ball)
    assert points(await plan(lab)) == pytest.approx(points(free))  # the arm alone passes above
    assert await apply(lab, robot_state={"is_diff": True, "attached_collision_objects": [carried]})
    scene = await scene_of(lab)
    (attached,) = scene["robot_state"]["attached_collision_objects"]
    assert (attached["link_name"], attached["object"]["id"]) == ("tool0", "rod")
    assert attached["object"]["pose"]["position"]["z"] == pytest.approx(0.33)
    own = PlanningScene("ur5e")
    own.add("ball", Sphere(0.08), (-0.6, -0.16, 0.0, 0.0, 0.0, 0.0))
    own.attach("rod", Box((0.05, 0.05, 0.6)), (0.0, 0.0, 0.33, 0.0, 0.0, 0.0))
    checker = CollisionChecker(own)
    assert min(map(checker.clearance, points(free))) < 0.0
    answer = await plan(lab)
    assert answer["error_code"]["val"] == SUCCESS, answer["error_code"]
    assert min(map(checker.clearance, points(answer))) > 0.009
    gone = {"object": {"id": "rod", "operation": "REMOVE"}}
    assert await apply(lab, robot_state={"is_diff": True, "attached_collision_objects": [gone]})
    scene = await scene_of(lab)
    assert not scene["robot_state"]["attached_collision_objects"]
    assert {one["id"] for one in scene["world"]["collision_objects"]} == {"ball", "rod"}


async def move(lab: Lab, wait: bool = True, **more: Any) -> dict[str, Any]:
    options = more.pop("planning_options", {})
    goal = {"request": request(**more), "planning_options": options}
    assert (await lab.peer.request(goal="/move_action", type=f"{ACTION}/MoveGroup", request=goal))["accepted"]
    return await lab.peer.request(result="/move_action") if wait else {}


async def moves(lab: Lab) -> None:
    """The base turns towards GOAL."""
    async with timeout(30.0):
        while lab.control.driver.state["actual_qd"][0] < 0.01:
            await lab.control.driver.link.next_state()


async def test_the_arm_moves_around_an_obstacle(lab: Lab) -> None:
    assert (await move(lab, goal=joint_goal(START)))["status"] == SUCCEEDED
    assert await put(lab, "post", (0.5, 0.0, 0.5))
    own = PlanningScene("ur5e")
    own.add("post", Box((0.1, 0.1, 1.0)), (-0.5, 0.0, 0.5, 0.0, 0.0, 0.0))
    checker = CollisionChecker(own)
    states: list[Any] = []
    listeners = lab.control.driver.link.on_state
    listeners.append(watch := lambda state: states.append(state["actual_q"]))
    try:
        answer = await move(lab)
    finally:
        listeners.remove(watch)
    assert answer["status"] == SUCCEEDED, answer
    assert answer["result"]["error_code"]["val"] == SUCCESS
    assert answer["feedback"] == [{"state": "MONITOR"}]
    await rests(lab, GOAL)
    assert len(states) > 100
    assert min(checker.clearance(q) for q in states[::10]) > 0.005
    assert (await move(lab))["result"]["error_code"]["val"] == SUCCESS  # it is there


async def test_a_plan_is_executed_later_and_stopped(lab: Lab) -> None:
    planned = await plan(lab, start=stands(lab), goal=joint_goal(HOME))
    order = {"goal": "/execute_trajectory", "type": f"{ACTION}/ExecuteTrajectory"}
    trajectory = {"trajectory": planned["trajectory"]}
    assert (await lab.peer.request(**order, request=trajectory))["accepted"]
    answer = await lab.peer.request(result="/execute_trajectory")
    assert answer["status"] == SUCCEEDED, answer
    await rests(lab, HOME)
    # from elsewhere it is refused
    moved = await plan(lab, start=GOAL, goal=joint_goal(START))
    assert (await lab.peer.request(**order, request={"trajectory": moved["trajectory"]}))["accepted"]
    answer = await lab.peer.request(result="/execute_trajectory")
    assert (answer["status"], answer["result"]["error_code"]["val"]) == (ABORTED, -4)
    assert mentions(answer["result"]["error_code"], "plan again")

    slow = await plan(lab, start=stands(lab), max_velocity_scaling_factor=SLOW)
    assert (await lab.peer.request(**order, request={"trajectory": slow["trajectory"]}))["accepted"]
    await moves(lab)
    await lab.peer.request(publish="/trajectory_execution_event", type="std_msgs/msg/String", message={"data": "stop"})
    answer = await lab.peer.request(result="/execute_trajectory")
    assert (answer["status"], answer["result"]["error_code"]["val"]) == (ABORTED, -7)
    assert max(abs(a - b) for a, b in zip(stands(lab), GOAL, strict=True)) > 0.1


async def test_a_motion_is_canceled(lab: Lab) -> None:
    await move(lab, wait=False, max_velocity_scaling_factor=SLOW, goal=joint_goal(START))
    assert len((await lab.peer.request(cancel="/move_action"))["goals_canceling"]) == 1
    answer = await lab.peer.request(result="/move_action")
    assert (answer["status"], answer["result"]["error_code"]["val"]) == (CANCELED, -7)


async def test_a_motion_ends_when_its_path_is_blocked(lab: Lab) -> None:
    assert (await move(lab, goal=joint_goal(START)))["status"] == SUCCEEDED
    await move(lab, wait=False, max_velocity_scaling_factor=SLOW)
    await moves(lab)
    assert await put(lab, "post", (0.5, 0.0, 0.5))
    answer = await lab.peer.request(result="/move_action")
    assert (answer["status"], answer["result"]["error_code"]["val"]) == (ABORTED, -3), answer["result"]["error_code"]
    assert mentions(answer["result"]["error_code"], "post")
    # again, around it
    answer = await move(lab, planning_options={"replan": True, "replan_attempts": 2})
    assert answer["status"] == SUCCEEDED, answer["result"]["error_code"]
    await rests(lab, GOAL)


async def test_planning_alone_moves_nothing(lab: Lab) -> None:
    assert (await move(lab, goal=joint_goal(GOAL)))["status"] == SUCCEEDED
    await rests(lab, GOAL)
    before = stands(lab)
    answer = await move(lab, planning_options={"plan_only": True}, goal=joint_goal(HOME))
    assert answer["status"] == SUCCEEDED
    assert answer["result"]["planned_trajectory"]["joint_trajectory"]["points"]
    assert stands(lab) == pytest.approx(before, abs=1e-3)
