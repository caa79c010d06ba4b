"""Freedrive by inputs and in frames, and the arm's distance to singularities."""

import numpy as np
import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.motion.reach import distance_to_singularity
from tests.rows import each_row
from urproto.modes import ControlMode, RuntimeState
from urproto.robots import MODELS, load_model
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import rotvec_to_matrix
from urproto.signals import CONFIGURABLE, STANDARD, TOOL

PUSH = (0.0, 30.0, 0.0, 0.0, 0.0, 0.0)

INPUTS = {
    "set_standard_digital_input_action(3": lambda c, level: c.signals.set_digital_input(STANDARD, 3, level),
    "set_configurable_digital_input_action(7": lambda c, level: c.signals.set_digital_input(CONFIGURABLE, 7, level),
    "set_tool_digital_input_action(1": lambda c, level: c.signals.set_digital_input(TOOL, 1, level),
    "set_gp_boolean_input_action(70": lambda c, level: c.registers.input.set_bit(70, level),
}


def free(rig):
    return rig.controller.snapshot.control_mode is ControlMode.TEACH


@pytest.mark.parametrize("action", INPUTS)
def test_a_high_input_enables_freedrive(rig, action):
    rig.run(f'{action}, "freedrive")')
    rig.controller.external_wrench = PUSH
    rig.seconds(0.2)
    assert not any(rig.controller.snapshot.actual_qd)
    INPUTS[action](rig.controller, True)
    rig.seconds(0.5)
    assert free(rig)
    assert rig.controller.snapshot.actual_TCP_speed[1] > 0.05
    INPUTS[action](rig.controller, False)
    rig.seconds(1.0)
    assert not free(rig)
    assert not any(rig.controller.snapshot.actual_qd)


@pytest.mark.parametrize(
    "undo", ["set_input_actions_to_default()", 'set_standard_digital_input_action(3, "default")', None]
)
def test_inputs_have_no_action_by_default_or_after_reset(rig, undo):
    if undo:
        rig.run(f'set_standard_digital_input_action(3, "freedrive")\n{undo}')
    rig.controller.signals.set_digital_input(STANDARD, 3, True)
    rig.seconds(0.1)
    assert not free(rig)


def test_a_program_interrupts_freedrive_until_it_ends(rig):
    rig.run('set_standard_digital_input_action(3, "freedrive")')
    rig.controller.signals.set_digital_input(STANDARD, 3, True)
    rig.seconds(0.1)
    assert free(rig)
    rig.start("movej([0.3, -1.5, 1.5, -1.6, -1.57, 0])\nsleep(0.1)")
    rig.until(lambda: rig.state is RuntimeState.PLAYING)
    assert not free(rig)
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.q == pytest.approx((0.3, -1.5, 1.5, -1.6, -1.57, 0), abs=1e-9)
    rig.tick(2)
    assert free(rig)


def test_no_freedrive_in_a_protective_stop(rig):
    rig.run('set_standard_digital_input_action(3, "freedrive")')
    rig.controller.signals.set_digital_input(STANDARD, 3, True)
    rig.controller.external_wrench = PUSH
    rig.seconds(0.3)
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.seconds(1.0)
    assert not free(rig)
    assert not any(rig.controller.snapshot.actual_qd)
    rig.controller.safety_event(SafetyEvent.UNLOCK)
    rig.tick(2)
    assert free(rig)


@pytest.mark.parametrize(
    ("feature", "along"), [('"tool"', None), ('"base"', (1, 0, 0)), ("p[0,0,0,0,0,1.5708]", (0, 1, 0))]
)
def test_constrained_freedrive_in_a_frame(rig, feature, along):
    pose = rig.value("get_actual_tcp_pose()")
    if along is None:
        m = rotvec_to_matrix(*pose[3:])
        along = (m[0], m[3], m[6])
    rig.controller.external_wrench = (20.0, 15.0, 10.0, 0.0, 0.0, 0.0)
    rig.start(f"freedrive_mode([1,0,0,0,0,0], {feature})\nsleep(1)")
    rig.seconds(0.5)
    speed = np.array(rig.controller.snapshot.actual_TCP_speed)
    assert abs(speed[:3] @ along) > 0.01
    assert np.linalg.norm(np.cross(speed[:3], along)) < 1e-4
    assert np.abs(speed[3:]).max() < 1e-4


@pytest.mark.parametrize("call", ["freedrive_mode()", "freedrive_mode_no_incorrect_payload_check()"])
def test_freedrive_in_a_program_follows_the_hand_until_it_ends(rig, call):
    rig.start(f"{call}\nsleep(1)\nend_freedrive_mode()\nsleep(1)")
    rig.controller.external_wrench = PUSH
    rig.seconds(0.8)
    assert free(rig)
    assert rig.controller.snapshot.actual_TCP_speed[1] > 0.05
    rig.seconds(1.0)
    assert not free(rig)


def test_an_unknown_feature_is_refused(rig):
    assert "feature" in rig.fault('freedrive_mode([1,1,1,1,1,1], "table")')


@each_row("name", MODELS)
def test_singularity_distances_are_the_factors_of_the_determinant(name):
    model = load_model(name)
    rng = np.random.default_rng(3)
    a2, a3, d5 = model.dh.a[1], model.dh.a[2], model.dh.d[4]
    for q in rng.uniform(-3, 3, (20, 6)):
        determinant = np.linalg.det(np.array(Kinematics(model.dh).jacobian(tuple(q))))
        outward = a2 * np.cos(q[1]) + a3 * np.cos(q[1] + q[2]) + d5 * np.sin(q[1] + q[2] + q[3])
        assert abs(determinant) == pytest.approx(abs(a2 * a3 * np.sin(q[2]) * np.sin(q[4]) * outward), rel=1e-6)
        factors = (abs(np.sin(q[2])), abs(np.sin(q[4])), abs(outward) / (abs(a2) + abs(a3)))
        assert distance_to_singularity(model.dh, tuple(q)) == pytest.approx(min(factors), rel=1e-9)


@each_row(
    ("q", "status"),
    [
        ([0, -1.5, 1.5, -1.6, -1.57, 0], 0),
        ([0, -1.2, 0.15, -1.6, -1.57, 0], 1),
        ([0, -1.2, 0.01, -1.6, -1.57, 0], 2),
        ([0, -1.5, 1.5, -1.6, 0.1, 0], 1),
        ([0, -1.5, 1.5, -1.6, -0.02, 0], 2),
    ],
)
def test_freedrive_status(rig, q, status):
    rig.run(f"set_pos({q})")
    assert rig.value("get_freedrive_status()") == status
