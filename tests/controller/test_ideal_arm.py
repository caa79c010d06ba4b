"""The ideal arm: torques, forces and speeds exactly as physics requires."""

import math

import pytest

from emulator.lifecycle.power import PowerState
from emulator.robot.installation import Payload
from urproto.robots.pose import pose_trans, rotvec_to_matrix

ZERO6 = (0.0,) * 6
BENT = (0.3, -1.1, 1.2, -0.8, 0.7, 0.4)


@pytest.fixture
def bent(make):
    return make(running=True, initial_q=BENT)


def rotate(pose, v):
    m = rotvec_to_matrix(*pose[3:])
    return tuple(sum(m[3 * row + i] * v[i] for i in range(3)) for row in range(3))


def test_actual_equals_target_exactly(ready):
    ready.script("movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=2, v=1)")
    for _ in range(100):
        snapshot = ready.tick()
        assert snapshot.actual_q == snapshot.target_q
        assert snapshot.actual_qd == snapshot.target_qd
        assert snapshot.actual_TCP_pose == snapshot.target_TCP_pose


def test_speed_and_acceleration_are_the_rates_of_position_and_speed(ready):
    ready.script("movej([0.6, -1.2, 0.3, -1.3, 0.2, 0.1], a=1, v=0.6)")
    ready.seconds(0.3)
    before = ready.now
    after = ready.tick()
    period = ready.controller.period_s
    assert math.hypot(*after.actual_TCP_speed[:3]) > 0.01
    for i in range(3):
        rate = (after.actual_TCP_pose[i] - before.actual_TCP_pose[i]) / period
        assert after.actual_TCP_speed[i] == pytest.approx(rate, abs=2e-3)
        gain = (after.actual_TCP_speed[i] - before.actual_TCP_speed[i]) / period
        assert after.actual_TCP_acceleration[i] == pytest.approx(gain)
        elbow = (after.elbow_position[i] - before.elbow_position[i]) / period
        assert after.elbow_velocity[i] == pytest.approx(elbow)
    assert after.actual_momentum > 0.0


def test_gravity_torque_of_a_payload(bent):
    """A mass at the flange adds J^T m g; the rest of the arm cancels in the difference."""
    bent.tick()
    bare = bent.now.target_moment
    bent.controller.installation.set_payload(Payload(2.0))
    bent.tick()
    jacobian = bent.controller.arm.kinematics.jacobian(BENT)
    for joint in range(6):
        expected = 2.0 * 9.82 * jacobian[2][joint]
        assert bent.now.target_moment[joint] - bare[joint] == pytest.approx(expected, abs=1e-9)
    assert bent.now.payload == 2.0


def test_an_external_force_is_measured_exactly_and_held_by_the_joints(bent):
    bent.tick()
    free = bent.now.actual_current
    bent.controller.external_wrench = (0.0, 5.0, -20.0, 0.1, 0.0, 0.0)
    bent.tick()
    assert bent.now.actual_TCP_force == (0.0, 5.0, -20.0, 0.1, 0.0, 0.0)
    assert bent.now.tcp_force_scalar == pytest.approx(math.hypot(5, 20))
    assert bent.now.target_q == BENT
    jacobian = bent.controller.arm.kinematics.jacobian(BENT)
    constants = bent.controller.model.torque_constants
    for joint in range(6):
        push = 5.0 * jacobian[1][joint] - 20.0 * jacobian[2][joint] + 0.1 * jacobian[3][joint]
        change = (bent.now.actual_current[joint] - free[joint]) * constants[joint]
        assert change == pytest.approx(-push, abs=1e-9)
    bent.controller.external_wrench = ZERO6
    assert bent.tick().actual_TCP_force == ZERO6


def test_zeroing_subtracts_the_present_wrench(bent):
    bent.controller.external_wrench = (0.0, 0.0, -20.0, 0.0, 0.0, 0.0)
    bent.tick()
    bent.controller.arm.zero_force()
    assert bent.tick().actual_TCP_force == ZERO6
    bent.controller.external_wrench = ZERO6
    assert bent.tick().actual_TCP_force == (0.0, 0.0, 20.0, 0.0, 0.0, 0.0)


