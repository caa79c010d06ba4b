"""Trajectories, point by point and as streams, through the driver's own control program."""

import asyncio

import pytest
from driver_rig import HOME, PATIENCE_S

from client.driver import points
from client.errors import NoAnswerError
from emulator.lifecycle.safety import SafetyEvent
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import MotionType, TrajectoryPoint, TrajectoryResult
from urproto.modes import RuntimeState

SUCCESS, CANCELED, FAILURE = TrajectoryResult
ONE_ROBOT = pytest.mark.parametrize("robot", ["ur5e"], indirect=True)


def off(*offsets):
    """Joint angles away from HOME."""
    return tuple(q + offset for q, offset in zip(HOME, (*offsets, 0, 0, 0, 0, 0, 0), strict=False))


def shifted(pose, x=0.0, y=0.0, z=0.0):
    return (pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:])


async def test_joint_moves_with_a_blend(pair):
    way = [points.movej(off(0.2), v=2, a=5, blend_radius_m=0.02), points.movej(off(0.2, 0.1), v=2, a=5)]
    assert await pair.driver.execute(way) is SUCCESS
    assert pair.distance(off(0.2, 0.1)) < 1e-6
    assert pair.at_rest


async def test_a_duration_replaces_speed_and_acceleration(pair):
    begin = pair.snapshot.timestamp
    assert await pair.driver.execute([points.movej(off(0.1), duration_s=0.8)]) is SUCCESS
    assert pair.snapshot.timestamp - begin == pytest.approx(0.8, abs=0.15)


async def test_tool_moves_and_an_arc(pair):
    pose = pair.snapshot.actual_TCP_pose
    way = [
        points.movel(shifted(pose, z=0.03), v=0.5),
        points.movep(shifted(pose, x=0.03, z=0.03), v=0.2, blend_radius_m=0.005),
        points.movec(shifted(pose, x=0.045, y=0.015, z=0.03), shifted(pose, x=0.03, y=0.03, z=0.03), v=0.2),
        points.movej_pose(shifted(pose, z=0.01)),
        points.movej_pose(pose, near_q_rad=HOME),
    ]
    assert await pair.driver.execute(way) is SUCCESS
    assert pair.distance() < 1e-3


async def test_moves_whose_target_is_of_the_other_kind(pair):
    pose = pair.snapshot.actual_TCP_pose
    parameters = (0.2, 1.0, 0.0, 0.0, 0.0, 0.0)
    via = shifted(pose, x=0.02, y=0.01)
    way = [
        TrajectoryPoint(MotionType.MOVEL_JOINT, off(0.05), parameters=parameters),
        TrajectoryPoint(MotionType.MOVEP_JOINT, HOME, parameters=parameters),
        TrajectoryPoint(MotionType.MOVEC_JOINT_POSE, off(0.05), via, parameters),
        TrajectoryPoint(MotionType.MOVEC_POSE_JOINT, pose, off(0.02, 0.02), parameters),
        TrajectoryPoint(MotionType.MOVEC_JOINT, off(0.05), off(0.02, 0.02), parameters),
    ]
    assert await pair.driver.execute(way) is SUCCESS
    assert pair.distance(off(0.05)) < 1e-3


@ONE_ROBOT
async def test_optimoves(pair):
    pose = pair.snapshot.actual_TCP_pose
    assert await pair.driver.execute([points.optimovej(off(0.1)), points.optimovel(pose)]) is SUCCESS
    assert pair.distance() < 1e-3


@pytest.mark.parametrize("robot", ["ur3", "ur5e 5.20"], indirect=True)
async def test_optimoves_need_a_newer_robot(pair):
    with pytest.raises(RobotRefused, match="optimove"):
        await pair.driver.execute([points.optimovej(HOME)])


