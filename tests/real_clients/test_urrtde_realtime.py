"""ur_rtde's commands that are sent every cycle: servo, speed and jog."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from rig import START_Q, Rig, Watch
from rtde_control import RTDEControlInterface
from track import Track

from tests.budget import subset

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)

TIME_S = 0.03


def every_cycle(rig: Rig, control: RTDEControlInterface, seconds: float, command: Callable[[float], bool]) -> None:
    """Call ``command(t)`` once per control period, with ur_rtde's pacing."""
    for step in range(round(seconds / rig.period_s)):
        began = control.initPeriod()
        assert command(step * rig.period_s)
        control.waitPeriod(began)


def steady_part(track: Track, seconds: float) -> Track:
    """The recording without its first seconds of motion."""
    motion = track.in_motion
    part = motion.t > motion.t[0] + seconds
    return Track(motion.t[part], motion.q[part], motion.qd[part], motion.pose[part], motion.twist[part])


def assert_at_rest(state: Watch) -> None:
    state.wait_until_still(timeout_s=2)
    first = state.newest()
    later = state.wait_for(0.1)
    assert later["actual_q"] == first["actual_q"]
    assert later["target_qd"] == (0.0,) * 6


@both_series
def test_servo_j_follows_a_circle_in_joint_space(rig: Rig, control: RTDEControlInterface) -> None:
    radius, turns_per_s, lookahead = 0.1, 0.5, 0.1
    omega = 2 * math.pi * turns_per_s

    def command(t: float) -> bool:
        q = list(START_Q)
        q[0] += radius * (math.cos(omega * t) - 1)
        q[1] += radius * math.sin(omega * t)
        return bool(control.servoJ(q, 0.0, 0.0, rig.period_s, lookahead, 300))

    with rig.watch() as state:
        every_cycle(rig, control, 2.5, command)
        assert control.servoStop()
        assert_at_rest(state)
        track = steady_part(state.track, 0.5)
    followed = track.t < track.t[-1] - 0.2
    distance = np.hypot(track.q[followed, 0] - START_Q[0] + radius, track.q[followed, 1] - START_Q[1])
    np.testing.assert_allclose(distance, radius, rtol=0.1)
    angle = np.unwrap(np.arctan2(track.q[followed, 1] - START_Q[1], track.q[followed, 0] - START_Q[0] + radius))
    assert np.diff(angle).min() > -1e-3  # always forward
    assert omega * (2.5 - 0.4) < angle[-1] % (2 * math.pi) + 2 * math.pi < omega * 2.5
    np.testing.assert_allclose(track.q[followed, 2:], np.tile(START_Q[2:], (followed.sum(), 1)), atol=1e-6)


def test_servo_l_follows_a_circle_of_the_tool(rig: Rig, control: RTDEControlInterface) -> None:
    radius, omega = 0.03, 2 * math.pi * 0.5
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])

        def command(t: float) -> bool:
            pose = list(start)
            pose[0] += radius * (math.cos(omega * t) - 1)
            pose[1] += radius * math.sin(omega * t)
            return bool(control.servoL(pose, 0.0, 0.0, rig.period_s, 0.1, 300))

        every_cycle(rig, control, 2.0, command)
        assert control.servoStop()
        assert_at_rest(state)
        track = steady_part(state.track, 0.5)
    followed = track.t < track.t[-1] - 0.2
    distance = np.hypot(track.pose[followed, 0] - start[0] + radius, track.pose[followed, 1] - start[1])
    np.testing.assert_allclose(distance, radius, rtol=0.1)
    np.testing.assert_allclose(track.pose[:, 2], start[2], atol=0.002)


def test_servo_j_settles_on_a_constant_target(rig: Rig, control: RTDEControlInterface) -> None:
    target = [START_Q[0] + 0.05, *START_Q[1:]]
    with rig.watch() as state:
        every_cycle(rig, control, 1.0, lambda _: control.servoJ(target, 0.0, 0.0, rig.period_s, 0.05, 500))
        sample = state.wait_for(0.1)
        assert control.servoStop()
    assert sample["actual_q"] == pytest.approx(target, abs=1e-3)


