"""ur_rtde's queries and settings of the controller: kinematics, limits, tool, payload."""

import numpy as np
import pytest
import ur_analytic_ik
from pose_matrices import Array, rotation_matrix, transform
from rig import START_Q, Rig
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.budget import subset

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)

OTHER_Q = [-0.7, -1.1, 1.2, -0.6, 1.3, 0.4]
TOOL = [0.01, -0.02, 0.12, 0.1, 0.2, -0.3]
OUT_OF_REACH = [2.0, 0.0, 0.3, 0.0, 3.14, 0.0]


def solver(rig: Rig) -> object:
    """An independent closed-form solver of the same arm, from PyPI."""
    return getattr(ur_analytic_ik, rig.model)


def forward(rig: Rig, q: list[float]) -> Array:
    return np.asarray(solver(rig).forward_kinematics(*q))


@both_series
def test_forward_kinematics_of_the_current_position(rig: Rig, control: RTDEControlInterface) -> None:
    np.testing.assert_allclose(transform(control.getForwardKinematics()), forward(rig, START_Q), atol=1e-5)


@both_series
def test_forward_kinematics_of_other_joints_and_tool(rig: Rig, control: RTDEControlInterface) -> None:
    expected = forward(rig, OTHER_Q) @ transform(TOOL)
    np.testing.assert_allclose(transform(control.getForwardKinematics(OTHER_Q, TOOL)), expected, atol=1e-5)


@both_series
def test_inverse_kinematics_stays_near_the_arm(rig: Rig, control: RTDEControlInterface) -> None:
    pose = control.getForwardKinematics()
    pose[2] += 0.05
    q = control.getInverseKinematics(pose)
    np.testing.assert_allclose(forward(rig, q), transform(pose), atol=1e-5)
    assert np.abs(np.array(q) - START_Q).max() < 0.5


def test_inverse_kinematics_takes_the_solution_near_the_given_joints(rig: Rig, control: RTDEControlInterface) -> None:
    pose = control.getForwardKinematics(OTHER_Q, [1e-12, 0, 0, 0, 0, 0])
    solutions = np.reshape(solver(rig).inverse_kinematics(forward(rig, OTHER_Q)), (-1, 6))
    assert len(solutions) == 8
    for solution in solutions:
        assert control.getInverseKinematics(pose, list(solution + 0.05)) == pytest.approx(solution, abs=1e-4)


