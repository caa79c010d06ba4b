"""The ROS 2 driver before a plain rclpy program in another process: what it offers, and what it outlives."""

import asyncio
import os
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
from driver_rig import HOME, driver_options, emulator
from ros2_requests import SUCCEEDED, TRIGGER, begin, follow, shifted, states, until
from ros2_rig import HOST, PATIENCE_S, SCALED, Lab, in_this_process, laboratory

from client.errors import ClientError
from client.ros2.control_side import ControlSide
from client.ros2.driver import DriverOptions, Ros2Driver
from client.ros2.host import NodeHost, interface_if_any
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES
from urproto.robots import load_model
from urproto.structures import load_yaml

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

OFFICIAL = load_yaml(Path(__file__).with_name("official_driver.yaml").read_text("utf-8"))["nodes"]
RUNNING = "/io_and_status_controller/robot_program_running"
_ACTION = "/_action/send_goal"


def named(node: str, names: dict[str, str]) -> dict[str, list[str]]:
    """Names as the file has them, in full."""
    return {name.replace("~", node) if name[0] in "~/" else f"/{name}": [kind] for name, kind in names.items()}


def lacking(node: str, wanted: dict[str, Any], found: dict[str, dict[str, list[str]]]) -> Iterator[str]:
    """What a node of the official driver has that this one has not, or not with this type.

    Nor has this one anything of a type that the distribution does not have.
    """
    absent = named(node, wanted.get("absent", {}))
    for group in ("publishes", "listens", "services"):
        for name, kind in named(node, wanted.get(group, {})).items():
            if (found[group].get(name) == kind) == (name in absent or interface_if_any(kind[0]) is None):
                yield f"{node} {group} {name}"
    for name, (kind,) in named(node, wanted.get("actions", {})).items():
        if found["services"].get(name + _ACTION) != ([f"{kind}_SendGoal"] if interface_if_any(kind) else None):
            yield f"{node} {name}"


async def test_nodes_topics_services_and_actions_are_those_of_the_official_driver(lab: Lab) -> None:
    """Each of them, as docs/reference/ros2_interfaces.md has it: absent is what the table says, and nothing else."""

    def differences(graph: dict[str, Any]) -> list[str]:
        nodes = graph["nodes"]
        found = []
        for name, wanted in OFFICIAL.items():
            if (f"/{name}" in nodes) == ("node" in wanted.get("absent", {})):
                found.append(name)
            elif f"/{name}" in nodes:
                found += lacking(f"/{name}", wanted, nodes[f"/{name}"])
        return found

    assert differences(await lab.peer.graph(lambda graph: not differences(graph))) == []


