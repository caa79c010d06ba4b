"""The gripper's nodes to a plain rclpy program in another process, as clients of ros2_robotiq_gripper see them."""

import asyncio
import math
import os
from typing import Any

import pytest
from driver_rig import HOST, driver_options, emulator
from ros2_requests import ABORTED, CANCELED, SUCCEEDED, TRIGGER
from ros2_rig import Peer, free_domain, laboratory, peer

from client.gripper import GripperClient
from client.ros2.gripper import GripperNode
from client.ros2.host import NodeHost
from client.ros2.topics import PublishingContext
from urproto.robotiq import MODELS, Fault

pytestmark = pytest.mark.xdist_group("ros2")

ACTION, AGAIN = "/robotiq_gripper_controller/gripper_cmd", "robotiq_gripper_controller/gripper_cmd"  # the same
SINGLE, PARALLEL = "control_msgs/action/GripperCommand", "control_msgs/action/ParallelGripperCommand"
REACTIVATE = "/robotiq_activation_controller/reactivate_gripper"
BOOL, DOUBLE = 1, 3
MODEL = MODELS["robotiq-2f-85"]
CLOSED = 0.7929


async def begin(peer: Peer, position: float, name: str = ACTION) -> bool:
    command = {"position": position, "max_effort": 0.0}
    answer = await peer.request(goal=name, type=SINGLE, request={"command": command})
    return bool(answer["accepted"])


async def move(peer: Peer, position: float) -> tuple[int, dict[str, Any]]:
    assert await begin(peer, position)
    answer = await peer.request(result=ACTION)
    return answer["status"], answer["result"]


async def set_parameter(peer: Peer, name: str, kind: int, **value: Any) -> None:
    service = "/robotiq_gripper_controller/set_parameters"
    wanted = {"name": name, "value": {"type": kind, **value}}
    answer = await peer.call(service, "rcl_interfaces/srv/SetParameters", parameters=[wanted])
    assert answer["results"][0]["successful"]


@pytest.mark.long
async def test_gripper_command() -> None:
    async with emulator("ur5e", speed=2.0, gripper=MODEL) as robot:
        gripper = robot.controller.gripper
        assert gripper is not None
        port = robot.ports["gripper"]
        async with laboratory(robot, driver_options(robot), gripper="robotiq-2f-85", gripper_port=port) as lab:
            status, result = await move(lab.peer, 0.8)  # as ros2_robotiq_gripper's own MoveIt configuration
            assert (status, result["reached_goal"], result["stalled"]) == (SUCCEEDED, True, False), "it was activated"
            assert gripper.get("FOR") == f"{MODEL.force(50.0)}"
            status, result = await move(lab.peer, 0.0)
            assert (status, result["reached_goal"]) == (SUCCEEDED, True)
            state = await lab.peer.echo("/joint_states", "sensor_msgs/msg/JointState", new=True)
            assert state["name"][6:] == ["robotiq_85_left_knuckle_joint"]
            assert (state["position"][6], state["velocity"][6]) == (
                pytest.approx(0.0, abs=0.02),
                pytest.approx(0.0, abs=1.0),
            )
            assert len(state["effort"]) == 7

            gripper.object_mm = 30.0
            status, result = await move(lab.peer, 0.8)
            assert (status, result["reached_goal"], result["stalled"]) == (SUCCEEDED, False, True)
            assert result["position"] == pytest.approx(CLOSED * 55 / 85, abs=0.01)
            await set_parameter(lab.peer, "allow_stalling", BOOL, bool_value=False)
            status, result = await move(lab.peer, 0.8)
            assert (status, result["stalled"]) == (ABORTED, True)

            gripper.object_mm = None
            await set_parameter(lab.peer, "max_velocity", DOUBLE, double_value=0.001)
            assert await begin(lab.peer, 0.0)
            await lab.peer.request(cancel=ACTION)
            assert (await lab.peer.request(result=ACTION))["status"] == CANCELED
            assert gripper.get("GTO") == "0"
            assert await begin(lab.peer, 0.8)
            assert await begin(lab.peer, 0.2, AGAIN)
            assert (await lab.peer.request(result=ACTION))["status"] == ABORTED, "another goal has replaced it"
            answer = await lab.peer.request(result=AGAIN)
            assert answer["status"] == SUCCEEDED
            assert answer["result"]["position"] == pytest.approx(0.2, abs=0.02)

            assert not await begin(lab.peer, math.nan)
            gripper.fail(Fault.OVER_CURRENT)
            while await begin(lab.peer, 0.5):
                assert (await lab.peer.request(result=ACTION))["status"] == ABORTED
            assert (await lab.peer.call(REACTIVATE, TRIGGER))["success"]
            status, result = await move(lab.peer, 0.05)
            assert (status, result["reached_goal"]) == (SUCCEEDED, True)


async def test_parallel_gripper_command_of_a_hand_e() -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    parallel = "robotiq_gripper_controller:type:=parallel_gripper_action_controller/GripperActionController"
    async with emulator("ur3", speed=4.0, gripper=MODELS["robotiq-hand-e"]) as robot:
        with free_domain() as domain:
            async with NodeHost(domain=domain, ros_arguments=("-p", parallel)) as host, peer(domain) as other:
                client = GripperClient(HOST, robot.ports["gripper"])
                node = await asyncio.to_thread(GripperNode, host, client, "robotiq-hand-e", PublishingContext("left_"))
                try:
                    for command, accepted in (
                        ({"position": []}, False),
                        ({"position": [0.0], "velocity": [0.05], "effort": [75.0]}, True),
                    ):
                        answer = await other.request(goal=ACTION, type=PARALLEL, request={"command": command})
                        assert answer["accepted"] == accepted
                    answer = await other.request(result=ACTION)
                finally:
                    await asyncio.to_thread(node.close)
                    await client.close()
        gripper = robot.controller.gripper
        assert gripper is not None
        assert (gripper.get("SPE"), gripper.get("FOR")) == ("59", "128")
    assert (answer["status"], answer["result"]["reached_goal"]) == (SUCCEEDED, True)
    state = answer["result"]["state"]
    assert state["name"] == ["left_robotiq_hande_left_finger_joint"]
    assert state["position"] == pytest.approx([0.0], abs=0.001)
