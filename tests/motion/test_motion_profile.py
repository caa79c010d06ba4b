"""Trapezoids against their closed form."""

import itertools
from math import sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.motion.profile import Limits, Profile, limits_for_duration
from tests.rows import each_row

positive = st.floats(0.01, 10.0)


@each_row(
    ("length", "speed", "acceleration", "duration"),
    [
        (2.0, 1.0, 2.0, 2.5),  # cruises: L/v + v/a
        (0.5, 1.0, 2.0, 1.0),  # just reaches v: 2v/a
        (0.125, 1.0, 2.0, 0.5),  # never cruises: 2 sqrt(L/a)
    ],
)
def test_duration(length, speed, acceleration, duration):
    assert Profile.plan(0.0, length, Limits(speed, acceleration)).duration == pytest.approx(duration)


def test_zero_distance_takes_no_time():
    profile = Profile.plan(0.3, 0.3, Limits(1.0, 1.0))
    assert profile.duration == 0.0
    assert profile.position(0.0) == 0.3


@given(length=positive, speed=positive, acceleration=positive, start_share=st.floats(0.0, 1.0))
def test_the_profile_keeps_its_limits_and_ends_exactly(length, speed, acceleration, start_share):
    limits = Limits(speed, acceleration)
    start_speed = start_share * min(speed, sqrt(2 * acceleration * length))
    profile = Profile.plan(1.0, 1.0 + length, limits, start_speed)
    h = profile.duration / 200
    places = [profile.position(i * h) for i in range(201)]
    speeds = [(b - a) / h for a, b in itertools.pairwise(places)]
    assert places[0] == pytest.approx(1.0)
    assert profile.position(profile.duration) == 1.0 + length
    assert all(-1e-9 <= v <= speed * (1 + 1e-9) for v in speeds)
    assert all(abs(b - a) <= acceleration * h * (1 + 1e-6) + 1e-9 for a, b in itertools.pairwise(speeds))
    assert profile.speed(0.0) == pytest.approx(start_speed)
    assert profile.speed(profile.duration) == 0.0


@given(length=positive, duration=positive, speed=positive, acceleration=positive)
def test_a_given_duration_is_kept_or_stretched_to_the_shortest_allowed(length, duration, speed, acceleration):
    most = Limits(speed, acceleration)
    quickest = Profile.plan(0.0, length, most).duration
    chosen = limits_for_duration(length, duration, most)
    assert chosen.speed <= most.speed * (1 + 1e-9)
    assert chosen.acceleration <= most.acceleration * (1 + 1e-9)
    assert Profile.plan(0.0, length, chosen).duration == pytest.approx(max(duration, quickest), rel=1e-6)
