"""Kinematics of all arms against independent solvers, and against themselves."""

import math
import random

import numpy as np
import pytest
import ur_analytic_ik

from urproto.robots import MODELS, DH, Kinematics, RobotModel, load_model
from urproto.robots.pose import pose_sub, rotvec_to_matrix

SINGULAR_WRISTS = (0.0, math.pi, -math.pi, 1e-12, 1e-9, 1e-6, 1e-4)
STRETCHED_ELBOWS = (0.0, math.pi)


@pytest.fixture(params=MODELS)
def model(request) -> RobotModel:
    return load_model(request.param)


def transform(pose) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
    result[:3, 3] = pose[:3]
    return result


def dh_product(dh: DH, q) -> np.ndarray:
    """The textbook chain Rz(theta) Tz(d) Tx(a) Rx(alpha), joint by joint."""
    result = np.eye(4)
    for a, d, alpha, theta in zip(dh.a, dh.d, dh.alpha, q, strict=True):
        ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        result = result @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return result


def configurations(seed: str, count: int = 1000) -> list[list[float]]:
    """Random joint vectors, a good part of them singular."""
    chance = random.Random(seed)
    found = []
    for _ in range(count):
        q = [chance.uniform(-2 * math.pi, 2 * math.pi) for _ in range(6)]
        if chance.random() < 0.2:
            q[4] = chance.choice(SINGULAR_WRISTS)
        elif chance.random() < 0.1:
            q[2] = chance.choice(STRETCHED_ELBOWS)
        if chance.random() < 0.1:
            q = [chance.choice((0.0, math.pi / 2, -math.pi / 2, math.pi)) for _ in q]
        found.append(q)
    return found


def test_forward_is_the_dh_product(model) -> None:
    kinematics = Kinematics(model.dh)
    for q in configurations(model.name, 300):
        assert np.allclose(transform(kinematics.forward(q)), dh_product(model.dh, q), atol=1e-12)


@pytest.mark.parametrize("name", [name for name in MODELS if hasattr(ur_analytic_ik, name)])
def test_agrees_with_ur_analytic_ik(name) -> None:
    """ur-analytic-ik (PyPI) solves the same arms by other code. It loses singular wrists, so those stay out."""
    peer, model = getattr(ur_analytic_ik, name), load_model(name)
    kinematics = Kinematics(model.dh)
    chance = random.Random(name)
    for _ in range(300):
        q = [chance.uniform(-math.pi, math.pi) for _ in range(6)]
        if abs(math.sin(q[4])) < 1e-2 or abs(math.sin(q[2])) < 1e-2:
            continue
        theirs = np.asarray(peer.forward_kinematics(*q))
        assert np.allclose(transform(kinematics.forward(q)), theirs, atol=2e-4), q
        # solve our own pose: their data differs from the arm's by rounded link lengths
        ours = kinematics.inverse_all(kinematics.forward(q))
        for solution in peer.inverse_kinematics(dh_product(model.dh, q)):
            wanted = np.asarray(solution).reshape(-1)
            nearest = min(np.abs(np.angle(np.exp(1j * (wanted - np.array(s))))).max() for s in ours)
            assert nearest < 0.02, (q, wanted)


def test_every_solution_reaches_the_pose(model) -> None:
    kinematics = Kinematics(model.dh)
    for q in configurations(model.name):
        pose = kinematics.forward(q)
        solutions = kinematics.inverse_all(pose, q)
        assert 1 <= len(solutions) <= 8, q
        for solution in solutions:
            assert all(-math.pi < angle <= math.pi for angle in solution)
            assert np.allclose(transform(kinematics.forward(solution)), transform(pose), atol=1e-7), (q, solution)


def test_inverse_finds_the_configuration_again(model) -> None:
    """IK(FK(q)) is q, singular wrists among them, where wrist and elbow are not both singular at once."""
    kinematics = Kinematics(model.dh)
    for q in configurations(model.name):
        found = kinematics.inverse_near(kinematics.forward(q), q, model.q_min, model.q_max)
        assert found is not None, q
        if abs(math.sin(q[2])) > 1e-3:
            assert found == pytest.approx(q, abs=2e-5), q


def test_nearest_solution_turns_by_full_turns() -> None:
    model = load_model("ur3")
    kinematics = Kinematics(model.dh)
    q = (0.3 + 2 * math.pi, -1.2 - 2 * math.pi, 1.0, -1.0, -1.4, 0.2)
    found = kinematics.inverse_near(kinematics.forward(q), q, [-7.0] * 6, [8.0] * 6)
    assert found is None  # shoulder lift would need -7.48 rad
    found = kinematics.inverse_near(kinematics.forward(q), q, [-8.0] * 6, [8.0] * 6)
    assert found == pytest.approx(q, abs=1e-9)


def test_limits_are_inclusive_and_hold() -> None:
    model = load_model("ur5e")
    kinematics = Kinematics(model.dh)
    for q in configurations("limits", 300):
        found = kinematics.inverse_near(kinematics.forward(q), q, model.q_min, model.q_max)
        assert found is not None
        assert all(low <= angle <= high for low, angle, high in zip(model.q_min, found, model.q_max, strict=True))


@pytest.mark.parametrize("pose", [(2.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)])
def test_unreachable_poses_have_no_solution(pose) -> None:
    """Too far out, and inside the cylinder around the base that wrist 1's offset keeps free."""
    assert Kinematics(load_model("ur3").dh).inverse_all(pose) == []


def test_jacobian_is_the_derivative(model) -> None:
    kinematics, tcp, step = Kinematics(model.dh), (0.05, -0.02, 0.15, 0.3, 0.2, -0.1), 1e-6
    for q in configurations(model.name, 20):
        jacobian = np.array(kinematics.jacobian(q, tcp))
        for joint in range(6):
            ahead, behind = list(q), list(q)
            ahead[joint] += step
            behind[joint] -= step
            change = pose_sub(kinematics.forward(ahead, tcp), kinematics.forward(behind, tcp))
            assert np.allclose(jacobian[:, joint], np.array(change) / (2 * step), atol=1e-7)


def test_tcp_offset_is_applied_in_the_flange_frame(model) -> None:
    kinematics, offset = Kinematics(model.dh), (0.01, 0.02, 0.3, 0.1, -0.4, 2.0)
    q = (0.1, -1.0, 0.9, -1.1, -1.5, 0.4)
    expected = dh_product(model.dh, q) @ transform(offset)
    assert np.allclose(transform(kinematics.forward(q, offset)), expected, atol=1e-12)


def test_elbow(model) -> None:
    kinematics, q, qd, step = Kinematics(model.dh), (0.4, -1.1, 0.8, 0.0, 0.0, 0.0), (0.5, -0.3, 0.2, 0, 0, 0), 1e-6
    to_elbow = DH(*(tuple(v[:2]) for v in (model.dh.a, model.dh.d, model.dh.alpha, model.dh.theta)))
    assert np.allclose(kinematics.elbow_position(q), dh_product(to_elbow, q[:2])[:3, 3])
    moved = [np.array(kinematics.elbow_position([a + s * b for a, b in zip(q, qd, strict=True)])) for s in (step, -step)]
    assert np.allclose(kinematics.elbow_velocity(q, qd), (moved[0] - moved[1]) / (2 * step), atol=1e-8)


def test_calibrated_parameters_are_refused() -> None:
    dh = load_model("ur3").dh
    with pytest.raises(ValueError, match="nominal parameters"):
        Kinematics(DH(dh.a, dh.d, dh.alpha, (0.001, 0.0, 0.0, 0.0, 0.0, 0.0)))