@pytest.mark.parametrize("quintic", [False, True])
async def test_splines_pass_through_their_points(pair, quintic):
    seen = []
    stop = pair.robot.controller.subscribe(lambda s: seen.append((s.target_q[0] - HOME[0], max(map(abs, s.target_qd)))))
    qdd = (0.0,) * 6 if quintic else None
    way = [
        points.spline(off(0.1), (0.2, 0, 0, 0, 0, 0), 0.5, qdd),
        points.spline(off(0.2), (0.2, 0, 0, 0, 0, 0), 0.5, qdd),
        points.spline(off(0.3), (0.0,) * 6, 0.5, qdd),
    ]
    assert await pair.driver.execute(way) is SUCCESS
    stop()
    assert pair.distance(off(0.3)) < 1e-3
    assert max(speed for _, speed in seen) < 0.4
    middle = [speed for way, speed in seen if 0.095 < way < 0.205]
    assert min(middle) > 0.1, "no stop between the segments"


@pytest.mark.parametrize("braked_by", ["pause", "protective stop"])
async def test_a_pause_does_not_move_the_end_of_a_spline(pair, braked_by):
    """Reported: splines that were paused ended 0.04 rad away, and the result was SUCCESS."""
    controller = pair.robot.controller
    way = [points.spline(off(0.2), (0.3, 0, 0, 0, 0, 0), 0.5), points.spline(off(0.4), (0.0,) * 6, 0.5)]
    assert await pair.driver.execute(way) is SUCCESS
    undisturbed = pair.q
    assert await pair.driver.execute([points.movej(HOME, duration_s=1.0)]) is SUCCESS
    executed = asyncio.ensure_future(pair.driver.execute(way))
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.3)
    if braked_by == "pause":
        controller.programs.pause()
    else:
        controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    await pair.until(lambda: controller.programs.state is RuntimeState.PAUSED)
    await pair.periods(100)
    controller.safety_event(SafetyEvent.UNLOCK)
    assert controller.programs.resume()
    assert await executed is SUCCESS
    assert pair.distance(undisturbed) < 1e-6


async def test_a_spline_may_begin_where_the_arm_stands(pair):
    rest = (0.0,) * 6
    assert await pair.driver.execute([points.spline(HOME, rest, 0.0), points.spline(off(0.1), rest, 0.5)]) is SUCCESS
    assert pair.distance(off(0.1)) < 1e-3


@ONE_ROBOT
async def test_a_spline_that_ends_in_motion_is_slowed_down(pair):
    assert await pair.driver.execute([points.spline(off(0.2), (0.4, 0, 0, 0, 0, 0), 0.5)]) is SUCCESS
    assert pair.distance(off(0.2)) < 0.01
    assert pair.at_rest


async def test_an_impossible_spline_is_refused_and_the_next_trajectory_works(pair):
    rest = (0.0,) * 6
    way = [points.spline(off(3.0), rest, 0.01), points.spline(HOME, rest, 1.0), points.spline(HOME, rest, 1.0)]
    assert await pair.driver.execute(way) is CANCELED
    assert "too far away" in pair.robot.controller.popups.shown[-1].text
    assert pair.distance() < 0.01
    assert await pair.driver.execute([points.movej(off(0.1))]) is SUCCESS


async def test_no_points_are_a_success(pair):
    assert await pair.driver.execute([]) is SUCCESS


async def test_cancelling_stops_the_arm_and_drops_the_rest(pair):
    await pair.driver.start_trajectory([points.movej(off(1.0))] + [points.movej(HOME)] * 300)
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    assert await pair.driver.cancel_trajectory() is CANCELED
    assert pair.at_rest
    assert await pair.driver.execute([points.movej(off(0.3), v=2, a=5)]) is SUCCESS
    assert pair.distance(off(0.3)) < 1e-6


async def test_the_last_move_can_be_cancelled_too(pair):
    await pair.driver.start_trajectory([points.movej(off(1.0))])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    assert await pair.driver.cancel_trajectory() is CANCELED
    assert pair.at_rest


async def test_another_trajectory_replaces_the_one_under_way(pair):
    await pair.driver.start_trajectory([points.movej(off(1.0))])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    assert await pair.driver.execute([points.movej(off(0.1), v=2, a=5)]) is SUCCESS
    assert pair.distance(off(0.1)) < 1e-6


