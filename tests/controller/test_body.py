"""The body of a dynamic arm: physics without the servo loop."""

import random

import numpy as np
import pytest

from emulator.robot.body import STEP_S, Body
from tests.rows import each_row
from urproto.robots import MODELS, Kinematics, load_model
from urproto.robots.measured import drivetrain_of

ZERO6 = (0.0,) * 6
LOW = (0.3, 0.6, 0.4, -0.5, 0.7, 0.0)


def energy(body):
    return sum(body.dynamics.energy(body.q, body.qd))


@each_row("name", MODELS)
def test_a_falling_arm_without_friction_keeps_its_energy(name):
    body = Body(load_model(name), smooth=True)
    body.place(LOW)
    start, kinetic = energy(body), 0.0
    for _ in range(4000):
        body.step(ZERO6, ZERO6, STEP_S / 4)
        kinetic = max(kinetic, body.dynamics.energy(body.q, body.qd)[0])
    assert kinetic > 2.0, "it swings"
    assert energy(body) == pytest.approx(start, abs=0.01 * kinetic)


def test_the_error_of_the_energy_shrinks_with_the_step():
    """First order: half the step, half the drift."""
    drifts = []
    for parts in (1, 2, 4):
        body = Body(load_model("ur5e"), smooth=True)
        body.place(LOW)
        start = energy(body)
        for _ in range(500 * parts):
            body.step(ZERO6, ZERO6, STEP_S / parts)
        drifts.append(abs(energy(body) - start))
    assert drifts[0] > 1.6 * drifts[1] > 2.5 * drifts[2]


def test_friction_dissipates_exactly_the_lost_energy():
    body = Body(load_model("ur5e"))
    body.place(LOW)
    start, heat = energy(body), 0.0
    for _ in range(8000):
        before = body.friction_power
        body.step(ZERO6, ZERO6, STEP_S / 8)
        heat += 0.5 * (sum(before) + sum(body.friction_power)) * STEP_S / 8
    assert heat > 5.0
    assert start - energy(body) == pytest.approx(heat, rel=0.02)


def test_work_of_a_push_becomes_kinetic_energy():
    """A wrench at the flange acts by the transposed Jacobian: power is force times the flange's velocity."""
    model = load_model("ur10e")
    body, kinematics = Body(model, smooth=True), Kinematics(model.dh)
    body.dynamics.set_gravity(ZERO6[:3])
    body.place(LOW)
    force, work = np.array((20.0, -10.0, 5.0, 0.0, 0.0, 0.0)), 0.0
    for _ in range(2000):
        jacobian = np.array(kinematics.jacobian(body.q))
        before = jacobian @ body.qd
        body.step(ZERO6, tuple(jacobian.T @ force), STEP_S / 4)
        work += float(force @ (before + np.array(kinematics.jacobian(body.q)) @ body.qd)) / 2 * STEP_S / 4
    assert work > 1.0
    assert body.dynamics.energy(body.q, body.qd)[0] == pytest.approx(work, rel=0.01)


def test_angular_momentum_about_the_first_axis_is_conserved_without_gravity():
    body = Body(load_model("ur5e"), smooth=True)
    body.dynamics.set_gravity((0.0, 0.0, 9.82))  # parallel to the axis: no torque about it
    body.place(LOW)
    body.qd = (0.5, -0.4, 0.8, 0.3, -0.6, 1.0)
    momentum = np.array(body.dynamics.mass_matrix(body.q)[0]) @ body.qd
    for _ in range(4000):
        body.step(ZERO6, ZERO6, STEP_S / 4)
    assert np.array(body.dynamics.mass_matrix(body.q)[0]) @ body.qd == pytest.approx(momentum, rel=0.01)


def test_gravity_torque_holds_the_arm_still():
    body = Body(load_model("ur3e"))
    body.dynamics.set_payload(2.0, (0.0, 0.02, 0.06))
    body.place(LOW)
    torque = body.dynamics.gravity_torques(LOW)
    for _ in range(1000):
        body.step(torque, ZERO6, STEP_S)
    assert body.q == pytest.approx(LOW, abs=1e-9)


@each_row("name", MODELS)
def test_friction_brings_every_joint_to_a_crawl(name):
    chance = random.Random(name)
    body = Body(load_model(name))
    body.dynamics.set_gravity(ZERO6[:3])
    body.qd = tuple(chance.uniform(-1.0, 1.0) * most for most in load_model(name).qd_max)
    for _ in range(5000):
        body.step(ZERO6, ZERO6, STEP_S)
    assert body.qd == pytest.approx(ZERO6, abs=1e-4)


@each_row("name", MODELS)
def test_brakes_stop_and_lock_the_arm(name):
    model = load_model(name)
    body = Body(model)
    body.place(LOW)
    body.qd = tuple(0.5 * speed for speed in model.qd_max)
    assert not body.standing
    for _ in range(1000):
        body.brake(ZERO6, STEP_S)
    assert body.standing
    locked = body.q
    for _ in range(100):
        body.brake((500.0,) * 6, STEP_S)
    assert body.q == locked


@each_row("name", MODELS)
def test_every_joint_reaches_its_speed_despite_friction(name):
    model = load_model(name)
    drives = drivetrain_of(model)
    for joint, speed in enumerate(model.qd_max):
        friction = drives.coulomb_Nm[joint] + drives.viscous_Nm_s[joint] * speed
        assert friction < 0.5 * model.torque_max[joint]


def test_friction_opposes_motion_and_is_zero_at_rest():
    body, drives = Body(load_model("ur10e")), drivetrain_of(load_model("ur10e"))
    viscous, coulomb = body.friction_parts((1.0, -1.0, 0.0, 2.0, -2.0, 0.0))
    signs, speeds = (1.0, -1.0, 0.0, 1.0, -1.0, 0.0), (1.0, -1.0, 0.0, 2.0, -2.0, 0.0)
    assert viscous == pytest.approx([slope * v for slope, v in zip(drives.viscous_Nm_s, speeds, strict=True)])
    assert coulomb == pytest.approx([dry * sign for dry, sign in zip(drives.coulomb_Nm, signs, strict=True)])
