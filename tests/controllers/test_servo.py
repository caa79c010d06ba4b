"""Servoing over joints that do what they are told: speeds, rest, and what slows the motion down."""

import math

import numpy as np
import pytest
from controllers_rig import RATE_HZ, SCALING, Joints

from client.controllers.configuration import ControllersFile
from client.controllers.manager import ControllerManager
from client.controllers.servo import ACCELERATION_RAD_S2, Servo, ServoParameters, ServoScale, ServoStatus
from client.errors import ClientError
from tests.rows import each_row
from urproto.joints import JOINT_NAMES
from urproto.robots import kinematics_of, load_model
from urproto.robots.pose import pose_sub

MODEL = load_model("ur5e")
KINEMATICS = kinematics_of(MODEL)
HOME = (0.3, -1.4, 1.6, -1.5, -1.3, 0.2)
POSITIONS, SPEEDS = "forward_position_controller", "forward_velocity_controller"
PERIOD_S = 1.0 / RATE_HZ
TYPES = dict.fromkeys((POSITIONS, SPEEDS), "forward_command_controller/ForwardCommandController")


class Rig:
    def __init__(self, q=HOME, active=POSITIONS):
        self.joints = Joints(JOINT_NAMES)
        for name, angle in zip(JOINT_NAMES, q, strict=True):
            self.joints.states[f"{name}/position"] = angle
        parameters = {
            POSITIONS: {"joints": list(JOINT_NAMES), "interface_name": "position"},
            SPEEDS: {"joints": list(JOINT_NAMES), "interface_name": "velocity"},
        }
        self.manager = ControllerManager(self.joints, ControllersFile("test", TYPES, parameters), RATE_HZ)
        self.servo = Servo(self.manager, MODEL)
        self.manager.on_cycle.append(self.servo.update)
        self.seen = []
        self.servo.on_status.append(self.seen.append)
        self.time_s = 10.0
        self.cycle()
        if active:
            self.manager.activate(active)
            self.cycle()

    def cycle(self, count=1):
        for _ in range(count):
            self.time_s += PERIOD_S
            self.manager.cycle({}, self.time_s, PERIOD_S)

    def keep(self, command, seconds):
        """Repeat a command every other cycle; returns the configurations (n, 6)."""
        path = []
        for number in range(round(seconds * RATE_HZ)):
            if number % 2 == 0:
                command()
            self.cycle()
            path.append(self.q)
        return np.array(path)

    def rest(self):
        """Cycles until the arm is where it was a cycle ago."""
        for _ in range(1000):
            before = self.q
            self.cycle()
            if self.q == before and self.servo.motion().qd_rad_s == (0.0,) * 6:
                return
        raise AssertionError("it does not come to rest")

    @property
    def q(self):
        return tuple(self.joints.states[f"{name}/position"] for name in JOINT_NAMES)

    @property
    def flange(self):
        return KINEMATICS.forward(self.q)


def turning(rig, joint="wrist_3_joint", speed=0.5):
    return lambda: rig.servo.jog({joint: speed})


@pytest.mark.parametrize("active", [POSITIONS, SPEEDS])
def test_joints_reach_the_speed_of_a_jog_with_the_acceleration_and_rest_once_it_expires(active):
    rig = Rig(active=active)
    path = rig.keep(turning(rig), 1.0)
    speeds = np.diff(path[:, 5]) / PERIOD_S
    assert np.abs(np.diff(speeds)).max() <= ACCELERATION_RAD_S2 * PERIOD_S * 1.001
    assert speeds[-1] == pytest.approx(0.5)
    assert np.allclose(path[:, :5], HOME[:5])
    end = rig.q[5]
    rig.rest()
    expired = rig.servo.parameters.incoming_command_timeout * 0.5
    assert rig.q[5] - end == pytest.approx(expired + 0.5**2 / (2 * ACCELERATION_RAD_S2), abs=0.02)
    rested = rig.q
    rig.cycle(200)
    assert rig.q == rested
    assert rig.seen == []


