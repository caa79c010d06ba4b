"""The ROS 2 bridge against CycloneDDS in another process, which has its types from rosbags."""

import asyncio
import math
import re
import sys
import time

import pytest
from driver_rig import HOME, HOST
from ros2_rig import ENVIRONMENT, SCALED, bridged, cyclone, free_domain

from client.commands import ros2_bridge
from client.commands.control import Target
from client.controllers import JOINT_NAMES
from client.errors import MissingExtraError, Ros2Error
from client.ros2.dds import Participant
from client.ros2.domain import Domain, read_domain
from urproto.robots import kinematics_of, load_model
from urproto.robots.description import urdf
from urproto.robots.pose import pose_trans

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"
ON_E_SERIES = pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
ON_CB3 = pytest.mark.parametrize("robot", ["ur3"], indirect=True)


@pytest.fixture
def domain():
    with free_domain() as number:
        yield number


def moved(*offsets):
    return [q + offset for q, offset in zip(HOME, offsets, strict=True)]


def trajectory(names, *points, stamp=0.0):
    """(time, joint angles) at rest at each."""

    def point(t, q):
        return {"positions": list(q), "velocities": [0.0] * len(q), "time_from_start": ros_time(t)}

    waypoints = [point(t, q) for t, q in points]
    return {"header": {"stamp": ros_time(stamp)}, "joint_names": list(names), "points": waypoints}


def ros_time(seconds):
    return {"sec": int(seconds), "nanosec": int(seconds % 1 * 1e9)}


def pose_of(transform):
    place, turn = transform["translation"], transform["rotation"]
    size = math.hypot(turn["x"], turn["y"], turn["z"])
    scale = 2.0 * math.atan2(size, turn["w"]) / size if size > 1e-12 else 2.0
    return (place["x"], place["y"], place["z"], *(scale * turn[axis] for axis in "xyz"))


def chained(transforms, first, last):
    """The frame ``last`` in ``first``, whatever is in between."""
    parents = {one["child_frame_id"]: one for one in transforms}
    pose, frame = (0.0,) * 6, last
    while frame != first:
        pose = pose_trans(pose_of(parents[frame]["transform"]), pose)
        frame = parents[frame]["header"]["frame_id"]
    return pose


def apart(pose, other):
    """How far the origins are from each other, and the ends of the z axes [m]."""
    ends = [pose_trans(one, (0, 0, 1, 0, 0, 0)) for one in (pose, other)]
    return math.dist(pose[:3], other[:3]), math.dist(ends[0][:3], ends[1][:3])


@ON_E_SERIES
async def test_what_is_told(robot, domain):
    async with bridged(robot, domain, SCALED) as lab, cyclone(domain) as peer:
        state = await peer.hear("/joint_states", "sensor_msgs/msg/JointState")
        assert dict(zip(state["name"], state["position"], strict=True)) == pytest.approx(
            dict(zip(JOINT_NAMES, HOME, strict=True)), abs=1e-3
        )
        assert [len(state[name]) for name in ("velocity", "effort")] == [6, 6]
        assert abs(state["header"]["stamp"]["sec"] - time.time()) < 30
        following = await peer.next("/joint_states")
        assert following["header"]["stamp"] != state["header"]["stamp"]
        scaling = await peer.hear("/speed_scaling_state_broadcaster/speed_scaling", "std_msgs/msg/Float64")
        assert scaling["data"] == pytest.approx(100.0)
        wrench = await peer.hear("/force_torque_sensor_broadcaster/wrench", "geometry_msgs/msg/WrenchStamped")
        assert wrench["header"]["frame_id"] == "tool0_controller"
        pose = await peer.hear("/tcp_pose_broadcaster/pose", "geometry_msgs/msg/PoseStamped")
        assert tuple(pose["pose"]["position"].values()) == pytest.approx(lab.snapshot.actual_TCP_pose[:3], abs=1e-3)
        io = await peer.hear("/io_and_status_controller/io_states", "ur_msgs/msg/IOStates")
        assert [len(io[f"digital_{way}_states"]) for way in ("in", "out")] == [18, 18]


