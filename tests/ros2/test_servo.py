"""Topics and services of MoveIt Servo, for a plain rclpy program in another process."""

from typing import Any

import pytest
from ros2_requests import TRIGGER, needs, only, q
from ros2_rig import SCALED, Lab

from client.controllers.servo import ServoStatus
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES
from urproto.robots import kinematics_of, load_model
from urproto.robots.pose import pose_inv, pose_trans, rotvec_to_quaternion

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

ARM = kinematics_of(load_model("ur5e"))
TWIST, JOG, POSE = "geometry_msgs/msg/TwistStamped", "control_msgs/msg/JointJog", "geometry_msgs/msg/PoseStamped"
CHOICE, STATUS = "moveit_msgs/srv/ServoCommandType", "moveit_msgs/msg/ServoStatus"
POSITIONS, SPEEDS = "forward_position_controller", "forward_velocity_controller"
TOPICS = {TWIST: "delta_twist_cmds", JOG: "delta_joint_cmds", POSE: "pose_target_cmds"}


def twist(frame: str = "base_link", **parts: Any) -> dict[str, Any]:
    return {"header": {"frame_id": frame}, "twist": parts}


async def send(lab: Lab, kind: str, message: dict[str, Any]) -> None:
    await lab.peer.request(publish=f"/servo_node/{TOPICS[kind]}", type=kind, message=message)


async def start(lab: Lab, controller: str = POSITIONS) -> None:
    await only(lab, controller)
    assert (await lab.peer.call("/servo_node/start_servo", TRIGGER))["success"]


async def servo_until(lab: Lab, done: Any, kind: str, message: dict[str, Any]) -> None:
    async with timeout(60.0):
        while not done():
            await send(lab, kind, message)


async def rest(lab: Lab) -> None:
    async with timeout(60.0):
        while max(map(abs, lab.robot.controller.snapshot.actual_qd)) > 1e-4 or lab.side.servo._q is not None:
            await lab.control.driver.link.next_state()


@pytest.mark.parametrize(
    ("frame", "parts", "axis", "sign", "controller"),
    [
        ("base_link", {"linear": {"z": 0.05}}, 2, 1.0, POSITIONS),
        ("base_link", {"linear": {"x": 0.05}}, 0, -1.0, POSITIONS),  # base_link is turned by 180 degrees
        ("base", {"linear": {"y": -0.05}}, 1, -1.0, SPEEDS),
        ("tool0", {"linear": {"y": 0.05}}, 1, 1.0, POSITIONS),
        ("", {"linear": {"x": 0.05}}, 0, 1.0, POSITIONS),  # the tool's frame
    ],
)
async def test_a_twist_moves_the_flange_along_the_axes_of_its_frame(
    lab: Lab, frame: str, parts: dict[str, Any], axis: int, sign: float, controller: str
) -> None:
    await start(lab, controller)
    before = ARM.forward(q(lab))
    base = (*before[:3], 0.0, 0.0, 0.0) if frame.startswith("base") else before

    def moved() -> list[float]:
        return list(pose_trans(pose_inv(base), ARM.forward(q(lab)))[:3])

    await servo_until(lab, lambda: moved()[axis] * sign > 0.01, TWIST, twist(frame, **parts))
    await rest(lab)
    off = moved()
    assert off.pop(axis) * sign > 0.01
    assert max(map(abs, off)) < 0.002


async def test_joints_are_jogged_and_rest_when_no_more_commands_come(lab: Lab) -> None:
    await start(lab)
    before = q(lab)
    jog = {"joint_names": [JOINT_NAMES[5]], "velocities": [0.3]}
    await servo_until(lab, lambda: q(lab)[5] > before[5] + 0.03, JOG, jog)
    await rest(lab)
    assert max(abs(a - b) for a, b in zip(q(lab)[:5], before[:5], strict=True)) < 1e-3
    there = q(lab)
    await lab.control.driver.link.next_state()
    assert max(abs(a - b) for a, b in zip(q(lab), there, strict=True)) < 1e-4


