"""Pose algebra: the axioms of a group, and the rotations where naive formulas break."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from urproto.robots.pose import (
    Pose,
    interpolate_pose,
    matrix_to_rotvec,
    point_dist,
    pose_add,
    pose_inv,
    pose_sub,
    pose_trans,
    rotvec_to_matrix,
    rotvec_to_rpy,
    rpy_to_rotvec,
    wrench_trans,
)

metres = st.floats(-2.0, 2.0)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 1e-3)
# ordinary angles, and those at which rotation vectors are delicate
angles = st.one_of(st.floats(0.0, math.pi), st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, math.pi - 1e-9, math.pi]))


@st.composite
def poses(draw) -> Pose:
    direction = draw(directions)
    scale = draw(angles) / math.hypot(*direction)
    x, y, z = (draw(metres) for _ in range(3))
    return (x, y, z, *(scale * part for part in direction))  # type: ignore[return-value]


IDENTITY = (0.0,) * 6


def matrix(pose) -> np.ndarray:
    """Homogeneous transform by the exponential series, independent of the code under test."""
    rx, ry, rz = pose[3:]
    cross = np.array([[0.0, -rz, ry], [rz, 0.0, -rx], [-ry, rx, 0.0]])
    turn, term = np.eye(3), np.eye(3)
    for order in range(1, 40):
        term = term @ cross / order
        turn = turn + term
    transform = np.eye(4)
    transform[:3, :3] = turn
    transform[:3, 3] = pose[:3]
    return transform


def turned(rotvec, vector) -> np.ndarray:
    return matrix((0, 0, 0, *rotvec))[:3, :3] @ vector


def assert_same(a, b, tolerance: float = 1e-9) -> None:
    assert np.allclose(matrix(a), matrix(b), atol=tolerance), (a, b)


@given(poses(), poses())
def test_pose_trans_is_the_matrix_product(a, b) -> None:
    assert np.allclose(matrix(pose_trans(a, b)), matrix(a) @ matrix(b), atol=1e-9)


@given(poses(), poses(), poses())
def test_pose_trans_is_associative(a, b, c) -> None:
    assert_same(pose_trans(pose_trans(a, b), c), pose_trans(a, pose_trans(b, c)))


@given(poses())
def test_inverse(a) -> None:
    assert_same(pose_trans(a, pose_inv(a)), IDENTITY)
    assert_same(pose_trans(pose_inv(a), a), IDENTITY)
    assert_same(pose_trans(a, IDENTITY), a)


@given(poses(), poses())
def test_pose_sub_undoes_pose_add(a, b) -> None:
    assert_same(pose_sub(pose_add(a, b), b), a)
    assert np.allclose(matrix(pose_add(a, b))[:3, :3], matrix(a)[:3, :3] @ matrix(b)[:3, :3], atol=1e-9)


@given(poses())
def test_rotation_matrix_and_vector_are_inverses(a) -> None:
    turn = rotvec_to_matrix(*a[3:])
    assert np.allclose(np.array(turn).reshape(3, 3), matrix(a)[:3, :3], atol=1e-12)
    back = matrix_to_rotvec(turn)
    assert math.hypot(*back) <= math.pi + 1e-12
    assert_same((0, 0, 0, *back), (0, 0, 0, *a[3:]), 1e-12)


@given(st.tuples(st.floats(-3.14, 3.14), st.floats(-1.57, 1.57), st.floats(-3.14, 3.14)))
def test_roll_pitch_yaw(rpy) -> None:
    turn = rpy_to_rotvec(*rpy)
    about_x, about_y, about_z = matrix((0, 0, 0, rpy[0], 0, 0)), matrix((0, 0, 0, 0, rpy[1], 0)), matrix((0,) * 5 + (rpy[2],))
    assert np.allclose(matrix((0, 0, 0, *turn)), about_z @ about_y @ about_x, atol=1e-9)
    assert_same((0, 0, 0, *rpy_to_rotvec(*rotvec_to_rpy(*turn))), (0, 0, 0, *turn))


@given(poses(), poses(), st.floats(-0.5, 1.5))
def test_interpolation(a, b, alpha) -> None:
    assert_same(interpolate_pose(a, b, 0.0), a)
    assert_same(interpolate_pose(a, b, 1.0), b)
    between = interpolate_pose(a, b, alpha)
    assert math.isclose(point_dist(a, between), abs(alpha) * point_dist(a, b), abs_tol=1e-9)


def test_interpolation_goes_halfway() -> None:
    halfway = interpolate_pose(IDENTITY, (1.0, 2.0, 3.0, 0.0, 0.0, 1.0), 0.5)
    assert halfway == pytest.approx((0.5, 1.0, 1.5, 0.0, 0.0, 0.5))


@given(poses(), st.tuples(*[st.floats(-10, 10)] * 6), st.tuples(*[st.floats(-1, 1)] * 6))
def test_wrench_trans_keeps_power(frame, wrench, twist) -> None:
    """A wrench does the same work whichever frame it and the motion are told in."""
    linear, angular = np.array(twist[:3]), np.array(twist[3:])
    at_frame = linear + np.cross(angular, frame[:3])
    back = [-part for part in frame[3:]]
    local_twist = np.array([*turned(back, at_frame), *turned(back, angular)])
    assert np.dot(wrench_trans(frame, wrench), local_twist) == pytest.approx(np.dot(wrench, twist), abs=1e-8)