def test_the_raw_sensor_measures_payload_and_contact_in_the_flange_frame(bent):
    bent.controller.installation.set_payload(Payload(1.0, (0.0, 0.0, 0.1)))
    bent.controller.set_tcp((0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    bent.controller.external_wrench = (0.0, 0.0, -10.0, 0.0, 0.0, 0.0)
    bent.tick()
    flange = bent.controller.arm.kinematics.forward(BENT)
    raw = bent.now.ft_raw_wrench
    assert rotate(flange, raw[:3]) == pytest.approx((0.0, 0.0, -10.0 - 9.82), abs=1e-9)
    weight = 9.82 * 0.1 + 10.0 * 0.2  # both act along the flange's z axis, this far out
    tilt = math.hypot(*rotate(flange, (0.0, 0.0, 1.0))[:2])
    assert math.hypot(*raw[3:]) == pytest.approx(weight * tilt)


def test_accelerometer_at_rest_shows_gravity_in_tool_axes(bent):
    bent.tick()
    assert math.hypot(*bent.now.actual_tool_accelerometer) == pytest.approx(9.82)
    flange = bent.controller.arm.kinematics.forward(BENT)
    assert rotate(flange, bent.now.actual_tool_accelerometer) == pytest.approx((0.0, 0.0, 9.82), abs=1e-9)


def test_tcp_offset_moves_the_pose(bent):
    offset = (0.01, -0.02, 0.2, 0.1, 0.2, -0.3)
    flange = bent.now.actual_TCP_pose
    bent.controller.set_tcp(offset)
    bent.tick()
    assert bent.now.actual_TCP_pose == pytest.approx(pose_trans(flange, offset), abs=1e-9)
    assert bent.now.tcp_offset == offset


def test_the_force_input_is_in_flange_axes_at_its_offset(bent):
    bent.controller.set_tcp((0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    bent.controller.ft_input.enabled = True
    bent.rtde(external_force_torque=(3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    flange = bent.controller.arm.kinematics.forward(BENT)
    bent.tick()
    force = bent.now.actual_TCP_force
    assert force[:3] == pytest.approx(rotate(flange, (3.0, 0.0, 0.0)))
    # acting at the flange, 0.2 m behind the TCP along the tool: (0, 0, -0.2) x (3, 0, 0)
    assert force[3:] == pytest.approx(rotate(flange, (0.0, -0.6, 0.0)), abs=1e-9)


def test_no_current_flows_while_the_brakes_hold(rig):
    assert rig.tick().actual_current == ZERO6
    assert rig.now.target_moment == ZERO6
    assert rig.now.actual_robot_current == 0.0


def test_an_arm_at_rest_is_not_recomputed_until_something_changes(bent):
    bent.tick(3)
    controller, arm = bent.controller, bent.controller.arm

    def changed(qd=ZERO6):
        return arm.update((BENT, qd, ZERO6), controller.installation, ZERO6, controller.period_s, driven=True)

    assert not changed()
    controller.installation.set_payload(Payload(2.0))
    assert [changed(), changed()] == [True, False]
    controller.installation.gravity = (0.0, 0.0, -9.82)
    assert [changed(), changed()] == [True, False]
    turning = (0.1, *ZERO6[1:])
    assert changed(turning)
    assert math.hypot(*arm.state.tool.acceleration[:3]) > 1.0
    assert changed(turning), "the speed stays, so the acceleration ends"
    assert arm.state.tool.acceleration == ZERO6
    assert not changed(turning)


def test_an_arm_without_power_does_not_continue_a_soft_stop(bent):
    bent.script("def go():\n  speedj([0.5, 0, 0, 0, 0, 0], 5.0, 0.3)\n  stopj(0.5)\nend\n")
    bent.seconds(0.6)
    assert bent.now.actual_qd[0] > 0.1, "it is braking softly"
    bent.controller.power.put(PowerState.OFF)
    here = bent.now.actual_q
    assert bent.tick(2).actual_q == pytest.approx(here, abs=0.5 * bent.controller.period_s)
    assert bent.now.actual_qd == ZERO6
    assert bent.controller.motion.idle
