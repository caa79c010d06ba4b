"""A controller with a calibrated arm: reported values and positions it reaches."""

import math
from pathlib import Path

import pytest

from emulator.config import read_calibration
from emulator.servers.primary_state import kinematics_info
from emulator.virtual import virtual_robot
from urproto.modes import KinematicsStatus
from urproto.robots import Kinematics, RobotModel, kinematics_of, load_model
from urproto.robots.pose import pose_sub

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
START = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)


@pytest.fixture(params=["ur5", "ur5e"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return read_calibration(GOLDEN / f"calibration_{request.param}.yaml", load_model(request.param))


@pytest.fixture
def calibrated(make, model: RobotModel):
    rig = make(model, initial_q=START, running=True)
    rig.tick()
    return rig


def test_the_pose_is_that_of_the_calibration(calibrated, model: RobotModel) -> None:
    pose = calibrated.now.actual_TCP_pose
    assert pose == pytest.approx(kinematics_of(model).forward(START), abs=1e-12)
    assert max(map(abs, pose_sub(pose, Kinematics(model.dh).forward(START)))) > 1e-4


def test_kinematics_info(model: RobotModel) -> None:
    info, nominal = kinematics_info(model), kinematics_info(load_model(model.name))
    assert model.calibration is not None
    assert (info.dh_a, info.dh_d) == (model.calibration.a, model.calibration.d)
    assert nominal.dh_d == model.dh.d
    assert len(set(info.checksum)) == 6
    assert nominal.checksum == (0xFFFFFFFF,) * 6
    assert (info.status, nominal.status) == (KinematicsStatus.LINEARISED, KinematicsStatus.NOT_INITIALISED) == (2, 0)


def test_a_linear_move_is_straight(calibrated) -> None:
    calibrated.script("movel(pose_add(get_actual_tcp_pose(), p[0.05, 0.08, 0.1, 0.2, 0, 0]), a=1, v=0.3)")
    start = calibrated.now.actual_TCP_pose
    places = [start]
    calibrated.until(lambda now: any(now.target_qd))
    while any(calibrated.tick().target_qd):
        places.append(calibrated.now.actual_TCP_pose)
    end = calibrated.now.actual_TCP_pose
    assert [b - a for a, b in zip(start[:3], end[:3], strict=True)] == pytest.approx((0.05, 0.08, 0.1), abs=1e-6)
    length = math.dist(start[:3], end[:3])
    for place in places:
        assert math.dist(start[:3], place[:3]) + math.dist(place[:3], end[:3]) - length < 1e-8


def test_inverse_kinematics_of_scripts(calibrated) -> None:
    """Joint angles for a pose lead to that pose, as reported by the controller."""
    calibrated.script("movej(get_inverse_kin(p[0.35, 0.15, 0.3, 0, 3.1, 0.1]), a=3, v=3)")
    calibrated.until(lambda now: any(now.target_qd))
    calibrated.until(lambda now: not any(now.target_qd))
    apart = pose_sub(calibrated.now.actual_TCP_pose, (0.35, 0.15, 0.3, 0, 3.1, 0.1))
    assert max(map(abs, apart)) < 1e-8


def test_a_dynamic_arm_holds_its_pose(make, model: RobotModel) -> None:
    rig = make(model, initial_q=START, running=True, dynamic=True)
    rig.seconds(0.5)
    assert rig.now.actual_q == pytest.approx(START, abs=1e-2)
    assert rig.now.actual_TCP_pose == pytest.approx(kinematics_of(model).forward(rig.now.actual_q), abs=1e-9)


def test_calibration_as_a_plugin_option(model: RobotModel) -> None:
    file = GOLDEN / f"calibration_{model.name}.yaml"
    robot = virtual_robot(model.name, calibration=file, initial_q=START)
    pose = robot.controller.arm.kinematics.forward(START)
    assert pose == kinematics_of(model).forward(START)
