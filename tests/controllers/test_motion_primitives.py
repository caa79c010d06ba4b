"""Motion primitives, from the controller to what the driver is given to execute."""

import asyncio
from math import inf, nan, pi

import pytest
from test_ur_hardware import PRIMITIVES, Arm

from client.controllers.goals import ErrorCode, GoalStatus, MotionPrimitive, PrimitiveType
from client.errors import ControllerError, GoalRejectedError, ProgramEndedError
from tests.rows import each_row
from urproto.external_control import MotionType, TrajectoryResult
from urproto.modes import RuntimeState

Q = (0.5, -1.2, 0.4, -1.57, 0.0, 0.1)
POSE = (0.4, -0.2, 0.3, 0.0, pi, 0.0)
VIA = (0.4, -0.3, 0.4, 0.0, pi - 0.5, 0.0)
JOINT = MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q, move_time_s=2.0)
LINE = MotionPrimitive(
    PrimitiveType.LINEAR_CARTESIAN, pose_base_tcp=POSE, blend_radius_m=0.05, velocity=0.2, acceleration=0.7
)
ARC = MotionPrimitive(PrimitiveType.CIRCULAR_CARTESIAN, (), POSE, VIA, velocity=0.1, acceleration=0.5)


def started():
    arm = Arm()
    arm.manager.activate(PRIMITIVES)
    arm.cycle()
    return arm, arm.manager.controller(PRIMITIVES)


async def test_one_primitive_is_executed_as_it_is():
    arm, controller = started()
    handle = controller.send_goal([JOINT])
    await arm.settle(4)
    (((point,),),) = arm.driver.named("execute")
    assert (point.type, point.target, point.duration_s) == (MotionType.MOVEJ, Q, 2.0)
    assert (handle.status, handle.result.error_code) == (GoalStatus.SUCCEEDED, ErrorCode.SUCCESSFUL)
    again = controller.send_goal([LINE])  # the status is still that of the first
    assert again.status is GoalStatus.EXECUTING
    await arm.settle(4)
    assert again.status is GoalStatus.SUCCEEDED
    assert arm.driver.named("execute")[-1][0][0].type is MotionType.MOVEL


async def test_a_sequence_is_executed_as_a_whole():
    arm, controller = started()
    handle = controller.send_goal([JOINT, LINE, ARC])
    await arm.settle(10)
    ((points,),) = arm.driver.named("execute")
    assert [point.type for point in points] == [MotionType.MOVEJ, MotionType.MOVEL, MotionType.MOVEC]
    line, arc = points[1:]
    assert line.target == pytest.approx(POSE)
    assert (line.blend_radius_m, line.duration_s, *line.parameters[:2]) == (0.05, 0.0, 0.2, 0.7)
    assert arc.target == pytest.approx(POSE)
    assert arc.via == pytest.approx(VIA)
    assert arc.parameters[:3] == (0.1, 0.5, 0.0)
    assert handle.status is GoalStatus.SUCCEEDED


@pytest.mark.parametrize("ends", [TrajectoryResult.CANCELED, ProgramEndedError(50003, "a trajectory")])
async def test_what_the_robot_does_not_execute_aborts_and_the_next_goal_is_taken(ends):
    arm, controller = started()
    arm.driver.ends = ends
    handle = controller.send_goal([JOINT, LINE])
    await arm.settle(8)
    assert handle.status is GoalStatus.ABORTED
    arm.driver.ends = TrajectoryResult.SUCCESS
    again = controller.send_goal([JOINT])
    await arm.settle(4)
    assert again.status is GoalStatus.SUCCEEDED


async def going_on(arm, controller, primitives):
    """A goal that the robot is at, and does not end by itself."""
    execute, begun = arm.driver.execute, asyncio.Event()

    async def endless(points):
        begun.set()
        await asyncio.Event().wait()

    arm.driver.execute = endless
    handle = controller.send_goal(primitives)
    arm.cycle(len(primitives) + 3)
    await begun.wait()
    arm.driver.execute = execute
    return handle


