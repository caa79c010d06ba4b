"""ur_rtde's blocking and asynchronous moves: final positions, paths and durations."""

import numpy as np
import pytest
from pose_matrices import transform
from rig import START_Q, Rig
from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
from track import profile_time

from tests.budget import subset

pytestmark = pytest.mark.robot_speed(4)

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)

TIME_S = 0.03  # the watch sees 125 Hz; profiles are rounded to whole control periods
JOINT_RAD = 1e-5
LINE_M = 1e-4


def turned(*changes: tuple[int, float]) -> list[float]:
    """START_Q with some joints rotated by some angle."""
    q = list(START_Q)
    for joint, angle in changes:
        q[joint] += angle
    return q


def shifted(pose: list[float], x: float = 0.0, y: float = 0.0, z: float = 0.0) -> list[float]:
    return [pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:]]


@both_series
def test_the_duration_of_move_j_is_that_of_its_leading_joint(rig: Rig, control: RTDEControlInterface) -> None:
    target = turned((0, 0.8), (3, -0.4))
    with rig.watch() as state:
        assert control.moveJ(target, 2.0, 8.0)
        track = state.track
    assert track.q[-1] == pytest.approx(target, abs=JOINT_RAD)
    assert track.moving_time == pytest.approx(profile_time(0.8, 2.0, 8.0), abs=TIME_S)
    assert np.abs(track.qd).max() == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(track.q[:, 3] - START_Q[3], (track.q[:, 0] - START_Q[0]) * -0.5, atol=1e-6)


@both_series
def test_move_l_stays_on_the_line(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        target = shifted(start, 0.06, -0.05, 0.04)
        assert control.moveL(target, 0.25, 1.2)
        track = state.track
    np.testing.assert_allclose(transform(track.pose[-1]), transform(target), atol=1e-5)
    assert track.moving_time == pytest.approx(profile_time(np.linalg.norm([0.06, 0.05, 0.04]), 0.25, 1.2), abs=TIME_S)
    assert track.off_line(start, target) < LINE_M
    assert track.speed.max() == pytest.approx(0.25, abs=0.002)
    np.testing.assert_allclose(track.pose[:, 3:], np.tile(start[3:], (len(track.t), 1)), atol=1e-4)


def test_move_j_ik_reaches_the_pose_by_a_joint_space_path(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        target = shifted(start, y=0.1, z=0.08)
        assert control.moveJ_IK(target, 1.0, 4.0)
        track = state.track
    np.testing.assert_allclose(transform(track.pose[-1]), transform(target), atol=1e-5)
    leading = np.abs(track.q[-1] - START_Q).max()
    assert track.moving_time == pytest.approx(profile_time(leading, 1.0, 4.0), abs=TIME_S)
    progress = (track.q - START_Q) / (track.q[-1] - START_Q)
    np.testing.assert_allclose(progress, np.tile(progress[:, :1], 6), atol=1e-3)


def test_move_l_fk_goes_straight_to_a_joint_position(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        target = shifted(start, x=-0.03, y=0.1)
        target_q = control.getInverseKinematics(target)
        assert control.moveL_FK(target_q, 0.25, 1.2)
        track = state.track
    assert track.q[-1] == pytest.approx(target_q, abs=JOINT_RAD)
    assert track.off_line(start, target) < LINE_M
    assert track.moving_time == pytest.approx(profile_time(np.hypot(0.03, 0.1), 0.25, 1.2), abs=TIME_S)


@both_series
def test_move_j_path_with_blends_does_not_stop_on_the_way(rig: Rig, control: RTDEControlInterface) -> None:
    v, a, blend = 1.0, 5.0, 0.02
    corners = [turned((0, 0.5)), turned((0, 0.5), (1, -0.3)), turned((1, -0.3))]
    path = [[*q, v, a, blend] for q in corners[:-1]] + [[*corners[-1], v, a, 0.0]]
    with rig.watch() as state:
        assert control.moveJ(path)
        track = state.track
    assert track.q[-1] == pytest.approx(corners[-1], abs=JOINT_RAD)
    assert track.halts == 0
    stopping = profile_time(0.5, v, a) + profile_time(0.3, v, a) + profile_time(0.5, v, a)
    assert 1.3 / v < track.moving_time < stopping - 0.1
    assert np.abs(track.qd).max() < v + 0.01


def test_move_j_path_without_blends_stops_at_each_corner(rig: Rig, control: RTDEControlInterface) -> None:
    v, a = 2.0, 10.0
    corners = [turned((0, 0.3)), turned((0, 0.3), (1, -0.3)), turned((1, -0.3))]
    with rig.watch() as state:
        assert control.moveJ([[*q, v, a, 0.0] for q in corners])
        track = state.track
    for corner in corners:
        assert np.abs(track.q - corner).max(axis=1).min() < 1e-3
    at_rest = 2 * 2 * rig.period_s  # two corners, some periods each
    assert track.moving_time == pytest.approx(3 * profile_time(0.3, v, a) + at_rest, abs=3 * TIME_S)


@both_series
def test_move_l_path_rounds_its_corners_within_the_blend_radius(rig: Rig, control: RTDEControlInterface) -> None:
    v, a, blend = 0.2, 1.0, 0.02
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        corners = [shifted(start, y=0.1), shifted(start, y=0.1, z=0.1), shifted(start, z=0.1)]
        path = [[*pose, v, a, blend] for pose in corners[:-1]] + [[*corners[-1], v, a, 0.0]]
        assert control.moveL(path)
        track = state.track
    assert track.pose[-1] == pytest.approx(corners[-1], abs=1e-4)
    assert track.halts == 0
    for corner in corners[:-1]:
        assert 0.001 < track.nearest(corner) <= blend
    assert 0.3 / v - 4 * blend / v < track.moving_time < 3 * profile_time(0.1, v, a)
    assert track.speed.max() < v * 1.01


def test_move_path_mixes_joint_and_linear_moves(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        up, aside = shifted(start, z=0.05), shifted(start, y=0.08, z=0.05)
        path = Path()
        path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [*up, 0.2, 1.0, 0.01]))
        path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [*aside, 0.2, 1.0, 0.0]))
        path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [*START_Q, 1.0, 5.0, 0.0]))
        assert control.movePath(path)
        track = state.track
    assert track.q[-1] == pytest.approx(START_Q, abs=JOINT_RAD)
    assert track.nearest(aside) < 1e-4
    assert 0.001 < track.nearest(up) <= 0.01