async def test_it_stops_before_an_obstacle_of_the_planning_scene(lab: Lab) -> None:
    await start(lab)
    x, y, z, *_ = ARM.forward(q(lab))
    box = {"primitives": [{"type": 1, "dimensions": [0.2, 0.2, 0.1]}]}
    box |= {"id": "table", "header": {"frame_id": "base"}}
    box |= {"pose": {"position": {"x": x, "y": y, "z": z - 0.2}, "orientation": {"w": 1.0}}}
    applied = await lab.peer.call(
        "/apply_planning_scene",
        "moveit_msgs/srv/ApplyPlanningScene",
        scene={"is_diff": True, "world": {"collision_objects": [box]}},
    )
    assert applied["success"]
    try:
        await servo_until(
            lab, lambda: lab.side.servo.status is ServoStatus.HALT_FOR_COLLISION, TWIST, twist(linear={"z": -0.1})
        )
        await rest(lab)
        assert z - 0.15 < ARM.forward(q(lab))[2] < z - 0.02
        await servo_until(lab, lambda: ARM.forward(q(lab))[2] > z, TWIST, twist(linear={"z": 0.1}))
    finally:
        assert (await lab.peer.call("/apply_planning_scene", "moveit_msgs/srv/ApplyPlanningScene"))["success"]
    await rest(lab)


async def test_commands_without_a_controller_that_executes_them(lab: Lab) -> None:
    needs(STATUS)
    await start(lab, SCALED)
    before, code = q(lab), None
    async with timeout(60.0):
        while code != ServoStatus.INVALID:
            await send(lab, TWIST, twist(linear={"z": 0.1}))
            code = (await lab.peer.echo("/servo_node/status", STATUS, latched=True))["code"]
    await lab.control.driver.link.next_state()
    assert max(abs(a - b) for a, b in zip(q(lab), before, strict=True)) < 1e-4


async def test_the_type_of_commands_is_chosen(lab: Lab) -> None:
    needs(CHOICE)
    await start(lab)
    try:
        assert (await lab.peer.call("/servo_node/switch_command_type", CHOICE, command_type=0))["success"]
        assert not (await lab.peer.call("/servo_node/switch_command_type", CHOICE, command_type=7))["success"]
        before = q(lab)
        for _ in range(5):
            await send(lab, TWIST, twist(linear={"z": 0.1}))
        await lab.control.driver.link.next_state()
        assert max(abs(a - b) for a, b in zip(q(lab), before, strict=True)) < 1e-4
    finally:
        assert (await lab.peer.call("/servo_node/switch_command_type", CHOICE, command_type=2))["success"]
    goal = list(ARM.forward(q(lab)))
    pose = {
        "header": {"frame_id": "base"},
        "pose": {"position": dict(zip("xyz", (goal[0], goal[1], goal[2] + 0.02), strict=True))},
    }
    pose["pose"]["orientation"] = dict(zip("xyzw", rotvec_to_quaternion(*goal[3:]), strict=True))
    await servo_until(lab, lambda: ARM.forward(q(lab))[2] > goal[2] + 0.018, POSE, pose)
    await rest(lab)


async def test_paused_it_does_nothing(lab: Lab) -> None:
    await start(lab)
    assert (await lab.peer.call("/servo_node/stop_servo", TRIGGER))["success"]
    before = q(lab)
    for _ in range(5):
        await send(lab, JOG, {"joint_names": [JOINT_NAMES[5]], "velocities": [0.3]})
    await lab.control.driver.link.next_state()
    assert max(abs(a - b) for a, b in zip(q(lab), before, strict=True)) < 1e-4


async def test_parameters_have_the_names_of_moveit_servo(lab: Lab) -> None:
    async def set_one(name: str, **value: Any) -> dict[str, Any]:
        parameter = {"name": f"moveit_servo.{name}", "value": value}
        answer = await lab.peer.call(
            "/servo_node/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=[parameter]
        )
        result: dict[str, Any] = answer["results"][0]
        return result

    assert (await set_one("scale.linear", type=3, double_value=0.5))["successful"]
    assert lab.side.servo.parameters.scale.linear == 0.5
    refused = await set_one("command_in_type", type=4, string_value="metres")
    assert not refused["successful"]
    assert "choose unitless or speed_units" in refused["reason"]
    assert lab.side.servo.parameters.command_in_type == "speed_units"