@both_series
def test_inverse_kinematics_has_solution(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.getInverseKinematicsHasSolution(control.getForwardKinematics())
    assert not control.getInverseKinematicsHasSolution(OUT_OF_REACH)


def test_pose_trans(rig: Rig, control: RTDEControlInterface) -> None:
    a, b = [0.3, -0.2, 0.4, 0.5, -1.0, 0.2], TOOL
    np.testing.assert_allclose(transform(control.poseTrans(a, b)), transform(a) @ transform(b), atol=1e-9)


@both_series
def test_set_tcp_moves_the_pose_and_is_read_back(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    flange = control.getForwardKinematics()
    assert control.setTcp(TOOL)
    assert control.getTCPOffset() == pytest.approx(TOOL, abs=1e-9)
    expected = transform(flange) @ transform(TOOL)
    rig.eventually(lambda: np.allclose(transform(receive.getActualTCPPose()), expected, atol=1e-6))


def test_the_flange_pose_excludes_the_tool(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.setTcp(TOOL)
    control.getActualToolFlangePose()  # the first answer of these calls is stale by design
    with rig.watch() as state:
        state.wait_for(0.1)
    np.testing.assert_allclose(transform(control.getActualToolFlangePose()), forward(rig, START_Q), atol=1e-5)


def test_moves_take_the_tool_into_account(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.setTcp([0, 0, 0.1, 0, 0, 0])
    target = control.getForwardKinematics()
    target[2] += 0.05
    with rig.watch() as state:
        assert control.moveL(target, 0.25, 1.2)
        sample = state.settled()
    np.testing.assert_allclose(transform(sample["actual_TCP_pose"]), transform(target), atol=1e-5)
    tip = forward(rig, sample["actual_q"]) @ transform([0, 0, 0.1, 0, 0, 0])
    np.testing.assert_allclose(tip, transform(target), atol=1e-5)


@both_series
def test_set_payload_is_read_back(rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface) -> None:
    moments = receive.getTargetMoment()
    assert control.setPayload(1.2, [0.01, 0.02, 0.05])
    rig.eventually(lambda: receive.getPayload() == pytest.approx(1.2))
    assert receive.getPayloadCog() == pytest.approx([0.01, 0.02, 0.05])
    assert abs(receive.getTargetMoment()[1]) > abs(moments[1]) + 0.5  # the shoulder carries it


@pytest.mark.parametrize("rig", ["ur3e"], indirect=True)
def test_set_target_payload_with_inertia(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    inertia = [0.001, 0.002, 0.003, 0.0, 0.0, 0.0]
    assert control.setTargetPayload(0.8, [0.0, 0.0, 0.04], inertia)
    rig.eventually(lambda: receive.getPayload() == pytest.approx(0.8))
    assert receive.getPayloadInertia() == pytest.approx(inertia)


@both_series
def test_is_steady(rig: Rig, control: RTDEControlInterface) -> None:
    rig.eventually(control.isSteady)
    with rig.watch() as state:
        assert control.moveJ([START_Q[0] + 1.5, *START_Q[1:]], 0.2, 4.0, True)  # long enough for a query meanwhile
        state.wait_until_moving()
        assert not control.isSteady()
        control.stopJ(10.0)
        state.wait_until_still()
        state.wait_for(1.0)
    assert control.isSteady()


@both_series
def test_poses_and_joints_within_safety_limits(rig: Rig, control: RTDEControlInterface) -> None:
    assert control.isPoseWithinSafetyLimits(control.getForwardKinematics())
    assert not control.isPoseWithinSafetyLimits(OUT_OF_REACH)
    assert control.isJointsWithinSafetyLimits(list(START_Q))
    assert not control.isJointsWithinSafetyLimits([0.0, -7.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("rig", ["ur3e"], indirect=True)
def test_step_time(rig: Rig, control: RTDEControlInterface) -> None:
    """ur_rtde's script queries it on the e-Series only."""
    control.getStepTime()
    with rig.watch() as state:
        state.wait_for(0.1)
    assert control.getStepTime() == pytest.approx(0.002)


@pytest.mark.parametrize("rig", ["ur3e"], indirect=True)
def test_target_waypoint_is_the_target_of_the_current_move(rig: Rig, control: RTDEControlInterface) -> None:
    target = control.getForwardKinematics()
    target[1] += 0.1
    with rig.watch() as state:
        assert control.moveL(target, 0.05, 1.0, True)
        state.wait_until_moving()
        assert control.getTargetWaypoint() == pytest.approx(target, abs=1e-6)
        control.stopL(1.0)


@pytest.mark.parametrize("rig", ["ur3e"], indirect=True)
def test_joint_positions_history(rig: Rig, control: RTDEControlInterface) -> None:
    with rig.watch() as state:
        assert control.speedJ([0.4, 0, 0, 0, 0, 0], 4.0)
        state.wait_until(lambda sample: sample["target_qd"][0] > 0.399)
        state.wait_for(0.3)
        assert control.speedStop()
        now = state.wait_until_still()["actual_q"]
    control.getActualJointPositionsHistory(0)
    with rig.watch() as state:
        state.wait_for(0.05)
    assert control.getActualJointPositionsHistory(0) == pytest.approx(now)


def test_joint_torques_at_rest_are_those_beyond_gravity(rig: Rig, control: RTDEControlInterface) -> None:
    control.getJointTorques()
    with rig.watch() as state:
        state.wait_for(0.1)
    assert control.getJointTorques() == pytest.approx([0.0] * 6, abs=0.01)


def test_gravity_of_a_wall_mounted_arm_changes_its_torques(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    assert receive.getTargetMoment()[0] == pytest.approx(0.0, abs=1e-6)  # upright: the base carries no torque
    assert control.setGravity([9.82, 0.0, 0.0])
    rig.eventually(lambda: abs(receive.getTargetMoment()[0]) > 0.1)


def test_rotation_helper_against_the_solver_convention() -> None:
    """The helper is used as an oracle above: a quarter turn about z takes x to y."""
    np.testing.assert_allclose(rotation_matrix([0, 0, np.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