@ON_CB3
async def test_frames_lead_to_the_tool(robot, domain):
    async with bridged(robot, domain) as lab, cyclone(domain) as peer:
        static = await peer.hear("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        transforms = {one["child_frame_id"]: one for one in static["transforms"]}
        assert {"base", "tool0", "flange"} <= set(transforms)
        message = await peer.hear("/tf", "tf2_msgs/msg/TFMessage")
        while not {"wrist_3_link", "tool0_controller"} <= set(transforms):
            transforms |= {one["child_frame_id"]: one for one in message["transforms"]}
            message = await peer.next("/tf")
        flange = kinematics_of(load_model("ur3")).forward(lab.q)
        tool = pose_trans(chained_inverse(transforms.values()), chained(transforms.values(), "base_link", "tool0"))
        assert max(apart(tool, flange)) < 1e-3
        assert max(apart(chained(transforms.values(), "base", "tool0_controller"), flange)) < 1e-3


def chained_inverse(transforms):
    """base_link in base, which is turned by half a turn: its own inverse."""
    return chained(transforms, "base_link", "base")


@ON_E_SERIES
async def test_those_who_come_late_get_what_is_latched(robot, domain):
    async with bridged(robot, domain):
        for _ in range(2):
            async with cyclone(domain) as peer:
                text = await peer.hear("/robot_description", "std_msgs/msg/String", latched=True)
                assert text["data"] == urdf(load_model("ur5e"))
                mode = await peer.hear(
                    "/io_and_status_controller/robot_mode", "ur_dashboard_msgs/msg/RobotMode", latched=True
                )
                assert mode == {"mode": 7}


@ON_E_SERIES
async def test_discovery_says_what_ros_looks_for(robot, domain):
    async with bridged(robot, domain), cyclone(domain) as peer:
        found = await peer.ask(look="/joint_states")
        assert found["found"] == {
            "type": "sensor_msgs::msg::dds_::JointState_",
            "user": "typehash=RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e;",
            "reliable": True,
            "latched": False,
        }
        assert (await peer.ask(look="/tf_static"))["found"]["latched"]


@pytest.mark.parametrize("robot", ["ur3", "ur5e"], indirect=True)
async def test_a_trajectory_moves_the_arm(robot, domain):
    async with bridged(robot, domain, SCALED) as lab, cyclone(domain) as peer:
        there = moved(0.3, -0.2, 0.2, 0.0, -0.3, 0.4)
        goal = trajectory([JOINT_NAMES[i] for i in (5, 3, 1, 0, 2, 4)])
        for step in range(1, 201):  # more than one packet takes
            share = (1 - math.cos(math.pi * step / 200)) / 2
            q = [a + share * (b - a) for a, b in zip(HOME, there, strict=True)]
            goal["points"].append(
                {"positions": [q[i] for i in (5, 3, 1, 0, 2, 4)], "time_from_start": ros_time(step * 0.008)}
            )
        await peer.say(f"/{SCALED}/joint_trajectory", TRAJECTORY, goal)
        await lab.until(lambda: lab.distance(there) < 0.005)
        state = await peer.hear("/joint_states", "sensor_msgs/msg/JointState")
        assert dict(zip(state["name"], state["position"], strict=True)) == pytest.approx(
            dict(zip(JOINT_NAMES, there, strict=True)), abs=0.01
        )


@ON_E_SERIES
async def test_commands_switch_controllers_when_the_arm_rests(robot, domain, caplog):
    async with bridged(robot, domain, SCALED) as lab, cyclone(domain) as peer:
        await peer.say("/forward_position_controller/commands", ARRAY, {"data": moved(0, 0, 0, 0, 0, 0.02)})
        await lab.until(lambda: lab.distance(moved(0, 0, 0, 0, 0, 0.02)) < 0.003 and resting(lab))
        assert not lab.controller(SCALED).active
        there = moved(0.4, 0, 0, 0, 0, 0)
        await peer.say(f"/{SCALED}/joint_trajectory", TRAJECTORY, trajectory(JOINT_NAMES, (2.0, there)))
        await lab.until(lambda: lab.distance(there) < 0.3)  # on the way
        await peer.say("/forward_position_controller/commands", ARRAY, {"data": moved(0, 0, 0, 0, 0, 0)})
        await lab.until(lambda: lab.distance(there) < 0.005)
        assert "scaled_joint_trajectory_controller moves the arm: wait until it rests" in caplog.text


@ON_E_SERIES
async def test_bad_commands_are_told_and_disturb_nothing(robot, domain, caplog):
    bad = {
        "it has no joint elbow,": trajectory(("elbow",), (1.0, [0.1])),
        "leaves out wrist_3_joint": trajectory(JOINT_NAMES[:5], (1.0, HOME[:5])),
        "the trajectory has no points": trajectory(JOINT_NAMES),
        "times have to rise": trajectory(JOINT_NAMES, (1.0, HOME), (0.5, HOME)),
        "has positions that are not numbers": trajectory(JOINT_NAMES, (1.0, [math.nan] * 6)),
        "base for 9.0000 rad": trajectory(JOINT_NAMES, (1.0, [9.0, *HOME[1:]])),
        "it is .* s already": trajectory(JOINT_NAMES, (1.0, HOME), stamp=time.time() - 100.0),
    }
    async with bridged(robot, domain, SCALED) as lab, cyclone(domain) as peer:
        for reason, goal in bad.items():
            await peer.say(f"/{SCALED}/joint_trajectory", TRAJECTORY, goal)
            await told(lab, caplog, f"/{SCALED}/joint_trajectory: a message was refused: .*{reason}")
        await peer.say("/forward_velocity_controller/commands", ARRAY, {"data": [0.1, 0.2]})
        await told(lab, caplog, "forward_velocity_controller: 2 commands came for 6 joints")
        assert lab.controller(SCALED).active  # nothing was switched for it
        assert (lab.distance(), lab.at_rest) == (pytest.approx(0.0, abs=1e-3), True)
        there = moved(0.0, 0, 0, 0, 0, 0.1)
        await peer.say(f"/{SCALED}/joint_trajectory", TRAJECTORY, trajectory(JOINT_NAMES, (0.5, there)))
        await lab.until(lambda: lab.distance(there) < 0.005)


@ON_E_SERIES
async def test_names_and_qualities_that_do_not_fit_are_told(robot, domain, caplog):
    async with bridged(robot, domain, SCALED) as lab, cyclone(domain) as peer, cyclone(domain) as other:
        topic = "/forward_position_controller/commands"
        wrong = await peer.ask(say=topic, type="std_msgs/msg/String", message={}, effort="best")
        assert wrong == {"!": f"nobody hears {topic}"}
        await told(lab, caplog, f"{topic}: somebody publishes it as std_msgs.*String_, but")
        weak = await other.ask(say=topic, type=ARRAY, message={}, effort="best")
        assert weak == {"!": f"nobody hears {topic}"}
        await told(lab, caplog, rf"{topic}: .*not good enough \(reliability\)")


@ON_E_SERIES
async def test_nothing_is_switched_unless_it_may(robot, domain, caplog):
    async with bridged(robot, domain, SCALED, switching=False) as lab, cyclone(domain) as peer:
        await peer.say("/forward_position_controller/commands", ARRAY, {"data": moved(0.1, 0, 0, 0, 0, 0)})
        await told(lab, caplog, "forward_position_controller: it is not active: name it when the bridge is started")
        assert lab.distance() < 0.001


@ON_E_SERIES
async def test_namespace_and_prefix(robot, domain):
    async with bridged(robot, domain, SCALED, prefix="left_", namespace="/cell/left") as lab, cyclone(domain) as peer:
        names = [f"left_{joint}" for joint in JOINT_NAMES]
        state = await peer.hear("/cell/left/joint_states", "sensor_msgs/msg/JointState")
        assert state["name"] == names
        static = await peer.hear("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        assert all(one["child_frame_id"].startswith("left_") for one in static["transforms"])
        there = moved(0.1, 0, 0, 0, 0, 0)
        goal = trajectory(names, (0.5, there))
        await peer.say(f"/cell/left/{SCALED}/joint_trajectory", TRAJECTORY, goal)
        await lab.until(lambda: lab.distance(there) < 0.005)


def resting(lab):
    return max(map(abs, lab.driver.state["actual_qd"])) < 0.001


async def told(lab, caplog, pattern):
    """Wait until a message of the log says so."""
    await lab.until(lambda: re.search(pattern, caplog.text) is not None)
    caplog.clear()


# from the shell


@ON_E_SERIES
async def test_from_the_shell(robot, domain, monkeypatch, capsys):
    monkeypatch.setattr("client.commands.control.ROBOT_PORTS", robot.ports)
    where = read_domain(ENVIRONMENT, domain)
    serving = asyncio.create_task(ros2_bridge.serve(Target(HOST, 0), where, "", [SCALED], True))
    async with cyclone(domain) as peer:
        state = await peer.hear("/joint_states", "sensor_msgs/msg/JointState")
        assert state["name"] == list(JOINT_NAMES)
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)
    told = capsys.readouterr()
    assert f"/{SCALED}/joint_trajectory" in told.out.splitlines()
    assert f"ROS 2 domain {domain}, nodes of this machine" in told.err


async def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "client.ros2.bridge", None)
    with pytest.raises(
        MissingExtraError, match=r"the ROS 2 bridge needs .*: in the folder of ur-emulator, pip install '\.\[ros2\]'"
    ):
        await ros2_bridge.serve(Target(HOST, 0), Domain(0, ("",), ""), "", [SCALED], True)


def test_a_configuration_that_makes_no_sense():
    nonsense = Participant(Domain(7, ("<General><Nonsense/>",), ""))
    with pytest.raises(Ros2Error, match="domain 7: CycloneDDS says"), nonsense:
        pass