async def test_states_of_the_arm_are_published(lab: Lab) -> None:
    state = await lab.peer.echo("/joint_states", "sensor_msgs/msg/JointState", new=True)
    assert tuple(state["name"]) == JOINT_NAMES
    assert state["position"] == pytest.approx(HOME, abs=1e-3)
    assert abs(state["header"]["stamp"]["sec"] - time.time()) < 5.0
    everything = await lab.peer.echo("/dynamic_joint_states", "control_msgs/msg/DynamicJointState")
    assert {"elbow_joint", "gpio", "tcp_pose"} <= set(everything["joint_names"])
    scaling = "/speed_scaling_state_broadcaster/speed_scaling"
    async with timeout(PATIENCE_S):  # the program has just begun, and the robot comes up to speed
        while (await lab.peer.echo(scaling, "std_msgs/msg/Float64", new=True))["data"] != pytest.approx(100.0):
            pass
    running = await lab.peer.echo("/io_and_status_controller/robot_program_running", "std_msgs/msg/Bool", latched=True)
    assert running["data"] is True
    description = await lab.peer.echo("/robot_description", "std_msgs/msg/String", latched=True)
    assert "shoulder_pan_joint" in description["data"]
    frames = await lab.peer.echo("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
    assert {"base", "tool0"} <= {one["child_frame_id"] for one in frames["transforms"]}
    moving = await lab.peer.echo("/tf", "tf2_msgs/msg/TFMessage")
    assert moving["transforms"]


async def test_the_program_is_lost_and_comes_back(lab: Lab) -> None:
    assert (await lab.peer.call("/io_and_status_controller/hand_back_control", TRIGGER))["success"]
    while (await lab.peer.echo(RUNNING, "std_msgs/msg/Bool", latched=True))["data"]:
        pass
    while (await states(lab))[SCALED] == "active":
        pass
    assert not await begin(lab, SCALED, HOME, 1.0)
    assert (await lab.peer.call("/io_and_status_controller/resend_robot_program", TRIGGER))["success"]
    while not (await lab.peer.echo(RUNNING, "std_msgs/msg/Bool", latched=True))["data"]:
        pass
    while (await states(lab))[SCALED] != "active":
        pass
    assert (await follow(lab, SCALED, shifted(0.1), 1.0))["status"] == SUCCEEDED


@pytest.mark.asyncio(loop_scope="function")
async def test_a_robot_that_goes_and_comes_back_finds_the_driver_where_it_was() -> None:
    controller = ControllerConfig(model=load_model("ur3"), initial_q=HOME, running=True)
    address = f"127.17.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250 + 1}"  # its usual ports, but not everybody's
    config = EmulatorConfig(controller=controller, host=address)
    free = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
    async with AsyncExitStack() as first:
        robot = await first.enter_async_context(Emulator(config))
        async with laboratory(robot, {**free, "silence_s": 3.0}, host=address) as lab:
            await until(lab, lambda now: now[SCALED] == "active")
            await first.aclose()
            await until(lab, lambda now: now[SCALED] == "inactive")
            while (await lab.peer.echo(RUNNING, "std_msgs/msg/Bool", latched=True))["data"]:
                pass
            assert not (await lab.peer.call("/io_and_status_controller/set_io", "ur_msgs/srv/SetIO", fun=1))["success"]
            listing = "controller_manager_msgs/srv/ListHardwareComponents"
            (arm,) = (await lab.peer.call("/controller_manager/list_hardware_components", listing))["component"]
            assert arm["state"]["label"] == "inactive"
            async with Emulator(config):
                await until(lab, lambda now: now[SCALED] == "active")
                assert (await follow(lab, SCALED, shifted(0.1), 1.0))["status"] == SUCCEEDED


@pytest.mark.asyncio(loop_scope="function")
@each_row(
    ("options", "words"),
    [
        ({"tf_prefix": "left-"}, "is not a valid prefix"),
        ({"namespace": "1left"}, "rejects the namespace or arguments: Invalid namespace"),
        ({"ros_arguments": ("-p", "nonsense")}, "rejects the namespace or arguments: "),
        ({"controller": "knee_controller"}, "the controllers here are .*scaled_joint_trajectory_controller"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
async def test_options_that_make_no_sense_are_refused_in_words(options: dict[str, Any], words: str) -> None:
    async with emulator("ur3") as robot:
        with pytest.raises(ClientError, match=words):
            async with laboratory(robot, driver_options(robot), **options):
                pass


@pytest.mark.asyncio(loop_scope="function")
async def test_a_driver_that_is_cancelled_while_it_makes_a_node_leaves_none(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, at_work, go_on = asyncio.get_running_loop(), asyncio.Event(), threading.Event()
    spin, before = NodeHost.spin, set(threading.enumerate())  # with the nodes of the other tests

    def held(host: NodeHost, node: Any) -> None:
        loop.call_soon_threadsafe(at_work.set)
        assert go_on.wait(PATIENCE_S)
        spin(host, node)

    monkeypatch.setattr(NodeHost, "spin", held)
    async with emulator("ur3") as robot, in_this_process(ControlSide()) as link:
        opening = asyncio.ensure_future(Ros2Driver(DriverOptions(HOST, driver_options(robot)), link).__aenter__())
        await at_work.wait()
        opening.cancel()
        loop.call_later(0.2, go_on.set)
        with pytest.raises(asyncio.CancelledError):
            await opening
    assert [thread.name for thread in set(threading.enumerate()) - before if thread.name.startswith("ros ")] == []
