"""Pose algebra as a group, at every rotation angle including 0 and pi."""

from itertools import pairwise
from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.budget import examples
from tests.rows import each_row
from urproto.robots.pose import (
    Pose,
    adder_to,
    interpolate_pose,
    matrix_to_rotvec,
    point_dist,
    pose_add,
    pose_dist,
    pose_inv,
    pose_sub,
    pose_trans,
    rotvec_to_matrix,
    rotvec_to_rpy,
    rpy_to_rotvec,
    wrench_trans,
)
from urproto.vectors import Vector3

TOLERANCE = 1e-12
IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# the angles where formulas fail, angles close to them, and all others
angles = st.one_of(
    st.sampled_from([0.0, 1e-200, 1e-12, 1e-8, 1e-4, pi / 2, pi - 1e-4, pi - 1e-9, pi, pi + 1e-9, 2 * pi]),
    st.floats(0.0, 2 * pi),
)
components = st.floats(-1.0, 1.0)
lengths = st.floats(-2.0, 2.0)


@st.composite
def rotvecs(draw: st.DrawFn) -> Vector3:
    direction = np.array([draw(components), draw(components), draw(components)])
    size = float(np.linalg.norm(direction))
    direction = direction / size if size > 1e-3 else np.array([0.0, 0.0, 1.0])
    x, y, z = (draw(angles) * direction).tolist()
    return (x, y, z)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    return (draw(lengths), draw(lengths), draw(lengths), *draw(rotvecs()))


def homogeneous(pose: Pose) -> np.ndarray:
    """The 4x4 transform, by Rodrigues' formula written out independently."""
    rotvec = np.array(pose[3:])
    angle = np.linalg.norm(rotvec)
    transform = np.eye(4)
    transform[:3, 3] = pose[:3]
    if angle > 0.0:
        x, y, z = rotvec / angle
        cross = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
        transform[:3, :3] += sin(angle) * cross + (1 - cos(angle)) * cross @ cross
    return transform


def assert_same(pose_1: Pose, pose_2: Pose) -> None:
    """Equal as transforms: at angle pi two rotation vectors name one rotation."""
    np.testing.assert_allclose(homogeneous(pose_1), homogeneous(pose_2), rtol=0, atol=TOLERANCE)


@given(rotvecs())
def test_matrix_is_rodrigues_formula(rotvec: Vector3) -> None:
    expected = homogeneous((0.0, 0.0, 0.0, *rotvec))[:3, :3].ravel()
    assert rotvec_to_matrix(*rotvec) == pytest.approx(expected, abs=TOLERANCE)


@given(rotvecs())
def test_matrix_and_rotation_vector_are_inverse(rotvec: Vector3) -> None:
    back = matrix_to_rotvec(rotvec_to_matrix(*rotvec))
    assert_same((0.0, 0.0, 0.0, *back), (0.0, 0.0, 0.0, *rotvec))
    assert sqrt(sum(c * c for c in back)) <= pi + TOLERANCE


