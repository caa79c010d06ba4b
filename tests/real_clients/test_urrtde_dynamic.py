"""ur_rtde moves an arm with dynamics: targets are reached within the errors of its servo loops."""

import math

import numpy as np
import pytest
from rig import START_Q, Rig
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.budget import subset
from urproto.robots import load_model
from urproto.robots.measured import drivetrain_of

dynamic = pytest.mark.parametrize("rig", subset(["ur3 dynamic", "ur5e dynamic"], now=["ur3 dynamic"]), indirect=True)

SETTLING_S = 0.5
JOINT_RAD = 1e-3
TOOL_M = 5e-4


def settle(rig: Rig) -> None:
    with rig.watch() as state:
        state.wait_until_still()
        state.wait_for(SETTLING_S)


@dynamic
def test_move_j_arrives(rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface) -> None:
    goal = [q + change for q, change in zip(START_Q, (0.6, 0.2, -0.4, 0.3, 0.5, -0.8), strict=True)]
    with rig.watch("actual_qd") as state:
        assert control.moveJ(goal, 1.5, 2.0)
        state.settled()
        errors = np.abs([np.subtract(s["actual_qd"], s["target_qd"]) for s in state.samples])
    assert 1e-4 < errors.max() < 0.2, "it follows, but not exactly"
    settle(rig)
    assert receive.getActualQ() == pytest.approx(goal, abs=JOINT_RAD)
    assert receive.getTargetQ() == pytest.approx(goal, abs=1e-9)


@pytest.mark.long
@dynamic
def test_move_l_stays_near_its_line(rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface) -> None:
    start = receive.getActualTCPPose()
    goal = [start[0], start[1] + 0.08, start[2] + 0.05, *start[3:]]
    with rig.watch() as state:
        assert control.moveL(goal, 0.3, 1.0)
        track = state.track
    along = np.array([0.0, 0.08, 0.05]) / math.hypot(0.08, 0.05)
    offsets = track.pose[:, :3] - np.array(start[:3])
    beside = offsets - np.outer(offsets @ along, along)
    assert np.linalg.norm(beside, axis=1).max() < 2e-3
    settle(rig)
    assert receive.getActualTCPPose()[:3] == pytest.approx(goal[:3], abs=TOOL_M)


@pytest.mark.long
@dynamic
def test_servo_j_is_followed(rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface) -> None:
    q = list(START_Q)
    for step in range(round(1.0 / rig.period_s)):
        began = control.initPeriod()
        q[0] = START_Q[0] + 0.2 * (1.0 - math.cos(math.pi * step * rig.period_s))
        assert control.servoJ(q, 0.0, 0.0, rig.period_s, 0.05, 500)
        control.waitPeriod(began)
    assert control.servoStop()
    settle(rig)
    assert receive.getActualQ()[0] == pytest.approx(receive.getTargetQ()[0], abs=JOINT_RAD)
    assert receive.getActualQ()[0] == pytest.approx(START_Q[0] + 0.4, abs=0.02)


@dynamic
def test_currents_are_noisy_around_the_values_for_gravity_and_static_friction(
    rig: Rig, receive: RTDEReceiveInterface
) -> None:
    drives = drivetrain_of(load_model(rig.model.split()[0]))
    held = np.divide(drives.coulomb_Nm, drives.torque_constants_Nm_A)  # A: more than this static friction does not hold
    settle(rig)
    with rig.watch("actual_current", "target_current") as state:
        state.wait_for(0.5)
        measured = np.array([sample["actual_current"] for sample in state.samples])
        wanted = np.array(state.samples[-1]["target_current"])
    assert np.abs(wanted[1:3]).min() > 0.1
    assert measured.std(axis=0).min() > 0.003
    np.testing.assert_array_less(np.abs(measured.mean(axis=0) - wanted), held)


@pytest.mark.parametrize("rig", ["ur5e dynamic"], indirect=True)
def test_direct_torque_turns_the_base_and_friction_stops_it(
    rig: Rig, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    for torque in [15.0] * 100 + [0.0] * 250:
        began = control.initPeriod()
        assert control.directTorque([torque, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6, [0.0] * 6)
        control.waitPeriod(began)
    turned = receive.getActualQ()[0] - START_Q[0]
    assert 0.003 < turned < 1.0  # 0.041 if none of the torques is late
    assert abs(receive.getActualQd()[0]) < 0.1
    control.stopScript()
    settle(rig)
    assert receive.getActualQ() == pytest.approx(receive.getTargetQ(), abs=JOINT_RAD)
