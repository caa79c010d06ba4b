"""Kinematics and dynamics of calibrated arms."""

import math
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from kinematics_oracle import product_of_links, transform

from urproto.robots import Calibration, Joints, Kinematics, RobotModel, kinematics_of, load_model
from urproto.robots.dynamics import Dynamics
from urproto.robots.pose import Pose, pose_sub

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FREE = ((-math.inf,) * 6, (math.inf,) * 6)
TOOL: Pose = (0.03, -0.05, 0.12, 0.4, -0.3, 0.9)
HOME: Joints = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)


@pytest.fixture(params=["ur5", "ur5e"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    content = yaml.safe_load((GOLDEN / f"calibration_{request.param}.yaml").read_text())
    return replace(load_model(request.param), calibration=Calibration.from_mapping(content, "file").dh)


def configurations(count: int, seed: int) -> list[Joints]:
    source = random.Random(seed)
    return [tuple(source.uniform(-3, 3) for _ in range(6)) for _ in range(count)]  # type: ignore[misc]  # six


def apart(one: Pose, other: Pose) -> float:
    return max(map(abs, pose_sub(one, other)))


def test_a_nominal_arm_keeps_the_closed_form() -> None:
    assert type(kinematics_of(load_model("ur5e"))) is Kinematics


def test_forward_kinematics(model: RobotModel) -> None:
    kinematics, nominal = kinematics_of(model), Kinematics(model.dh)
    for q in configurations(50, 1):
        np.testing.assert_allclose(
            transform(kinematics.forward(q)), product_of_links(model.calibration, q), rtol=0, atol=1e-11
        )
        assert 1e-5 < apart(kinematics.forward(q), nominal.forward(q)) < 0.02
        for offset in (0.0, 0.1):
            assert math.dist(kinematics.elbow_position(q, offset), nominal.elbow_position(q, offset)) < 0.01
            assert math.dist(kinematics.wrist_position(q, offset), nominal.wrist_position(q, offset)) < 0.01


def test_jacobian_is_the_rate_of_the_pose(model: RobotModel) -> None:
    kinematics, step = kinematics_of(model), 1e-6
    for q in configurations(10, 2):
        rows = kinematics.jacobian(q, TOOL)
        for i in range(6):
            ahead, behind = ((*q[:i], q[i] + way * step, *q[i + 1 :]) for way in (1, -1))
            change = pose_sub(kinematics.forward(ahead, TOOL), kinematics.forward(behind, TOOL))
            assert [row[i] for row in rows] == pytest.approx([part / (2 * step) for part in change], abs=1e-7)


def test_joint_torques_of_a_wrench_do_its_work(model: RobotModel) -> None:
    kinematics, wrench = kinematics_of(model), (10.0, -20.0, 30.0, 1.0, 2.0, -3.0)
    for q in configurations(10, 2):
        columns = zip(*kinematics.jacobian(q, TOOL), strict=True)
        torques = [sum(a * b for a, b in zip(column, wrench, strict=True)) for column in columns]
        assert kinematics.joint_torques_at(q, wrench, kinematics.forward(q, TOOL)) == pytest.approx(torques, abs=1e-11)


def test_inverse_undoes_forward(model: RobotModel) -> None:
    kinematics, source = kinematics_of(model), random.Random(3)
    for q in configurations(200, 3):
        pose = kinematics.forward(q)
        near = tuple(angle + source.uniform(-0.3, 0.3) for angle in q)
        found = kinematics.inverse_near(pose, near, *FREE)
        assert found is not None
        assert apart(kinematics.forward(found), pose) < 3e-10
        assert math.dist(found, near) <= math.dist(q, near) + 1e-3


def test_all_solutions(model: RobotModel) -> None:
    kinematics = kinematics_of(model)
    pose = kinematics.forward((0.3, -1.2, 1.4, -0.7, 1.0, -2.0))
    solutions = kinematics.inverse_all(pose)
    assert len(solutions) == len(Kinematics(model.dh).inverse_all(pose)) == 8
    for q in solutions:
        assert apart(kinematics.forward(q), pose) < 3e-10


def test_solutions_are_continuous_along_a_path(model: RobotModel) -> None:
    kinematics, q = kinematics_of(model), (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
    x, y, z, *turn = kinematics.forward(q)
    for i in range(100):
        after = kinematics.inverse_near((x, y, z + i * 1e-3, *turn), q, *FREE)
        assert after is not None
        assert math.dist(q, after) < 0.02
        q = after


def test_joints_stay_in_place_at_the_singular_start(model: RobotModel) -> None:
    kinematics = kinematics_of(model)
    assert kinematics.inverse_near(kinematics.forward(HOME), HOME, *FREE) == HOME
    near = tuple(angle + 0.01 for angle in HOME)
    found = kinematics.inverse_near(kinematics.forward(HOME), near, *FREE)
    assert found is not None
    assert apart(kinematics.forward(found), kinematics.forward(HOME)) < 3e-10


def test_limits_and_reach(model: RobotModel) -> None:
    kinematics = kinematics_of(model)
    q = (0.3, -1.2, 1.4, -0.7, 1.0, -2.0)
    pose = kinematics.forward(q)
    narrow = tuple(angle - 0.01 for angle in q), tuple(angle + 0.01 for angle in q)
    assert kinematics.inverse_near(pose, tuple(angle + 6 for angle in q), *narrow) == pytest.approx(q, abs=1e-8)
    above = tuple(angle + 0.02 for angle in q), tuple(angle + 0.03 for angle in q)
    assert kinematics.inverse_near(pose, q, *above) is None
    assert kinematics.inverse_near((3.0, 0.0, 0.0, 0.0, 0.0, 0.0), q, *FREE) is None
    assert kinematics.inverse_all((3.0, 0.0, 0.0, 0.0, 0.0, 0.0)) == []


def test_dynamics_of_a_calibrated_arm(model: RobotModel) -> None:
    """Holding torque is the slope of potential energy; all dynamics are close to those of the nominal arm."""
    dynamics, nominal, step = Dynamics(model), Dynamics(load_model(model.name)), 1e-6
    for q in configurations(5, 4):
        torques = dynamics.gravity_torques(q)
        assert torques != nominal.gravity_torques(q)
        assert torques == pytest.approx(nominal.gravity_torques(q), abs=1.5)
        for i in range(6):
            ahead, behind = ((*q[:i], q[i] + way * step, *q[i + 1 :]) for way in (1, -1))
            slope = (dynamics.energy(ahead, (0.0,) * 6)[1] - dynamics.energy(behind, (0.0,) * 6)[1]) / (2 * step)
            assert torques[i] == pytest.approx(slope, abs=1e-5)