@each_row("angle", [1e-12, 1e-8, 0.5, pi - 1e-6, pi - 1e-9])
@each_row("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (-0.48, 0.6, 0.64)])
def test_rotation_vector_keeps_its_precision(axis: Vector3, angle: float) -> None:
    rotvec = tuple(angle * c for c in axis)
    assert matrix_to_rotvec(rotvec_to_matrix(*rotvec)) == pytest.approx(rotvec, rel=1e-12, abs=1e-15)


def test_half_turn_about_each_axis() -> None:
    assert matrix_to_rotvec((1, 0, 0, 0, -1, 0, 0, 0, -1)) == pytest.approx((pi, 0, 0))
    assert matrix_to_rotvec((-1, 0, 0, 0, 1, 0, 0, 0, -1)) == pytest.approx((0, pi, 0))
    assert matrix_to_rotvec((-1, 0, 0, 0, -1, 0, 0, 0, 1)) == pytest.approx((0, 0, pi))


def test_no_rotation_is_exactly_zero() -> None:
    assert matrix_to_rotvec((1, 0, 0, 0, 1, 0, 0, 0, 1)) == (0.0, 0.0, 0.0)
    assert pose_trans(IDENTITY, IDENTITY) == IDENTITY


@given(poses(), poses())
def test_trans_is_the_matrix_product(a: Pose, b: Pose) -> None:
    product = homogeneous(a) @ homogeneous(b)
    np.testing.assert_allclose(homogeneous(pose_trans(a, b)), product, rtol=0, atol=TOLERANCE)


@given(poses())
def test_inverse_and_identity(a: Pose) -> None:
    assert_same(pose_trans(a, pose_inv(a)), IDENTITY)
    assert_same(pose_trans(pose_inv(a), a), IDENTITY)
    assert_same(pose_trans(a, IDENTITY), a)
    assert_same(pose_inv(pose_inv(a)), a)


@given(poses(), poses(), poses())
def test_trans_is_associative(a: Pose, b: Pose, c: Pose) -> None:
    assert_same(pose_trans(pose_trans(a, b), c), pose_trans(a, pose_trans(b, c)))


@given(poses(), poses())
def test_add_undoes_sub(a: Pose, b: Pose) -> None:
    assert_same(pose_add(pose_sub(a, b), b), a)
    assert_same(pose_sub(pose_add(a, b), b), a)


@given(poses(), poses())
def test_add_adds_positions_and_multiplies_rotations(a: Pose, b: Pose) -> None:
    total = homogeneous(pose_add(a, b))
    assert total[:3, 3] == pytest.approx(np.add(a[:3], b[:3]), abs=TOLERANCE)
    np.testing.assert_allclose(total[:3, :3], (homogeneous(a) @ homogeneous(b))[:3, :3], rtol=0, atol=TOLERANCE)


@given(poses(), poses())
def test_many_first_poses_are_added_to_one_second(a: Pose, b: Pose) -> None:
    assert adder_to(b)(a) == pose_add(a, b)


def test_add_example_of_the_manual() -> None:
    # Script Manual, pose_add: the printed result is rounded from 3.14
    assert pose_add((0.2, 0.5, 0.1, 1.57, 0, 0), (0.2, 0.5, 0.6, 1.57, 0, 0)) == pytest.approx(
        (0.4, 1.0, 0.7, 3.14, 0, 0)
    )


@given(poses(), poses(), st.floats(-0.5, 1.5))
def test_interpolation(a: Pose, b: Pose, alpha: float) -> None:
    middle = interpolate_pose(a, b, alpha)
    assert middle[:3] == pytest.approx(np.add(a[:3], alpha * np.subtract(b[:3], a[:3])), abs=TOLERANCE)
    assert_same(interpolate_pose(a, b, 0.0), a)
    assert_same(interpolate_pose(a, b, 1.0), b)


@given(poses(), poses())
def test_interpolation_turns_evenly(a: Pose, b: Pose) -> None:
    steps = [interpolate_pose(a, b, n / 4) for n in range(5)]
    turns = [np.linalg.norm(pose_sub(later, earlier)[3:]) for earlier, later in pairwise(steps)]
    assert turns == pytest.approx([turns[0]] * 4, abs=1e-9)
    assert turns[0] <= pi / 4 + 1e-9  # the short way around


def test_distances_ignore_orientation() -> None:
    a, b = (0.1, 0.2, 0.3, 1.0, 0.0, 0.0), (0.1, 0.5, 0.7, 0.0, 2.0, 0.0)
    assert point_dist(a, b) == pytest.approx(0.5)
    assert pose_dist(a, b) == pytest.approx(0.5)


@given(rotvecs())
def test_rpy_and_rotation_vector_are_inverse(rotvec: Vector3) -> None:
    rpy = rotvec_to_rpy(*rotvec)
    back = (0.0, 0.0, 0.0, *rpy_to_rotvec(*rpy))
    np.testing.assert_allclose(homogeneous(back), homogeneous((0.0, 0.0, 0.0, *rotvec)), rtol=0, atol=1e-8)


@given(angles, st.sampled_from([pi / 2, -pi / 2]), angles)
def test_rpy_at_gimbal_lock(roll: float, pitch: float, yaw: float) -> None:
    rotvec = rpy_to_rotvec(roll, pitch, yaw)
    found = rotvec_to_rpy(*rotvec)
    assert found[2] == 0.0
    assert rotvec_to_matrix(*rpy_to_rotvec(*found)) == pytest.approx(rotvec_to_matrix(*rotvec), abs=1e-7)


def test_rpy_turns_about_fixed_axes_x_then_y_then_z() -> None:
    # roll takes z to -y; pitch leaves y alone; yaw takes -y to x
    matrix = np.array(rotvec_to_matrix(*rpy_to_rotvec(pi / 2, 0.3, pi / 2))).reshape(3, 3)
    assert matrix @ (0, 0, 1) == pytest.approx((1, 0, 0), abs=TOLERANCE)


@settings(max_examples=examples(25))
@given(poses(), poses())
def test_wrench_does_the_same_work_in_every_frame(a_b: Pose, wrench: Pose) -> None:
    # power of a wrench on a twist (v at the origin, w) does not depend on the frame
    v, w = np.array((0.3, -0.2, 0.5)), np.array((-0.4, 0.7, 0.1))
    rotation = homogeneous(a_b)[:3, :3]
    v_b, w_b = rotation.T @ (v + np.cross(w, a_b[:3])), rotation.T @ w
    moved = wrench_trans(a_b, wrench)
    power = np.dot(wrench[:3], v) + np.dot(wrench[3:], w)
    assert np.dot(moved[:3], v_b) + np.dot(moved[3:], w_b) == pytest.approx(power, abs=1e-9)


def test_wrench_of_a_lever() -> None:
    # 10 N along y, 2 m out on x, is 20 Nm about z; seen from the point itself there is no torque
    assert wrench_trans((2, 0, 0, 0, 0, 0), (0, 10, 0, 0, 0, 20)) == pytest.approx((0, 10, 0, 0, 0, 0))


@each_row("function", [pose_trans, pose_add, pose_sub, point_dist, wrench_trans])
def test_five_numbers_are_not_a_pose(function) -> None:
    with pytest.raises(ValueError, match="unpack"):
        function((1.0, 2.0, 3.0, 4.0, 5.0), IDENTITY)