async def test_a_goal_is_canceled_and_the_next_one_taken():
    arm, controller = started()
    handle = await going_on(arm, controller, [JOINT, ARC])
    with pytest.raises(GoalRejectedError, match="are under way"):
        controller.send_goal([JOINT])
    controller.cancel()
    arm.cycle()
    assert handle.status is GoalStatus.EXECUTING
    await arm.settle(3)
    assert handle.status is GoalStatus.CANCELED
    again = controller.send_goal([JOINT])
    await arm.settle(5)
    assert again.status is GoalStatus.SUCCEEDED


async def test_a_goal_ends_with_its_controller():
    arm, controller = started()
    handle = await going_on(arm, controller, [JOINT])
    arm.manager.deactivate(PRIMITIVES)
    await arm.settle()
    assert handle.status is GoalStatus.ABORTED
    assert arm.tasks[-1].cancelled()
    arm.manager.activate(PRIMITIVES)
    again = controller.send_goal([JOINT])
    await arm.settle(4)
    assert again.status is GoalStatus.SUCCEEDED


async def test_a_contact_ends_the_goal_and_stops_the_rest():
    arm, controller = started()
    handle = await going_on(arm, controller, [JOINT])
    controller.on_halt("the tool touched something")
    assert (handle.status, handle.result.error_string) == (GoalStatus.ABORTED, "the tool touched something")
    with pytest.raises(GoalRejectedError, match="is being stopped"):
        controller.send_goal([JOINT])
    await arm.settle(4)
    assert arm.tasks[-1].cancelled()
    controller.send_goal([JOINT])


async def test_a_robot_that_is_paused_begins_when_it_goes_on():
    arm, controller = started()
    arm.cycle(runtime_state=RuntimeState.PAUSED)
    handle = controller.send_goal([JOINT, LINE])
    await arm.settle(10)
    assert arm.driver.named("execute") == []
    arm.cycle(runtime_state=RuntimeState.PLAYING)
    await arm.settle(3)
    assert handle.status is GoalStatus.SUCCEEDED


@each_row(
    ("primitives", "words"),
    [
        ([], "no motion primitives"),
        (
            [JOINT, MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q[:5], move_time_s=1.0)],
            "primitive 1: .* joint",
        ),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, (nan, *Q[1:]), move_time_s=1.0)], "joint_positions of 6"),
        ([MotionPrimitive(PrimitiveType.LINEAR_CARTESIAN, Q, move_time_s=1.0)], "a pose"),
        ([MotionPrimitive(PrimitiveType.CIRCULAR_CARTESIAN, (), POSE, velocity=1.0, acceleration=1.0)], "via pose"),
        ([MotionPrimitive(PrimitiveType.CIRCULAR_CARTESIAN, (), POSE, VIA, move_time_s=1.0)], "it needs velocity and"),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q)], "it needs move_time, or velocity and acceleration"),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q, velocity=1.0)], "it needs move_time"),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q, move_time_s=0.0)], "it needs move_time"),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q, move_time_s=inf)], "it needs move_time"),
        ([MotionPrimitive(PrimitiveType.LINEAR_JOINT, Q, blend_radius_m=-0.1, move_time_s=1.0)], "blend_radius"),
    ],
)
def test_what_makes_no_sense_is_rejected(primitives, words):
    _, controller = started()
    with pytest.raises(GoalRejectedError, match=words) as error:
        controller.send_goal(primitives)
    assert error.value.code is ErrorCode.INVALID_GOAL
    assert controller.goal is None


def test_an_inactive_controller_takes_nothing():
    arm = Arm()
    arm.manager.load(PRIMITIVES)
    arm.manager.configure(PRIMITIVES)
    with pytest.raises(ControllerError, match="activate it first"):
        arm.manager.controller(PRIMITIVES).send_goal([JOINT])
