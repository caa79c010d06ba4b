"""Interpolation against polynomials, and against cases that ros2_controllers publishes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from client.controllers.goals import JointTrajectoryPoint
from client.controllers.joint_trajectory import deceleration
from client.controllers.trajectory import Path, SplineSegment

NUMBERS = st.floats(-10.0, 10.0)


def point(time_s=0.0, q=None, qd=None, qdd=None):
    values = [() if value is None else (value,) for value in (q, qd, qdd)]
    return JointTrajectoryPoint(*values, time_from_start_s=time_s)


def polynomial(coefficients, x, derivative=0):
    """Value of sum c_i x^i, or of its derivative."""
    for _ in range(derivative):
        coefficients = [i * c for i, c in enumerate(coefficients)][1:]
    return sum(c * x**i for i, c in enumerate(coefficients))


def ends(coefficients, x0, x1, derivatives):
    """Points at x0 and x1 with as many derivatives of the polynomial."""
    return [point(x, *(polynomial(coefficients, x, order) for order in range(derivatives + 1))) for x in (x0, x1)]


@pytest.mark.parametrize("degree", [1, 3, 5])
@given(data=st.data())
def test_a_polynomial_of_the_degree_is_met_everywhere(degree, data):
    coefficients = data.draw(st.lists(NUMBERS, min_size=degree + 1, max_size=degree + 1))
    x0, length = data.draw(st.floats(-2.0, 2.0)), data.draw(st.floats(0.1, 3.0))
    first, second = ends(coefficients, x0, x0 + length, {1: 0, 3: 1, 5: 2}[degree])
    segment = SplineSegment(first, second, length)
    for share in (0.0, 0.3, 0.7, 1.0):
        got = segment.at(share * length)
        for order, values in enumerate((got.positions, got.velocities, got.accelerations)):
            wanted = polynomial(coefficients, x0 + share * length, order)
            assert values[0] == pytest.approx(wanted, rel=1e-6, abs=1e-4)


def test_published_case_cubic():
    """x^3 - 2x from 0 to 2, as in ros2_controllers' test_trajectory: v 4 and a 6 sqrt 2 at the zero at sqrt 2.

    The end's acceleration does not count, since the beginning has none.
    """
    segment = SplineSegment(point(q=0.0, qd=-2.0), point(q=4.0, qd=10.0, qdd=0.0), 2.0)
    root = math.sqrt(2.0)
    for x, wanted in ((0.0, (0.0, -2.0, 0.0)), (root, (0.0, 4.0, 6.0 * root)), (2.0, (4.0, 10.0, 12.0))):
        got = segment.at(x)
        assert (got.positions[0], got.velocities[0], got.accelerations[0]) == pytest.approx(wanted, abs=1e-9)


def test_published_case_quintic():
    """x(x-1)(x-2)(x-3)(x-4) from 1 to 3, as in ros2_controllers' test_trajectory: v -6 and a 10 at the zero at 2."""
    coefficients = [0.0, 24.0, -50.0, 35.0, -10.0, 1.0]
    first, second = ends(coefficients, 1.0, 3.0, 2)
    assert (first.velocities[0], first.accelerations[0]) == (-6.0, 10.0)
    for x in (1.0, 2.0, 3.0):
        got = SplineSegment(first, second, 2.0).at(x - 1.0)
        assert got.positions[0] == pytest.approx(0.0, abs=1e-9)
        assert got.velocities[0] == pytest.approx(polynomial(coefficients, x, 1))
        assert got.accelerations[0] == pytest.approx(polynomial(coefficients, x, 2))


def test_published_case_of_speeds_alone():
    """Speeds 1, 2, 1 rad/s at 1, 2, 3 s: positions 0.5, 2 and 3.5, half-way 0.125, 1.125 and 2.875."""
    path = Path([point(1.0, qd=1.0), point(2.0, qd=2.0), point(3.0, qd=1.0)])
    path.begin(100.0, point(q=0.0, qd=0.0))
    wanted = {0.0: (0, 0), 0.5: (0.125, 0.5), 1.0: (0.5, 1), 1.5: (1.125, 1.5), 2.0: (2, 2), 2.5: (2.875, 1.5)}
    wanted |= {3.0: (3.5, 1), 3.125: (3.5, 1)}
    for time_s, (q, qd) in wanted.items():
        got = path.sample(100.0 + time_s).point
        assert (got.positions[0], got.velocities[0]) == pytest.approx((q, qd))
    assert path.sample(99.5) is None
    assert path.sample(103.2).point.accelerations == (0.0,)


def test_published_case_of_accelerations_alone():
    """Accelerations 1, 2, 1 at 1, 2, 3 s, by Heun's method: speeds 0.5, 2, 3.5, positions 0.25, 1.5, 4.25."""
    path = Path([point(1.0, qdd=1.0), point(2.0, qdd=2.0), point(3.0, qdd=1.0)])
    path.begin(5.0, point(q=0.0, qd=0.0, qdd=0.0))
    got = [path.sample(5.0 + time_s).point for time_s in (1.0, 2.0, 3.0)]
    assert [p.velocities[0] for p in got] == pytest.approx([0.5, 2.0, 3.5])
    assert [p.positions[0] for p in got] == pytest.approx([0.25, 1.5, 4.25])


def test_the_way_to_the_first_point_has_the_degree_of_the_others():
    path = Path([point(2.0, q=1.0, qd=0.0)])
    path.begin(0.5, point(q=0.0))
    half = path.sample(1.5).point
    assert (half.positions[0], half.velocities[0]) == pytest.approx((0.5, 0.75))


def test_without_splines_each_point_counts_from_the_one_before():
    path = Path([point(1.0, q=1.0), point(2.0, q=2.0)], splines=False)
    path.begin(10.0, point(q=0.0))
    assert [path.sample(10.0 + t).point.positions[0] for t in (0.5, 1.5, 2.5)] == [0.0, 2.0, 2.0]


def test_indices_and_times_of_samples():
    path = Path([point(1.0, q=1.0), point(3.0, q=2.0)])
    path.begin(10.0, point(q=0.0))
    samples = [path.sample(10.0 + t) for t in (0.25, 1.0, 2.0, 3.5)]
    assert [sample.index for sample in samples] == [0, 1, 1, 2]
    assert [sample.since_s for sample in samples] == pytest.approx([-0.75, 0.0, 1.0, 0.5])


@given(st.lists(st.tuples(NUMBERS, st.floats(-3.0, 3.0), st.floats(0.1, 40.0)), min_size=1, max_size=6))
def test_braking_is_steady_and_ends_at_rest(joints):
    q, v, a = zip(*joints, strict=True)
    path = Path(deceleration(q, v, a))
    path.begin(1.0, JointTrajectoryPoint(q, v))
    longest = max(abs(speed) / limit for speed, limit in zip(v, a, strict=True))
    for share in (0.0, 0.25, 0.6, 1.0):
        t = share * longest
        got = path.sample(1.0 + t).point
        for joint, (start, speed, limit) in enumerate(joints):
            s = min(t, abs(speed) / limit)
            brake = -math.copysign(limit, speed)
            assert got.positions[joint] == pytest.approx(start + speed * s + brake * s * s / 2.0, abs=1e-6)
            assert got.velocities[joint] == pytest.approx(speed + brake * s, abs=1e-6)