def test_servo_c_reaches_its_pose(rig: Rig, control: RTDEControlInterface) -> None:
    """Ended by stopping the program: ur_rtde's script blocks servoStop(), since it treats servoC() as a move."""
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        target = [start[0], start[1] + 0.05, *start[2:]]
        assert control.servoC(target, 0.1, 0.5, 0.0)
        state.wait_until_moving()
        state.wait_until(lambda sample: np.allclose(sample["actual_TCP_pose"], target, atol=1e-3), timeout_s=5)
        rig.process.dashboard("stop")
        assert_at_rest(state)
        assert state.settled()["actual_TCP_pose"] == pytest.approx(target, abs=2e-3)


@both_series
def test_speed_j_ramps_holds_and_stops(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.speedJ([0.5, 0, 0, 0, 0, 0], 2.0)
        state.wait_until(lambda sample: sample["target_qd"][0] == pytest.approx(0.5, abs=1e-6))
        state.wait_for(0.4)
        assert control.speedStop(5.0)
        track = state.track.in_motion
        assert_at_rest(state)
    full_speed = np.flatnonzero(track.qd[:, 0] > 0.4999)
    held = slice(full_speed[0], full_speed[-1] + 1)
    assert track.t[full_speed[0]] - track.t[0] == pytest.approx(0.5 / 2.0, abs=TIME_S)
    assert np.all(track.qd[held, 0] > 0.4999)
    assert track.t[-1] - track.t[full_speed[-1]] == pytest.approx(0.5 / 5.0, abs=TIME_S)
    np.testing.assert_allclose(track.q[:, 1:], np.tile(START_Q[1:], (len(track.t), 1)), atol=1e-6)


def test_speed_j_takes_a_new_speed_without_a_stop(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.speedJ([0.5, 0, 0, 0, 0, 0], 4.0)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.499)
        assert control.speedJ([0.5, -0.3, 0, 0, 0, 0], 4.0)
        state.wait_until(lambda sample: sample["target_qd"][1] < -0.299)
        assert control.speedStop()
        track = state.track
    assert track.halts == 0
    assert np.abs(np.diff(track.qd, axis=0)).max() < 10.0 * 0.012  # speedStop brakes with 10 rad/s2


@both_series
def test_speed_l_moves_the_tool_straight(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        assert control.speedL([0, 0.04, 0.03, 0, 0, 0], 0.5)
        state.wait_until(lambda sample: np.linalg.norm(sample["target_TCP_speed"][:3]) > 0.0499)
        state.wait_for(0.5)
        assert control.speedStop(1.0)
        track = state.track.in_motion
        assert_at_rest(state)
    assert track.speed.max() == pytest.approx(0.05, abs=1e-3)
    assert track.off_line(start, [start[0], start[1] + 0.04, start[2] + 0.03]) < 2e-4
    full_speed = np.flatnonzero(track.speed > 0.0499)
    assert track.t[full_speed[0]] - track.t[0] == pytest.approx(0.05 / 0.5, abs=TIME_S)
    assert track.t[-1] - track.t[full_speed[-1]] == pytest.approx(0.05 / 1.0, abs=TIME_S)


def test_jog_in_the_base_frame(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        assert control.jogStart([0, 0, 0.05, 0, 0, 0], control.FEATURE_BASE, 0.5)
        state.wait_until(lambda sample: sample["target_TCP_speed"][2] > 0.0499)
        state.wait_for(0.3)
        assert control.jogStop()
        track = state.track.in_motion
        assert_at_rest(state)
    assert track.pose[-1, 2] - start[2] > 0.3 * 0.05
    assert track.off_line(start, [start[0], start[1], start[2] + 1]) < 2e-4
    full_speed = np.flatnonzero(track.speed > 0.0499)
    assert track.t[-1] - track.t[full_speed[-1]] == pytest.approx(0.05 / 1.2, abs=TIME_S)  # its script: stopl(1.2)


def test_jog_in_the_tool_frame(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        ahead = control.poseTrans(start, [0, 0, -0.1, 0, 0, 0])
        assert control.jogStart([0, 0, -0.05, 0, 0, 0], control.FEATURE_TOOL, 0.5)
        state.wait_until(lambda sample: np.linalg.norm(sample["target_TCP_speed"][:3]) > 0.0499)
        assert control.jogStop()
        track = state.track
    assert track.off_line(start, ahead) < 2e-4
    moved = np.array(track.pose[-1, :3]) - start[:3]
    assert moved @ (np.array(ahead[:3]) - start[:3]) > 0
