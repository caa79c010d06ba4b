"""Names, types and settings of ROS 2, without a network."""

from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from client.controllers.io_and_status import IOStates, ToolData
from client.errors import Ros2Error
from client.recording.definitions import message_type
from client.ros2.dds import check_namespace, check_prefix, dds_topic, dds_type, resolved
from client.ros2.domain import read_domain
from client.ros2.messages import PUBLICATIONS, SUBSCRIPTIONS, Moment, Publication, Scene, Subscription
from client.ros2.transforms import Frames
from client.ros2.type_hash import type_hash
from urproto.joints import JOINT_NAMES
from urproto.robots import load_model

PAGE = Path(__file__).resolve().parents[2] / "docs" / "ros2.md"
TYPES = sorted({row.type for row in (*PUBLICATIONS, *SUBSCRIPTIONS)} | {"std_msgs/msg/String"})


def test_names_on_dds() -> None:
    assert dds_topic("/joint_states") == "rt/joint_states"
    assert dds_type("sensor_msgs/msg/JointState") == "sensor_msgs::msg::dds_::JointState_"
    assert resolved("/tf", "/left", "node") == "/tf"
    assert resolved("joint_states", "/left", "node") == "/left/joint_states"
    assert resolved("~/wrench", "", "node") == "/node/wrench"


@pytest.mark.parametrize(
    ("text", "namespace"), [("", ""), ("/", ""), ("left", "/left"), ("/cell_1/left", "/cell_1/left")]
)
def test_namespaces(text: str, namespace: str) -> None:
    assert check_namespace(text) == namespace


@pytest.mark.parametrize("text", ["1left", "left/", "a__b", "a b", "ä", "//a", "a//b", "~"])
def test_what_is_no_namespace(text: str) -> None:
    with pytest.raises(Ros2Error, match="is not a namespace"):
        check_namespace(text)


def test_what_is_no_prefix() -> None:
    assert check_prefix("left_") == "left_"
    for text in ("1_", "a b", "x-"):
        with pytest.raises(Ros2Error, match="is not a prefix"):
            check_prefix(text)


@pytest.mark.parametrize("row", [*PUBLICATIONS, *SUBSCRIPTIONS], ids=lambda row: row.name)
def test_the_page_has_every_topic(row: Publication | Subscription) -> None:
    lines = [
        line for line in PAGE.read_text().splitlines() if line.startswith("|") and row.type in line.replace("`", "")
    ]
    assert any(row.name.removeprefix("~") in line for line in lines), f"docs/ros2.md lacks {row.name}, {row.type}"


@pytest.mark.parametrize("name", TYPES)
def test_hashes_are_those_that_rosbags_computes(name: str) -> None:
    kind = message_type(name)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(kind.definition, name))
    assert type_hash(kind) == store.hash_rihs01(name)


def test_a_hash_that_ros_itself_prints() -> None:
    """Of ``ros2 topic info -v /tf``, as issues of ROS 2 quote it."""
    expected = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    assert type_hash(message_type("tf2_msgs/msg/TFMessage")) == expected


def test_the_domain_is_that_of_the_environment() -> None:
    usual = read_domain({})
    assert (usual.id, usual.reach, usual.notes) == (0, "every node of the network", ())
    assert "AllowMulticast" not in usual.configs[0]
    assert [read_domain({"ROS_DOMAIN_ID": text}).id for text in ("7", "0x10", "017")] == [7, 16, 15]
    assert read_domain({"ROS_DOMAIN_ID": "7"}, 3).id == 3
    assert read_domain({"CYCLONEDDS_URI": "<A/>"}).configs[0].endswith("</CycloneDDS>,<A/>")


@pytest.mark.parametrize(
    "environment", [{"ROS_LOCALHOST_ONLY": "1"}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}], ids=str
)
def test_this_machine_only(environment: dict[str, str]) -> None:
    domain = read_domain(environment | {"CYCLONEDDS_URI": ""})
    assert domain.reach == "nodes of this machine"
    assert all("<AllowMulticast>false<" in config and '"localhost"' in config for config in domain.configs)
    assert "127.0.0.1" in domain.configs[0]
    named = read_domain(environment | {"CYCLONEDDS_URI": "<General><NetworkInterface name='x'/></General>"})
    assert "127.0.0.1" not in named.configs[0]


def test_other_ranges() -> None:
    peers = {"ROS_STATIC_PEERS": "10.0.0.1;<b>", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert '<Peer address="10.0.0.1"/><Peer address="&lt;b&gt;"/>' in read_domain(peers).configs[0]
    off = read_domain(peers | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    assert "ros_discovery_off_" in off.configs[0]
    assert off.notes == ("ROS_STATIC_PEERS has no effect with the discovery range OFF",)
    assert read_domain({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}).configs == ("",)
    odd = read_domain({"ROS_AUTOMATIC_DISCOVERY_RANGE": "MOON"})
    assert odd.reach == "nodes of this machine"
    assert "'MOON'" in odd.notes[0]


@pytest.mark.parametrize("number", ["233", "-1", "x", "08"])
def test_what_is_no_domain(number: str) -> None:
    with pytest.raises(Ros2Error, match="0 to 232"):
        read_domain({"ROS_DOMAIN_ID": number})


def test_times_of_trajectories_are_those_of_this_machine() -> None:
    row = next(row for row in SUBSCRIPTIONS if row.type.endswith("JointTrajectory"))
    kind = message_type(row.type)
    now = Moment(40.0, 1_700_000_000_500_000_000)
    values = {
        "header": {"stamp": {"sec": 1_700_000_002, "nanosec": 0}},
        "joint_names": ["a"],
        "points": [{"positions": [1.0], "time_from_start": {"sec": 1, "nanosec": 250_000_000}}],
    }
    trajectory = row.order(kind.decode(kind.encode(values)), now)
    assert trajectory.stamp_s == pytest.approx(41.5)
    assert (trajectory.joint_names, trajectory.points[0].time_from_start_s) == (("a",), 1.25)
    assert row.order(kind.decode(kind.encode(values | {"header": None})), now).stamp_s == 0.0


def told(topic: str, message: object) -> dict[str, Any]:
    """The fields that arrive of what a controller tells."""
    row = next(row for row in PUBLICATIONS if row.name == topic)
    values = row.message(message, 1_500_000_000, Scene())
    assert values is not None
    kind = message_type(row.type)
    return kind.decode(kind.encode(values))


def test_inputs_and_outputs() -> None:
    levels = tuple(pin == 3 for pin in range(18))
    states = IOStates(levels, levels, (1.0, 2.0), (3.0, 4.0), (0, 1, 1, 0))
    message = told("~/io_states", states)
    assert [one["pin"] for one in message["digital_in_states"] if one["state"]] == [3]
    assert message["analog_in_states"] == [{"pin": 0, "domain": 0, "state": 1.0}, {"pin": 1, "domain": 1, "state": 2.0}]
    assert message["analog_out_states"][0] == {"pin": 0, "domain": 1, "state": 3.0}
    tool = told("~/tool_data", ToolData((0.5, 0.25), (1, 0), 24.0, 0.1, float("nan"), -1))
    assert (tool["analog_input_range2"], tool["analog_input2"], tool["tool_output_voltage"]) == (1, 0.5, 24)


def test_frames_of_joints_that_are_not_the_arms_are_left_out() -> None:
    frames = Frames(load_model("ur3"))
    message = frames.moving(("gripper_joint", JOINT_NAMES[1]), (0.1, 0.2), 0)
    assert [one["child_frame_id"] for one in message["transforms"]] == ["upper_arm_link"]