def test_the_flange_follows_a_twist_along_the_axes_of_the_base():
    rig = Rig()
    start = rig.flange
    rig.keep(lambda: rig.servo.twist((0.05, -0.03, 0.02, 0.0, 0.0, 0.0)), 1.0)
    rig.rest()
    off = np.array(pose_sub(rig.flange, start))
    assert np.allclose(off[:3] / np.linalg.norm(off[:3]), np.array((5, -3, 2)) / math.sqrt(38), atol=2e-3)
    assert np.allclose(off[3:], 0.0, atol=2e-3)
    before = rig.flange
    rig.keep(lambda: rig.servo.twist((0.0, 0.0, 0.0, 0.0, 0.0, 0.2)), 1.0)
    rig.rest()
    off = np.array(pose_sub(rig.flange, before))
    assert np.allclose(off[:3], 0.0, atol=2e-3)
    assert np.allclose(off[3:5], 0.0, atol=2e-3)
    assert off[5] == pytest.approx(0.2 * 1.1, abs=0.02)


def test_a_pose_is_reached_and_kept():
    rig = Rig()
    goal = KINEMATICS.forward([angle + 0.15 for angle in HOME])
    path = rig.keep(lambda: rig.servo.pose(goal), 3.0)
    off = pose_sub(rig.flange, goal)
    near = rig.servo.parameters.pose_tracking
    assert math.hypot(*off[:3]) < near.linear_tolerance * 1.1
    assert math.hypot(*off[3:]) < near.angular_tolerance * 1.1
    assert np.abs(path[-1] - path[-20]).max() < 1e-3


def test_the_robots_speed_scaling_counts():
    paths = []
    for scaling in (1.0, 0.25, 0.0):
        rig = Rig()
        rig.joints.states[SCALING] = scaling
        paths.append(np.diff(rig.keep(turning(rig, speed=0.2), 0.5)[:, 5])[-1])
    assert paths == pytest.approx([0.2 * PERIOD_S, 0.05 * PERIOD_S, 0.0])


@each_row(
    ("share", "status"),
    [(1.0, None), (0.5, ServoStatus.DECELERATE_FOR_COLLISION), (0.0, ServoStatus.HALT_FOR_COLLISION)],
)
def test_obstacles_slow_it_down(share, status):
    rig = Rig()
    rig.servo.jog({"elbow_joint": 0.4})
    rig.servo.limit(share)
    path = rig.keep(turning(rig, "elbow_joint", 0.4), 0.5)
    assert (path[-1, 2] - path[-2, 2]) / PERIOD_S == pytest.approx(0.4 * share)
    assert (rig.seen[-1:] or [None])[0] == status
    rig.rest()
    assert rig.servo.motion().status is ServoStatus.NO_WARNING
    assert np.diff(rig.keep(turning(rig, "elbow_joint", 0.4), 0.5)[:, 2])[-1] == pytest.approx(0.4 * PERIOD_S)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_joint_stops_before_its_limit_and_may_leave_it(direction):
    limit = (MODEL.q_max if direction > 0 else MODEL.q_min)[2] - direction * 0.1
    rig = Rig((*HOME[:2], limit - direction * 0.5, *HOME[3:]))
    fast = direction * MODEL.qd_max[2]
    path = rig.keep(turning(rig, "elbow_joint", fast), 3.0)
    assert abs(path[-1, 2] - limit) < 5e-3
    assert (direction * (path[:, 2] - limit)).max() < 5e-3
    assert rig.seen[0] is ServoStatus.JOINT_BOUND
    back = rig.keep(turning(rig, "elbow_joint", -fast), 0.2)
    assert direction * (back[-1, 2] - limit) < -0.02


def test_no_joint_is_faster_than_the_arm_allows():
    rig = Rig()
    path = rig.keep(lambda: rig.servo.jog(dict.fromkeys(JOINT_NAMES, 10.0)), 0.9)
    assert np.abs(np.diff(path, axis=0)).max() / PERIOD_S <= min(MODEL.qd_max) * 1.001