async def test_another_mode_ends_a_trajectory_with_a_result(pair):
    await pair.driver.start_trajectory([points.movej(off(1.0)), points.movej(HOME)])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    pair.driver.idle()
    assert await pair.driver.trajectory_result(5.0) is CANCELED
    assert await pair.driver.execute([points.movej(off(0.1), v=2, a=5)]) is SUCCESS


async def test_a_caller_that_is_cancelled_stops_the_arm(pair):
    task = asyncio.create_task(pair.driver.execute([points.movej(off(1.0))]))
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    await pair.until(lambda: pair.at_rest)
    assert pair.distance(off(1.0)) > 0.3
    assert await pair.driver.execute([points.movej(off(0.1), v=2, a=5)]) is SUCCESS


async def test_a_trajectory_that_takes_too_long_is_cancelled(pair):
    with pytest.raises(NoAnswerError):
        await pair.driver.execute([points.movej(off(1.0), duration_s=5.0)], timeout_s=0.3)
    await pair.until(lambda: pair.at_rest)
    assert await pair.driver.execute([points.movej(HOME, v=2, a=5)]) is SUCCESS


async def test_a_stream_of_moves(pair):
    await pair.driver.start_stream()
    for offset in (0.1, 0.2, 0.1):
        await pair.driver.stream([points.movej(off(offset), v=2, a=5)])
    assert await pair.driver.end_stream(10) is SUCCESS
    assert pair.distance(off(0.1)) < 1e-6


async def test_a_stream_of_splines(pair):
    speed = (0.2, 0, 0, 0, 0, 0)
    await pair.driver.start_stream()
    for index in range(1, 10):
        await pair.driver.stream([points.spline(off(0.02 * index), speed, 0.1)])
    await pair.driver.stream([points.spline(off(0.2), (0.0,) * 6, 0.2)])
    assert await pair.driver.end_stream(10) is SUCCESS
    assert pair.distance(off(0.2)) < 2e-3


async def test_a_stream_that_runs_dry_fails_and_the_next_one_works(pair):
    await pair.driver.start_stream()
    await pair.driver.stream([points.movej(off(0.1), v=2, a=5)])
    assert await pair.driver.trajectory_result(PATIENCE_S) is FAILURE
    await pair.driver.start_stream()
    await pair.driver.stream([points.movej(HOME, v=2, a=5)])
    assert await pair.driver.end_stream(10) is SUCCESS
    assert pair.distance() < 1e-6


async def test_points_for_a_stream_that_failed_are_not_taken_for_the_next(pair):
    await pair.driver.start_stream()
    await pair.until(lambda: any("did not come in time" in line for line in pair.log))
    await pair.driver.stream([points.movej(off(1.0))] * 3)
    assert await pair.driver.end_stream(10) is FAILURE
    assert await pair.driver.execute([points.movej(off(0.1), v=2, a=5)]) is SUCCESS
    assert pair.distance(off(0.1)) < 1e-6


async def test_cancelling_a_stream(pair):
    await pair.driver.start_stream()
    await pair.driver.stream([points.movej(off(1.0))] + [points.movej(HOME)] * 50)
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.2)
    assert await pair.driver.cancel_trajectory() is CANCELED
    assert pair.at_rest
    assert await pair.driver.execute([points.movej(off(0.1), v=2, a=5)]) is SUCCESS


async def test_misuse_is_the_callers_fault(pair):
    with pytest.raises(LocalProtocolError, match="nothing to cancel"):
        await pair.driver.cancel_trajectory()
    with pytest.raises(LocalProtocolError, match="no stream"):
        await pair.driver.stream([])
    with pytest.raises(LocalProtocolError, match="no stream"):
        await pair.driver.end_stream()
    with pytest.raises(LocalProtocolError, match="above 0"):
        points.movej(HOME, v=0)
    with pytest.raises(LocalProtocolError, match="shares"):
        points.optimovej(HOME, v=2)
    assert pair.driver.program_running