def test_move_j_slows_down_with_the_speed_slider(rig: Rig, control: RTDEControlInterface, io: RTDEIOInterface) -> None:
    target = turned((0, 0.6))
    full = profile_time(0.6, 1.5, 6.0)
    assert io.setSpeedSlider(0.5)
    with rig.watch() as state:
        state.wait_until(lambda sample: sample["target_speed_fraction"] == 0.5)
        assert control.moveJ(target, 1.5, 6.0)
        track = state.track
    assert track.q[-1] == pytest.approx(target, abs=JOINT_RAD)
    assert track.moving_time == pytest.approx(full / 0.5, abs=2 * TIME_S)
    assert np.abs(track.qd).max() == pytest.approx(0.75, abs=0.01)


@both_series
def test_asynchronous_move_j_is_stopped_by_stop_j(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.moveJ(turned((0, 2.0)), 1.0, 4.0, True)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.999)
        assert control.getAsyncOperationProgressEx().isAsyncOperationRunning()
        control.stopJ(2.0)
        track = state.track.in_motion
        state.wait_until_still()
    assert not control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    full_speed = np.flatnonzero(track.qd[:, 0] > 0.999)[-1]
    assert track.t[-1] - track.t[full_speed] == pytest.approx(1.0 / 2.0, abs=TIME_S)
    assert track.q[-1, 0] - track.q[full_speed, 0] == pytest.approx(1.0 / (2 * 2.0), abs=0.01)
    assert track.q[-1, 0] < START_Q[0] + 1.9


def test_asynchronous_move_l_is_stopped_on_its_line_by_stop_l(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        start = list(state.next()["actual_TCP_pose"])
        target = shifted(start, y=0.15)
        assert control.moveL(target, 0.1, 1.0, True)
        state.wait_until(lambda sample: np.linalg.norm(sample["target_TCP_speed"][:3]) > 0.0999)
        control.stopL(0.5, True)
        state.wait_until_still()
        track = state.track.in_motion
    full_speed = np.flatnonzero(track.speed > 0.0999)[-1]
    assert track.t[-1] - track.t[full_speed] == pytest.approx(0.1 / 0.5, abs=TIME_S)
    assert track.off_line(start, target) < LINE_M
    assert track.pose[-1, 1] < target[1] - 0.02


def test_asynchronous_path_reports_its_progress(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    v, a = 1.0, 5.0
    corners = [turned((0, 0.3)), turned((0, 0.3), (1, -0.3)), turned((1, -0.3))]
    seen = []
    with rig.watch() as state:
        assert control.moveJ([[*q, v, a, 0.0] for q in corners], True)
        state.wait_until_moving()

        def finished(_: object) -> bool:
            status = control.getAsyncOperationProgressEx()
            seen.append(status.progress() if status.isAsyncOperationRunning() else -1)
            return bool(seen[-1] < 0)

        state.wait_until(finished)
    assert sorted(set(seen)) == [-1, 0, 1, 2]
    rig.eventually(lambda: receive.getActualQ() == pytest.approx(corners[-1], abs=JOINT_RAD))


def test_a_new_asynchronous_move_replaces_the_current_one(rig: Rig, control: RTDEControlInterface) -> None:
    target = turned((1, -0.2))
    with rig.watch() as state:
        assert control.moveJ(turned((0, 2.0)), 1.0, 4.0, True)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.999)
        assert control.moveJ(target, 1.0, 4.0)
        track = state.track
    assert track.q[-1] == pytest.approx(target, abs=JOINT_RAD)
    assert np.abs(np.diff(track.qd, axis=0)).max() < 0.5  # no jump of the target speed