def test_it_stops_before_a_singularity_and_leaves_it_slowly():
    rig = Rig((0.0, -1.2, 0.9, -1.5, -1.5, 0.0))
    out = (0.15, 0.0, 0.0, 0.0, 0.0, 0.0)  # towards the stretched arm
    way = -1.0 if rig.flange[0] < 0 else 1.0
    path = rig.keep(lambda: rig.servo.twist([way * part for part in out]), 6.0)
    assert ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY in rig.seen
    assert rig.servo.motion().status in (
        ServoStatus.HALT_FOR_SINGULARITY,
        ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY,
    )
    assert np.abs(np.diff(path, axis=0)).max() / PERIOD_S < max(MODEL.qd_max)
    assert np.abs(path[-1] - path[-50]).max() < 5e-3
    assert abs(rig.q[2]) > 0.01
    rig.seen.clear()
    back = rig.keep(lambda: rig.servo.twist([-way * part for part in out]), 3.0)
    assert ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY in rig.seen
    assert abs(back[-1, 2]) > abs(path[-1, 2]) + 0.1


def test_unitless_commands_are_scaled():
    rig = Rig()
    rig.servo.configure(ServoParameters(command_in_type="unitless", scale=ServoScale(0.1, 0.2, 0.3)))
    start = rig.flange
    path = rig.keep(turning(rig, "elbow_joint", 1.0), 0.5)
    assert (path[-1, 2] - path[-2, 2]) / PERIOD_S == pytest.approx(0.3)
    rig = Rig()
    rig.servo.configure(ServoParameters(command_in_type="unitless", scale=ServoScale(0.1, 0.2, 0.3)))
    rig.keep(lambda: rig.servo.twist((0.0, 0.0, 0.5, 0.0, 0.0, 0.0)), 0.5)
    before = rig.flange
    rig.keep(lambda: rig.servo.twist((0.0, 0.0, 0.5, 0.0, 0.0, 0.0)), 0.5)
    assert rig.flange[2] - before[2] == pytest.approx(0.025, rel=0.02)
    assert start[2] < before[2]


def test_commands_that_cannot_be_executed():
    rig = Rig(active=None)
    with pytest.raises(ClientError, match="activate forward_position_controller"):
        rig.servo.jog({"wrist_3_joint": 0.1})
    rig = Rig()
    with pytest.raises(ClientError, match="no joint 'knee_joint'"):
        rig.servo.jog({"knee_joint": 0.1})
    with pytest.raises(ClientError, match="not finite"):
        rig.servo.twist((math.nan, 0.0, 0.0, 0.0, 0.0, 0.0))
    rig.cycle(50)
    assert rig.q == HOME


def test_it_ends_with_its_controller_and_begins_where_the_arm_is():
    rig = Rig()
    rig.keep(turning(rig), 0.5)
    rig.manager.deactivate(POSITIONS)
    rig.cycle(20)
    assert rig.seen == [ServoStatus.INVALID]
    there = rig.q
    rig.cycle(20)
    assert rig.q == there
    rig.joints.states["elbow_joint/position"] = 1.2  # moved by someone else
    rig.manager.activate(POSITIONS)
    path = rig.keep(turning(rig), 0.1)
    assert np.allclose(path[:, 2], 1.2)


@each_row(
    ("parameters", "message"),
    [
        ({"command_in_type": "metres"}, "choose unitless or speed_units"),
        ({"lower_singularity_threshold": 300.0}, "below hard_stop_singularity_threshold"),
        ({"incoming_command_timeout": 0.0}, "incoming_command_timeout must be above 0"),
        ({"collision_check_rate": math.nan}, "collision_check_rate must be above 0"),
    ],
)
def test_parameters_that_make_no_sense(parameters, message):
    with pytest.raises(ClientError, match=message):
        ServoParameters(**parameters)
