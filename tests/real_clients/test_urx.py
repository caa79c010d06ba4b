"""python-urx: waits for moves by packets of the secondary port, reads forces from the realtime port.

``urx.URRobot`` and not ``urx.Robot``, which uses an interface that math3d 4 removed.
"""

from collections.abc import Iterator

import pytest
import urx
from rig import START_Q, Rig
from urx.robotiq_two_finger_gripper import Robotiq_Two_Finger_Gripper

pytestmark = [
    pytest.mark.robot_speed(3),
    pytest.mark.parametrize("rig", ["ur3 3.4"], indirect=True),
    pytest.mark.filterwarnings("ignore:notifyAll:DeprecationWarning"),  # its threads call the old name
]

FAST = {"acc": 1.0, "vel": 0.5}


@pytest.fixture
def robot(rig: Rig) -> Iterator[urx.URRobot]:
    robot = urx.URRobot(rig.host, use_rt=True)
    yield robot
    robot.close()
    robot.rtmon.join()


def test_monitors_agree_with_rtde(rig: Rig, robot: urx.URRobot) -> None:
    with rig.watch() as state:
        sample = state.newest()
    assert robot.is_running()
    assert not robot.is_program_running()
    assert robot.getj(wait=True) == pytest.approx(sample["actual_q"])
    assert robot.getl(wait=True) == pytest.approx(sample["actual_TCP_pose"], abs=1e-9)
    realtime = robot.get_realtime_monitor()
    assert realtime.q_actual(wait=True) == pytest.approx(sample["actual_q"])
    assert realtime.q_target(wait=True) == pytest.approx(sample["actual_q"])
    assert realtime.tcf_pose(wait=True) == pytest.approx(sample["actual_TCP_pose"], abs=1e-9)
    assert robot.get_tcp_force() == pytest.approx([0] * 6)


def test_all_parts_of_the_secondary_packet(robot: urx.URRobot) -> None:
    data = robot.secmon.get_all_data(wait=True)
    assert set(data) >= {"RobotModeData", "JointData", "ToolData", "MasterBoardData", "CartesianInfo", "ForceModeData"}
    assert data["RobotModeData"]["robotMode"] == 7
    assert data["RobotModeData"]["speedFraction"] == 1.0
    assert data["MasterBoardData"]["robotVoltage48V"] == pytest.approx(48, abs=2)
    assert data["JointData"]["jointMode0"] == 253  # running


def test_joint_moves_block_until_done(robot: urx.URRobot) -> None:
    goal = [q + 0.1 for q in START_Q]
    assert robot.movej(goal, **FAST) == pytest.approx(goal)
    robot.movej([-0.1] * 6, **FAST, relative=True)
    assert robot.getj() == pytest.approx(START_Q)


@pytest.mark.parametrize("command", ["movel", "movep", "servoc"])
def test_linear_moves_block_until_done(robot: urx.URRobot, command: str) -> None:
    goal = robot.getl(wait=True)
    goal[2] += 0.05
    getattr(robot, command)(goal, **FAST)
    assert robot.getl() == pytest.approx(goal, abs=1e-5)  # it sends six decimals


def test_arcs_and_blended_paths_block_until_done(robot: urx.URRobot) -> None:
    start = robot.getl(wait=True)
    via, goal = list(start), list(start)
    via[0] += 0.03
    via[2] += 0.03
    goal[0] += 0.06
    assert robot.movec(via, goal, acc=0.5, vel=0.2) == pytest.approx(goal, abs=1e-5)
    assert robot.movels([via, start], acc=0.5, vel=0.2, radius=0.005) == pytest.approx(start, abs=1e-5)


@pytest.mark.parametrize(
    ("move", "stop"),
    [
        (lambda robot: robot.movej([q + 1 for q in START_Q], **FAST, wait=False), "stopj"),
        (lambda robot: robot.speedx("speedl", [0, 0, 0.05, 0, 0, 0], 0.5, 5.0), "stopl"),
        (lambda robot: robot.speedx("speedj", [0.1, 0, 0, 0, 0, 0], 0.5, 5.0), "stopj"),
    ],
    ids=["movej", "speedl", "speedj"],
)
def test_a_stop_ends_a_move(rig: Rig, robot: urx.URRobot, move, stop: str) -> None:
    with rig.watch() as state:
        move(robot)
        state.wait_until_moving()
        rig.eventually(robot.is_program_running)
        getattr(robot, stop)()
        state.wait_until_still(timeout_s=2.0)
    rig.eventually(lambda: not robot.is_program_running())
    assert robot.getj(wait=True) != pytest.approx(START_Q)


def test_outputs_and_tool(rig: Rig, robot: urx.URRobot) -> None:
    robot.set_digital_out(3, True)
    rig.eventually(lambda: robot.get_digital_out(3) == 1)
    assert robot.get_digital_out_bits() == 1 << 3
    robot.set_tool_voltage(12)
    rig.eventually(lambda: robot.secmon.get_all_data()["ToolData"]["toolOutputVoltage"] == 12)
    before = robot.getl(wait=True)
    robot.set_tcp((0, 0, 0.1, 0, 0, 0))
    rig.eventually(lambda: robot.getl() != pytest.approx(before))
    assert sum((a - b) ** 2 for a, b in zip(robot.getl()[:3], before[:3], strict=True)) == pytest.approx(0.01)


def test_a_log_message_that_is_not_script_is_ignored(robot: urx.URRobot) -> None:
    robot.send_message("hello there")  # goes out without quotes
    goal = [q + 0.05 for q in START_Q]
    assert robot.movej(goal, **FAST) == pytest.approx(goal)


def test_freedrive_until_disabled(rig: Rig, robot: urx.URRobot) -> None:
    robot.set_freedrive(True)
    rig.eventually(robot.is_program_running)
    robot.set_freedrive(False)
    rig.eventually(lambda: not robot.is_program_running())


def test_gripper_through_a_script_on_the_robot(rig: Rig, robot: urx.URRobot) -> None:
    gripper = Robotiq_Two_Finger_Gripper(robot)
    gripper.close_gripper()
    assert rig.gripper_position() > 200
    gripper.open_gripper()
    assert rig.gripper_position() < 20


def test_reconnecting(rig: Rig) -> None:
    for _ in range(3):
        with urx.URRobot(rig.host) as robot:
            assert robot.getj() == pytest.approx(START_Q)
