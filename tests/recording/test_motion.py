"""Recorded paths as trajectories: close to the recording, within limits, without guesses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_rig import GOAL, HOME, array, record, recording

from client.errors import MotionError, OutOfReachError, RecordingError
from client.recording import joint_path, read
from urproto.primary.subpackages import ConfigurationData

TIME_S = np.arange(251) * 0.008


def swing(radius: float, period_s: float = 2.0):
    """All joints back and forth, from rest to rest."""
    offset = radius * (1.0 - np.cos(2.0 * np.pi * TIME_S / period_s)) / 2.0
    return np.array(HOME) + offset[:, None]


@pytest.fixture(scope="module")
def arm() -> ConfigurationData:
    """The limits reported by a UR5e."""
    six = (0.0,) * 6
    values = dict.fromkeys(("dh_a", "dh_d", "dh_alpha", "dh_theta"), six)
    limits = {
        "q_min": (-2 * math.pi,) * 6,
        "q_max": (2 * math.pi,) * 6,
        "qd_max": (math.pi,) * 6,
        "qdd_max": (14.0,) * 6,
    }
    numbers = dict.fromkeys(
        ("v_joint_default", "a_joint_default", "v_tool_default", "a_tool_default", "eq_radius"), 1.0
    )
    words = dict.fromkeys(("masterboard_version", "controller_box", "robot_type", "sub_type"), 0)
    return ConfigurationData(**values, **limits, **numbers, **words)


def test_the_path_consists_of_the_joint_targets(states, tmp_path) -> None:
    path = joint_path(read(record(tmp_path / "run.mcap", states)))
    time_s = array(states, "timestamp") - states[0]["timestamp"]
    assert np.max(np.abs(path.at(time_s) - array(states, "target_q"))) < 5e-4
    assert len(path.points()) < len(states) / 4
    assert path.start_rad == pytest.approx(states[0]["target_q"])
    assert np.max(np.abs(path.at(time_s) - GOAL), axis=1).min() < 1e-3  # it was at this position
    assert not path.qd_rad_s[[0, -1]].any()


@given(st.floats(0.2, 3.0), st.floats(0.1, 2.0))
def test_speed_scales_only_time(speed: float, radius: float) -> None:
    once, scaled = joint_path(recording(TIME_S, swing(radius))), joint_path(recording(TIME_S, swing(radius)), speed)
    assert scaled.duration_s == pytest.approx(once.duration_s / speed)
    assert np.allclose(scaled.at(TIME_S / speed), once.at(TIME_S))


def test_a_path_without_targets_uses_measured_angles() -> None:
    measured = recording(TIME_S, swing(0.3))
    values = dict(measured.values)
    values["actual_q"] = values.pop("target_q")
    path = joint_path(type(measured)(values))
    assert np.max(np.abs(path.at(TIME_S) - swing(0.3))) < 5e-4


def test_limits_are_those_of_the_robot(arm) -> None:
    joint_path(recording(TIME_S, swing(0.5))).check(arm)
    with pytest.raises(OutOfReachError, match="needs elbow at"):
        joint_path(recording(TIME_S, swing(7.0))).check(arm)
    with pytest.raises(MotionError, match=r"rad/s at .* s, above its limit of 3\.14 rad/s: try --speed \S+$"):
        joint_path(recording(TIME_S, swing(0.5)), 5.0).check(arm)


def test_the_suggested_speed_is_feasible(arm) -> None:
    measured, speed = recording(TIME_S, swing(0.5)), 8.0
    for _ in range(2):  # one for each kind of limit
        try:
            joint_path(measured, speed).check(arm)
        except MotionError as error:
            speed = float(str(error).split("--speed ")[1].split()[0])
    joint_path(measured, speed).check(arm)
    assert speed > 2.0


def test_a_recording_that_ends_in_motion_exceeds_the_acceleration_limit(arm) -> None:
    with pytest.raises(MotionError, match="rad/s2"):
        joint_path(recording(TIME_S[:60], swing(1.0)[:60])).check(arm)


def test_a_few_missing_states_cause_no_jerk(states, arm) -> None:
    missing = {*range(100, 111), *range(150, 190), 301, 303, 305, *range(600, 630)}  # up to 80 ms
    few = [state for number, state in enumerate(states) if number not in missing]
    path = joint_path(type(recording(TIME_S, TIME_S))({name: array(few, name) for name in few[0]}))
    path.check(arm)
    time_s = array(states, "timestamp") - states[0]["timestamp"]
    assert np.max(np.abs(path.at(time_s) - array(states, "target_q"))) < 2e-3
    whole = joint_path(type(recording(TIME_S, TIME_S))({name: array(states, name) for name in states[0]}))
    fastest = [max(np.abs(part).max() for part in one._accelerations()) for one in (path, whole)]
    assert fastest[0] < 1.2 * fastest[1]


def test_a_gap_during_motion_is_an_error() -> None:
    time_s, q = np.delete(TIME_S, range(100, 140)), np.delete(swing(0.5), range(100, 140), axis=0)
    with pytest.raises(RecordingError, match=r"states are missing for 0\.33 s from 0\.79 s on"):
        joint_path(recording(time_s, q))
    still = np.tile(HOME, (len(time_s), 1))
    assert joint_path(recording(time_s, still)).duration_s == pytest.approx(TIME_S[-1])


def test_recordings_without_a_path_are_reported() -> None:
    with pytest.raises(RecordingError, match="1 states are too few for a path"):
        joint_path(recording(TIME_S[:1], swing(0.1)[:1]))
    with pytest.raises(RecordingError, match="some recorded joint angles are not numbers"):
        joint_path(recording(TIME_S, swing(0.1) * np.nan))
    with pytest.raises(RecordingError, match="actual_q was not recorded"):
        joint_path(type(recording(TIME_S, swing(0.1)))({"timestamp": TIME_S}))
