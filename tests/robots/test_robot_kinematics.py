"""Forward kinematics, Jacobian and inverse kinematics of every arm, also where it is singular."""

import math
import random
from dataclasses import replace
from math import pi

import numpy as np
import pytest
import ur_analytic_ik
from kinematics_oracle import product_of_links, transform

from tests.rows import each_row
from urproto.robots import MODELS, Joints, load_model
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import Pose, pose_inv, pose_sub, pose_trans

FREE = ((-math.inf,) * 6, (math.inf,) * 6)
LIMITS = ((-2 * pi,) * 6, (2 * pi,) * 6)
TOOL: Pose = (0.03, -0.05, 0.12, 0.4, -0.3, 0.9)
SINGULAR_ANGLES = (0.0, pi / 2, -pi / 2, pi, -pi, 1e-9, 1e-7, 1e-5)


@pytest.fixture(params=MODELS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def kinematics(name: str) -> Kinematics:
    return Kinematics(load_model(name).dh)


def configurations(count: int, seed: int, bound: float = pi) -> list[Joints]:
    source = random.Random(seed)
    return [tuple(source.uniform(-bound, bound) for _ in range(6)) for _ in range(count)]  # type: ignore[misc]  # six


def singular_configurations(count: int, seed: int) -> list[Joints]:
    """Random ones with one to six joints at, or very close to, singular angles."""
    source = random.Random(seed)
    found = []
    for q in configurations(count, seed):
        chosen = source.sample(range(6), source.randint(1, 6))
        found.append(tuple(source.choice(SINGULAR_ANGLES) if i in chosen else angle for i, angle in enumerate(q)))
    return found  # type: ignore[return-value]  # six each


def pose_error(one: Pose, other: Pose) -> float:
    """Largest of the position [m] and rotation [rad] differences."""
    difference = pose_sub(one, other)
    return max(math.hypot(*difference[:3]), math.hypot(*difference[3:]))


def angle_between(one: float, other: float) -> float:
    return abs(math.remainder(one - other, 2 * pi))


def same_posture(one: Joints, other: Joints, tolerance: float) -> bool:
    return all(angle_between(a, b) < tolerance for a, b in zip(one, other, strict=True))


# forward


def test_forward_is_the_product_of_the_links(name: str, kinematics: Kinematics) -> None:
    for q in (*configurations(50, 1, 2 * pi), *singular_configurations(50, 2)):
        found = transform(kinematics.forward(q))
        # the data files have alpha with nine decimals, the closed form uses the right angle
        np.testing.assert_allclose(found, product_of_links(load_model(name).dh, q), rtol=0, atol=3e-9)


def test_forward_agrees_with_another_solver(name: str, kinematics: Kinematics) -> None:
    solver = getattr(ur_analytic_ik, name)
    for q in (*configurations(200, 3, 2 * pi), *singular_configurations(200, 4)):
        np.testing.assert_allclose(transform(kinematics.forward(q)), solver.forward_kinematics(*q), rtol=0, atol=1e-12)


def test_stretched_ur5e_calculated_manually() -> None:
    # at zero: a2 + a3 along -x, d4 + d6 along -y, d1 - d5 up; flange z along -y
    pose = Kinematics(load_model("ur5e").dh).forward((0.0,) * 6)
    assert pose[:3] == pytest.approx((-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997))
    assert pose[3:] == pytest.approx((pi / 2, 0.0, 0.0))


def test_tcp_is_attached_to_the_flange(kinematics: Kinematics) -> None:
    for q in configurations(20, 5):
        flange = kinematics.forward(q)
        assert pose_error(kinematics.forward(q, TOOL), pose_trans(flange, TOOL)) < 1e-12
        assert kinematics.forward(q, (0.0,) * 6) == pytest.approx(flange, abs=1e-12)


def test_elbow_is_at_the_end_of_the_second_link(name: str, kinematics: Kinematics) -> None:
    dh = load_model(name).dh
    cut = replace(dh, a=(0.0, dh.a[1], 0.0, 0.0, 0.0, 0.0), d=(dh.d[0], 0.0, 0.0, 0.0, 0.0, 0.0))
    for q in configurations(20, 6):
        assert kinematics.elbow_position(q) == pytest.approx(product_of_links(cut, q)[:3, 3], abs=1e-8)


# Jacobian


@each_row("tcp", [None, TOOL])
def test_jacobian_is_the_rate_of_the_pose(kinematics: Kinematics, tcp: Pose | None) -> None:
    step = 1e-6
    for q in (*configurations(10, 7), *singular_configurations(10, 8)):
        rows = kinematics.jacobian(q, tcp)
        for joint in range(6):
            ahead, behind = list(q), list(q)
            ahead[joint] += step
            behind[joint] -= step
            change = pose_sub(kinematics.forward(ahead, tcp), kinematics.forward(behind, tcp))
            rate = [c / (2 * step) for c in change]
            assert [row[joint] for row in rows] == pytest.approx(rate, abs=1e-8)


@each_row("tcp", [None, TOOL])
def test_the_twist_is_the_jacobian_times_the_joint_speeds(kinematics: Kinematics, tcp: Pose | None) -> None:
    source = random.Random(9)
    for q in (*configurations(20, 7), *singular_configurations(20, 8)):
        qd = tuple(source.uniform(-3.0, 3.0) for _ in range(6))
        expected = np.array(kinematics.jacobian(q, tcp)) @ qd
        assert kinematics.twist_at(q, qd, kinematics.forward(q, tcp)) == pytest.approx(expected, abs=1e-12)


@each_row("tcp", [None, TOOL])
def test_joint_torques_of_a_wrench_do_its_work(kinematics: Kinematics, tcp: Pose | None) -> None:
    source = random.Random(9)
    for q in (*configurations(20, 7), *singular_configurations(20, 8)):
        wrench = tuple(source.uniform(-50.0, 50.0) for _ in range(6))
        expected = np.array(kinematics.jacobian(q, tcp)).T @ wrench
        assert kinematics.joint_torques_at(q, wrench, kinematics.forward(q, tcp)) == pytest.approx(expected, abs=1e-11)


# inverse


class Searching(Kinematics):
    """Without the shortcut for a step along a path."""

    def _continued(self, *_: object) -> None:
        return None


def test_a_step_along_a_path_is_the_nearest_solution_to_the_last_bit(name: str, kinematics: Kinematics) -> None:
    searching, source, shortcuts = Searching(load_model(name).dh), random.Random(11), 0
    for q in (*configurations(300, 12, 2 * pi), *configurations(300, 13, 1.0), *singular_configurations(300, 14)):
        reach = source.choice([0.0, 1e-12, 1e-6, 1e-3, 0.1, 1.0])
        near = tuple(angle + source.uniform(-reach, reach) for angle in q)
        pose = kinematics.forward(q)
        for low, high in (FREE, LIMITS, ((-2.5,) * 6, (2.5,) * 6)):
            found = kinematics.inverse_near(pose, near, low, high)
            assert found == searching.inverse_near(pose, near, low, high)
        shortcuts += kinematics._continued(*kinematics._wrist_centre(pose), near, *FREE) is not None
    assert shortcuts > 200


def test_inverse_of_forward_on_random_configurations(kinematics: Kinematics) -> None:
    for q in configurations(400, 10):
        pose = kinematics.forward(q)
        solutions = kinematics.inverse_all(pose)
        assert 2 <= len(solutions) <= 8
        assert any(same_posture(solution, q, 1e-6) for solution in solutions)
        for solution in solutions:
            assert pose_error(kinematics.forward(solution), pose) < 1e-11
            assert all(-pi < angle <= pi for angle in solution)
        found = kinematics.inverse_near(pose, q, *LIMITS)
        assert found == pytest.approx(q, abs=1e-6)


def test_inverse_of_forward_on_singular_configurations(kinematics: Kinematics) -> None:
    for q in singular_configurations(400, 11):
        pose = kinematics.forward(q)
        solutions = kinematics.inverse_all(pose, q)
        assert 1 <= len(solutions) <= 8
        for solution in solutions:
            assert all(-pi < angle <= pi for angle in solution)
            assert pose_error(kinematics.forward(solution), pose) < 2.1e-7  # a wrist treated as singular: 2e-7 rad
        found = kinematics.inverse_near(pose, q, *LIMITS)
        # near a singularity, a whole range of angles gives the same pose, within rounding
        assert found == pytest.approx(q, abs=1e-3)


@each_row("q5", [0.0, pi, -pi])
def test_singular_wrist_keeps_joint_6(kinematics: Kinematics, q5: float) -> None:
    for q in configurations(100, 12):
        posture = (*q[:4], q5, 1.2)
        pose = kinematics.forward(posture)
        for solution in kinematics.inverse_all(pose, posture):
            assert pose_error(kinematics.forward(solution), pose) < 1e-12 or abs(math.sin(solution[4])) > 1e-6
        assert kinematics.inverse_near(pose, posture, *LIMITS) == pytest.approx(posture, abs=1e-6)


def test_singular_wrist_is_found_from_anywhere(kinematics: Kinematics) -> None:
    for n, q in enumerate(configurations(200, 17)):
        posture = (*q[:4], pi if n % 2 else 0.0, q[5])
        pose = kinematics.forward(posture)
        for near in (None, (0.0, 0.0, 0.0, 0.0, 0.0, q[5] + pi)):
            singular = [s for s in kinematics.inverse_all(pose, near) if abs(math.sin(s[4])) < 1e-6]
            assert singular, (posture, near)
            for solution in singular:
                assert pose_error(kinematics.forward(solution), pose) < 1e-8
                # joint 6 is as requested, unless the arm has to stretch (or fold) to reach the pose
                wanted = 0.0 if near is None else near[5]
                assert angle_between(solution[5], wanted) < 1e-12 or abs(math.sin(solution[2])) < 1e-3


def test_singular_wrist_counts_the_turns_of_joint_6(kinematics: Kinematics) -> None:
    q = (0.4, -1.1, 1.3, -0.2, 0.0, 0.6 + 2 * pi)
    pose = kinematics.forward(q)
    assert all(-pi < solution[5] <= pi for solution in kinematics.inverse_all(pose, q))
    assert kinematics.inverse_near(pose, q, *FREE) == pytest.approx(q, abs=1e-9)


def test_upright_arm_where_everything_is_singular(kinematics: Kinematics) -> None:
    # shoulder (wrist centre over the base axis), elbow (straight) and wrist at the same time
    upright = (0.3, -pi / 2, 0.0, -pi / 2, 0.0, 0.7)
    found = kinematics.inverse_near(kinematics.forward(upright), upright, *LIMITS)
    assert found == pytest.approx(upright, abs=1e-9)


def test_passing_a_singular_wrist_causes_no_large_joint_motion(kinematics: Kinematics) -> None:
    near = (0.4, -1.1, 1.3, -0.2, 0.01, 0.6)
    for n in range(1, 200):
        posture = (0.4, -1.1, 1.3, -0.2, 0.01 - n * 1e-4, 0.6)
        found = kinematics.inverse_near(kinematics.forward(posture), near, *LIMITS)
        assert found is not None
        assert max(abs(a - b) for a, b in zip(found, near, strict=True)) < 1.1e-4
        near = found


def test_solutions_match_another_solver(name: str, kinematics: Kinematics) -> None:
    solver = getattr(ur_analytic_ik, name)
    for q in configurations(150, 13):
        pose = kinematics.forward(q)
        ours = kinematics.inverse_all(pose)
        theirs = [tuple(s) for s in solver.inverse_kinematics(transform(pose))]
        assert len(ours) == len(theirs)
        for solution in ours:
            assert any(same_posture(solution, other, 1e-5) for other in theirs)


def test_out_of_reach(name: str, kinematics: Kinematics) -> None:
    far = 2 * load_model(name).reach_m
    assert kinematics.inverse_all((far, 0.0, 0.2, 0.0, 0.0, 0.0)) == []
    assert kinematics.inverse_near((far, 0.0, 0.2, 0.0, 0.0, 0.0), (0.0,) * 6, *FREE) is None
    # inside the cylinder around the base axis that the offset d4 makes unreachable
    d6 = load_model(name).dh.d[5]
    assert kinematics.inverse_all((0.0, 0.0, 0.5 - d6, pi, 0.0, 0.0)) == []


def test_edge_of_the_workspace(kinematics: Kinematics) -> None:
    stretched = (0.0, -0.7, 0.0, 0.4, 0.8, -0.3)
    x, y, z, *turn = kinematics.forward(stretched)
    assert kinematics.inverse_near((x, y, z, *turn), stretched, *FREE) == pytest.approx(stretched, abs=1e-6)
    # with joint 1 at zero the links point along -cos(q2), -sin(q2) in x and z
    postures = {}
    for step in (-0.001, 0.001):
        moved = (x - step * math.cos(-0.7), y, z - step * math.sin(-0.7), *turn)
        postures[step] = [s for s in kinematics.inverse_all(moved) if same_posture(s, stretched, 0.3)]
    assert len(postures[-0.001]) == 2  # elbow up and elbow down
    assert postures[0.001] == []


def test_nearest_counts_whole_turns(kinematics: Kinematics) -> None:
    for q in configurations(50, 14, 2 * pi):
        assert kinematics.inverse_near(kinematics.forward(q), q, *FREE) == pytest.approx(q, abs=1e-6)
    q = (0.1, -1.2, 1.4, -0.3, 0.9, 31 * pi)
    assert kinematics.inverse_near(kinematics.forward(q), q, *FREE) == pytest.approx(q, abs=1e-6)


def test_limits_choose_another_turn_or_refuse(kinematics: Kinematics) -> None:
    q = (0.1, -1.2, 1.4, -0.3, 0.9, 3.0)
    pose = kinematics.forward(q)
    low, high = (-2 * pi,) * 6, (*(2 * pi,) * 5, 2.9)
    turned = kinematics.inverse_near(pose, q, low, high)
    assert turned is not None
    assert all(a <= angle <= b for a, angle, b in zip(low, turned, high, strict=True))
    assert pose_error(kinematics.forward(turned), pose) < 1e-11
    assert kinematics.inverse_near(pose, q, (-0.01,) * 6, (0.01,) * 6) is None


def test_inverse_for_a_tool(kinematics: Kinematics) -> None:
    q = (0.4, -1.1, 1.3, -0.2, 0.7, 0.6)
    flange = pose_trans(kinematics.forward(q, TOOL), pose_inv(TOOL))
    assert kinematics.inverse_near(flange, q, *LIMITS) == pytest.approx(q, abs=1e-9)


def test_other_arm_geometries_are_refused() -> None:
    dh = load_model("ur3").dh
    for wrong in (
        replace(dh, alpha=(0.0,) * 6),
        replace(dh, a=(0.1, *dh.a[1:])),
        replace(dh, d=(*dh.d[:2], 0.1, *dh.d[3:])),
        replace(dh, theta=(0.1, *dh.theta[1:])),
        replace(dh, a=(0.0,) * 6),
    ):
        with pytest.raises(ValueError, match="not the shape"):
            Kinematics(wrong)


def test_five_joints_are_refused() -> None:
    with pytest.raises(ValueError, match="unpack"):
        Kinematics(load_model("ur3").dh).forward((0.0,) * 5)


@each_row(
    ("model", "q", "elbow"),
    # captures that tests/golden/README.md names: simulators of 5.24 and an early 5.x, a UR10 arm
    [
        (
            "ur5e",
            (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031),
            (-0.09493652093799841, -0.06334869948453058, 0.5823190077471572),
        ),
        (
            "ur3e",
            (0.12321250481647548, -1.5601252688133753, -1.558624557501262, -1.5092448898616508, 1.5561128, 0.349373588),
            (0.00725289441037171, -0.07971292080654459, 0.39538613341588874),
        ),
        (
            "ur10",
            (-1.4538119474994105, -2.0515649954425257, -0.6825364271747034, -1.969449345, 1.507378816, 1.295376777),
            (0.03303415733236396, -0.28109158985187077, 0.6699234998264342),
        ),
    ],
)
def test_elbow_of_captured_states(model: str, q: Joints, elbow: tuple[float, float, float]) -> None:
    arm = load_model(model)
    assert Kinematics(arm.dh).elbow_position(q, arm.elbow_offset) == pytest.approx(elbow, abs=1e-9)
