"""The dynamic arm: torques move it, and its servo loops follow the targets."""

import itertools
import math
import random
from operator import sub

import numpy as np
import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.robot.body import Body
from emulator.robot.installation import Payload
from emulator.virtual import virtual_robot
from emulator.world.file import WorldPlan
from emulator.world.shapes import Plane, WorldObject
from tests.budget import subset
from tests.commands import MountPayload
from tests.rows import each_row
from urproto.controlapi import BadArguments
from urproto.modes import ControlMode
from urproto.robots import MODELS
from urproto.robots.dynamics import Dynamics
from urproto.robots.measured import drivetrain_of
from urproto.robots.pose import pose_trans

ZERO6 = (0.0,) * 6
BENT = (0.3, -1.1, 1.2, -0.8, 0.7, 0.4)
STEP = 2 * math.pi / 2**19  # of the encoders


@pytest.fixture
def still(make):
    return make("ur5e", running=True, dynamic=True, initial_q=BENT)


def error_rad(rig):
    return max(map(abs, rig.controller.arm.following_error))


def peak_error_rad(rig, seconds):
    worst = 0.0
    for _ in range(round(seconds / rig.controller.period_s)):
        rig.tick()
        worst = max(worst, error_rad(rig))
    return worst


# at rest


@each_row("name", MODELS)
def test_at_rest_motors_and_static_friction_together_hold_gravity(make, name):
    rig = make(name, running=True, dynamic=True, initial_q=BENT)
    model = rig.controller.model
    payload = Payload.of(model.payload_max_kg, (0.0, 0.0, 0.05))
    rig.controller.installation.set_payload(payload)
    rig.seconds(1.0)
    oracle = Dynamics(model)
    oracle.set_payload(payload.mass, payload.cog, payload.inertia)
    gravity = oracle.gravity_torques(BENT)
    assert max(map(abs, gravity)) > 5.0
    arm = rig.controller.arm
    assert arm.drives.torque == pytest.approx(gravity, abs=1e-6)
    assert rig.now.target_moment == pytest.approx(gravity, abs=1e-6)
    friction = drivetrain_of(model).coulomb_Nm
    for joint, constant in enumerate(arm.torque_constants):
        beyond = rig.now.actual_current[joint] - rig.now.target_current[joint]
        assert abs(beyond) < 0.8 * friction[joint] / constant + 0.15  # noise
    assert rig.now.actual_q == pytest.approx(BENT, abs=STEP)
    assert not any(rig.now.actual_qd)


def test_an_arm_at_rest_stays_in_place(still):
    still.seconds(0.1)
    place = still.controller.arm.drives.body.q
    still.seconds(2.0)
    assert still.controller.arm.drives.body.q == place
    assert still.now.target_q == BENT


def test_a_push_deflects_the_arm_at_first_and_is_then_held(still):
    """kkufieta/ur5_modeling_force_estimate, Movement_No10: pushed manually, a real UR5 returns within milliseconds."""
    still.seconds(0.1)
    sags = []
    for newton in (15.0, 30.0):
        still.controller.external_wrench = (0.0, 0.0, -newton, 0.0, 0.0, 0.0)
        sags.append(peak_error_rad(still, 0.1))
        still.seconds(1.0)
        assert error_rad(still) < 5e-5
        jacobian = still.controller.arm.kinematics.jacobian(still.now.actual_q)
        pressed = [-newton * z for z in jacobian[2]]
        arm = still.controller.arm
        held = [a - b for a, b in zip(arm.drives.torque, arm.efforts.target_torque, strict=True)]
        assert held == pytest.approx([-torque for torque in pressed], abs=0.1)
    assert 1e-4 < sags[0] < 2e-3
    still.controller.external_wrench = ZERO6
    still.seconds(3.0)
    assert still.now.actual_q == pytest.approx(BENT, abs=2 * STEP)


def test_an_unannounced_payload_shows_in_force_and_current_and_is_held(still):
    still.seconds(0.5)
    before = still.now
    still.controller.post(MountPayload(Payload.of(3.0, (0.0, 0.0, 0.05))))
    assert 1e-4 < peak_error_rad(still, 0.1) < 5e-3
    still.seconds(3.0)
    assert still.now.actual_q == pytest.approx(BENT, abs=2 * STEP)
    assert still.now.actual_TCP_force[2] == pytest.approx(-3.0 * 9.82, abs=1.0)
    assert abs(still.now.actual_current[1] - before.actual_current[1]) > 0.3
    assert still.now.target_current[1] == pytest.approx(before.target_current[1], abs=1e-3)
    still.controller.installation.set_payload(Payload.of(3.0, (0.0, 0.0, 0.05)))  # now it is announced
    still.seconds(3.0)
    assert still.now.actual_q == pytest.approx(BENT, abs=2 * STEP)
    assert still.now.actual_TCP_force == pytest.approx(ZERO6, abs=1.0)
    still.controller.post(MountPayload(None))
    still.seconds(1.0)
    assert still.now.actual_q == pytest.approx(BENT, abs=2 * STEP)


def test_a_repositioned_arm_holds_its_payload_immediately(still):
    still.controller.post(MountPayload(Payload.of(5.0, (0.0, 0.0, 0.05))))
    still.seconds(0.5)
    still.controller.motion.set_position((0.0, -1.2, 1.0, -1.0, 0.5, 1.0))
    assert peak_error_rad(still, 0.5) < STEP


def test_drives_restart_from_zero_after_the_brakes_held_the_arm(still):
    still.controller.post(MountPayload(Payload.of(3.0, (0.0, 0.0, 0.05))))
    still.seconds(1.0)
    still.request("power off")
    still.seconds(0.5)
    assert still.controller.arm.drives.torque == ZERO6
    still.request("power on")
    still.request("brake release")
    assert 1e-4 < peak_error_rad(still, 1.5) < 5e-3
    assert error_rad(still) < 1e-4


def test_an_arm_stopped_at_a_wall_barely_presses_harder(make):
    wall = WorldObject(Plane(), (0.0, 0.0, 0.25, 0.0, 0.0, 0.0), stiffness=200_000.0)
    world = WorldPlan({"table": wall})
    rig = make("ur5e", running=True, dynamic=True, initial_q=(0.0, -1.5, 1.5, -1.6, -1.57, 0.0), world=world)
    rig.script("movel(pose_add(get_actual_tcp_pose(), p[0, 0, -0.4, 0, 0, 0]), a=0.5, v=0.1)")
    rig.until(lambda snapshot: rig.controller.safety.stopped)
    assert "is obstructed: its current is off the model" in str(rig.messages)
    force = rig.controller.arm.wrench[2]
    assert force > 50.0
    rig.seconds(2.0)
    assert 0.5 * force < rig.controller.arm.wrench[2] < 1.5 * force


def test_an_ideal_arm_measures_an_unannounced_payload_without_moving(make):
    rig = make("ur5e", running=True, initial_q=BENT)
    free = rig.tick().actual_current
    rig.controller.post(MountPayload(Payload.of(3.0, (0.0, 0.0, 0.05))))
    rig.tick()
    assert rig.now.actual_q == BENT
    assert rig.now.actual_TCP_force[:3] == pytest.approx((0.0, 0.0, -3.0 * 9.82), abs=1e-9)
    oracle = Dynamics(rig.controller.model)
    oracle.set_payload(3.0, (0.0, 0.0, 0.05))
    wanted = [t / k for t, k in zip(oracle.gravity_torques(BENT), rig.controller.model.torque_constants, strict=True)]
    assert rig.now.actual_current == pytest.approx(wanted, abs=1e-9)
    assert rig.now.target_current == free
    rig.controller.post(MountPayload(None))
    assert rig.tick().actual_current == free


# in motion


def switch_off_safety_checks(rig):
    """Switch off the safety checks of the arm, which would end the motions that these tests examine."""
    rig.controller.safety_board.check_arm = lambda *, changed: None
    rig.controller.motion.govern(lambda *step: 0.0)


@pytest.mark.parametrize("name", subset(MODELS, now=("ur3", "ur5e", "ur30")))
@pytest.mark.parametrize("load", [0.0, 1.0], ids=["empty", "loaded"])
def test_a_program_is_followed_to_its_end(make, name, load):
    rig = make(name, running=True, dynamic=True, initial_q=(0.0, -1.5, 1.0, -1.2, -1.2, 0.0))
    model = rig.controller.model
    if load:
        rig.controller.installation.set_payload(Payload.of(load * model.payload_max_kg, (0.0, 0.0, 0.1)))
    goal = (0.5, -1.2, 1.3, -0.9, -1.0, 0.6)
    rig.script(f"movej({list(goal)}, a=3, v={max(model.qd_max)})")
    peak = peak_error_rad(rig, 2.0)
    assert 1e-5 < peak < 0.02
    rig.seconds(1.0)
    assert rig.now.actual_q == pytest.approx(goal, abs=5e-4)
    assert not rig.now.program_running


@pytest.mark.parametrize("name", subset(MODELS, now=("ur3", "ur5e", "ur30")))
@pytest.mark.parametrize("load", [0.0, 1.0], ids=["empty", "loaded"])
@pytest.mark.parametrize("joint", [0, 1, 2, 5])
def test_the_arm_is_stable_at_top_speed_and_in_the_hardest_stop(make, name, load, joint):
    """Stretched out, at 40 rad/s2: more than the joints can do. They still come to rest at their targets."""
    rig = make(name, running=True, dynamic=True, initial_q=(0.0, -2.2 if joint == 1 else -0.3, 0.0, 0.0, 0.0, 0.0))
    switch_off_safety_checks(rig)
    model = rig.controller.model
    rig.controller.installation.set_payload(Payload.of(load * model.payload_max_kg, (0.0, 0.0, 0.1)))
    speed = [0.0] * 6
    speed[joint] = model.qd_max[joint]
    rig.script(f"speedj({speed}, 40, 5)")
    body = rig.controller.arm.drives.body
    rig.seconds(0.6)
    assert 0.95 * speed[joint] < body.qd[joint] < 1.01 * speed[joint]
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.seconds(1.5)
    assert body.qd == pytest.approx(ZERO6, abs=1e-3)
    assert error_rad(rig) < 5e-4


def test_measured_torque_agrees_with_the_measured_motion(make):
    """RNEA of the measured motion plus rotors and friction gives the motors' torques."""
    rig = make("ur5e", running=True, dynamic=True, initial_q=BENT)
    rig.script("movej([1.0, -1.5, 1.6, -1.2, 0.2, 1.0], a=5, v=2)")
    model, body = rig.controller.model, rig.controller.arm.drives.body
    oracle = Dynamics(model)
    drives = drivetrain_of(model)
    oracle.set_rotor_inertia(drives.rotor_kg_m2)
    rig.seconds(0.1)
    checked = 0
    for _ in range(300):
        q, qd = body.q, body.qd
        snapshot = rig.tick()
        qdd = [(now - before) / 0.002 for now, before in zip(body.qd, qd, strict=True)]
        middle = [(a + b) / 2 for a, b in zip(q, body.q, strict=True)]
        speed = [(a + b) / 2 for a, b in zip(qd, body.qd, strict=True)]
        needed = np.array(oracle.inverse_dynamics(middle, speed, qdd))
        for v, i in zip(speed, range(6), strict=True):
            if abs(v) > 0.1:
                friction = drives.viscous_Nm_s[i] * v + math.copysign(drives.coulomb_Nm[i], v)
                torque = rig.controller.arm.drives.torque[i]  # before noise
                assert torque == pytest.approx(needed[i] + friction, abs=2.0)
                assert snapshot.actual_current_as_torque[i] == pytest.approx(needed[i] + friction, abs=8.0)
                assert body.qd[i] == pytest.approx(snapshot.actual_qd[i], abs=0.03)
                checked += 1
    assert checked > 800


def test_currents_include_friction_while_moving(make):
    """At constant speed joint 1 turns about the vertical: nothing but friction loads it."""
    rig = make("ur5e", running=True, dynamic=True, initial_q=BENT)
    rig.script("speedj([0.5, 0, 0, 0, 0, 0], 2, 3)")
    rig.seconds(1.0)
    drives = drivetrain_of(rig.controller.model)
    currents = []
    for _ in range(200):
        currents.append(rig.tick().actual_current[0])
    torque = sum(currents) / len(currents) * drives.torque_constants_Nm_A[0]
    assert torque == pytest.approx(drives.viscous_Nm_s[0] * 0.5 + drives.coulomb_Nm[0], abs=0.2)
    assert rig.now.target_moment[0] == pytest.approx(0.0, abs=0.1)


@pytest.mark.long
def test_friction_heats_the_moving_joint(make):
    turning, resting = (make("ur5e", running=True, dynamic=True, initial_q=BENT) for _ in range(2))
    to_and_fro = "".join(f"  movej([{q}, -1.1, 1.2, -0.8, 0.7, 0.4], a=10, v=3)\n" for q in (6, 0))
    turning.script(f"def turn():\n while True:\n{to_and_fro} end\nend\n")
    warm, cool = turning.seconds(20.0).joint_temperatures, resting.seconds(20.0).joint_temperatures
    assert warm[0] > cool[0] + 0.01
    assert warm[5] == pytest.approx(cool[5], abs=0.01)


@each_row("name", ["ur3", "ur10e", "ur20"])
def test_a_sine_is_followed_with_a_bounded_lag(make, name):
    rig = make(name, running=True, dynamic=True, initial_q=(0.0, -1.5, 1.0, -1.2, -1.2, 0.0))
    rig.script(
        """def sine():
          q = get_target_joint_positions()
          start = q[1]
          t = 0.0
          while True:
            t = t + get_steptime()
            q[1] = start + 0.1 * (1 - cos(6 * t))
            servoj(q, t=get_steptime(), lookahead_time=0.03, gain=1000)
          end
        end
        """
    )
    rig.seconds(0.5)
    assert 1e-5 < peak_error_rad(rig, 3.0) < 0.01


def test_a_step_settles_without_oscillation(make):
    """A target that jumps by 5 mrad is overshot by at most a quarter; a recorded UR5's base overshoots by a third."""
    rig = make("ur5e", running=True, dynamic=True, initial_q=BENT)
    rig.seconds(0.1)
    rig.controller.motion.set_position((BENT[0] + 0.005, *BENT[1:]))
    angles = [rig.tick().actual_q[0] for _ in range(1500)]
    assert angles[1] < BENT[0] + 0.004
    assert max(angles) < BENT[0] + 0.00625
    assert angles[-1] == pytest.approx(BENT[0] + 0.005, abs=2e-4)


def test_repositioning_is_instantaneous(make):
    rig = make("ur5e", running=True, dynamic=True, initial_q=BENT)
    rig.seconds(0.1)
    rig.script("set_pos([0, -1.2, 1.0, -1, 0.5, 1])")
    rig.tick(5)
    assert rig.now.actual_q == pytest.approx((0.0, -1.2, 1.0, -1.0, 0.5, 1.0), abs=STEP)


# reports


def test_programs_read_actual_and_target_values_separately(still):
    still.script(
        """def read():
          speedj([0, 0.5, 0, 0, 0, 0], 2, 0.5)
          actual = get_actual_joint_positions()
          target = get_target_joint_positions()
          deep = get_target_tcp_pose()[2] - get_actual_tcp_pose()[2]
          write_output_float_register(0, target[1] - actual[1])
          write_output_float_register(1, deep)
          write_output_float_register(2, get_actual_joint_speeds()[1])
        end
        """
    )
    still.seconds(0.7)
    late, deep, speed = still.now.output_double_registers[:3]
    assert 1e-4 < late < 5e-4, "half a millisecond at 0.5 rad/s, and noise"
    lever = still.controller.arm.kinematics.jacobian(BENT)[2][1]
    assert 0.0 < deep / lever < 1e-3
    assert speed == pytest.approx(0.5, abs=0.01)
    assert speed != 0.5


def test_programs_read_the_joint_torques_of_a_push(still):
    still.controller.external_wrench = (0.0, 0.0, -30.0, 0.0, 0.0, 0.0)
    still.seconds(1.0)
    still.script("def read():\n  write_output_float_register(0, get_joint_torques()[1])\nend\n")
    still.seconds(0.3)
    lever = still.controller.arm.kinematics.jacobian(BENT)[2][1]
    held = 0.8 * drivetrain_of(still.controller.model).coulomb_Nm[1]  # at most by static friction
    assert still.now.output_double_registers[0] == pytest.approx(30.0 * lever, abs=1.5 + held)


def test_encoders_are_quantised_and_the_seed_determines_the_noise(make):
    def run(**config):
        rig = make("ur5e", running=True, dynamic=True, initial_q=BENT, **config)
        rig.script("movej([1.0, -1.5, 1.6, -1.2, 0.2, 1.0], a=2, v=1)")
        arm, states = rig.controller.arm, []
        for _ in range(400):
            s = rig.tick()
            measured_parts = (s.actual_q, s.actual_qd, s.actual_TCP_pose, s.actual_current, s.actual_TCP_force)
            states.append((measured_parts, (arm.drives.body.q, arm.drives.body.qd, arm.q, arm.tcp_pose)))
        return states

    first, again, other = run(seed=7), run(seed=7), run(seed=8)
    assert first == again
    assert [measured_parts for measured_parts, _ in first] != [measured_parts for measured_parts, _ in other]
    assert [true for _, true in first] == [true for _, true in other], "noise is of the sensors, not of the arm"
    for _, (_, _, q, _) in first:
        assert all(abs(angle / STEP - round(angle / STEP)) < 1e-6 for angle in q)


def test_the_reported_pose_agrees_with_the_reported_angles(still):
    still.script("movej([1.0, -1.5, 1.6, -1.2, 0.2, 1.0], a=2, v=1)")
    still.seconds(0.5)
    assert max(map(abs, still.now.actual_qd)) > 0.3
    arm = still.controller.arm
    pose = arm.kinematics.forward(still.now.actual_q, arm.tcp_offset)
    assert still.now.actual_TCP_pose == pytest.approx(pose, abs=1e-12)
    assert still.now.actual_TCP_pose != arm.tcp_pose


def test_following_error_is_reported_and_zero_on_an_ideal_arm(make):
    dynamic, ideal = make("ur5e", running=True, dynamic=True), make("ur5e", running=True)
    for rig in (dynamic, ideal):
        rig.script("movej([1.0, -1.5, 1.6, -1.2, 0.2, 1.0], a=5, v=2)")
        rig.seconds(0.5)
    assert ideal.controller.arm.following_error == ZERO6
    assert ideal.now.actual_q == ideal.now.target_q
    arm = dynamic.controller.arm
    apart = tuple(map(sub, dynamic.now.target_q, arm.drives.body.q))
    assert arm.following_error == pytest.approx(apart, abs=STEP)
    assert max(map(abs, arm.following_error)) > 1e-5


# brakes


def test_a_braked_arm_neither_sags_nor_draws_current(make):
    rig = make("ur5e", dynamic=True, initial_q=BENT)
    rig.controller.external_wrench = (0.0, 0.0, -200.0, 0.0, 0.0, 0.0)
    rig.seconds(0.5)
    assert rig.now.actual_q == pytest.approx(BENT, abs=STEP)
    assert rig.now.actual_current == rig.now.target_moment == ZERO6


def test_brakes_stop_an_arm_that_loses_power_and_it_resumes_from_there(make):
    rig = make("ur5e", running=True, dynamic=True, initial_q=(0.0, -1.1, 1.2, -0.8, 0.7, 0.4))
    rig.script("speedj([2, 0, 0, 0, 0, 0], 10, 5)")
    rig.seconds(0.5)
    lost = rig.now.actual_q[0]
    rig.request("power off")
    rig.seconds(0.5)
    stopped = rig.now.actual_q
    assert stopped[0] > lost + 0.005
    assert not any(rig.now.actual_qd)
    rig.seconds(0.5)
    assert rig.now.actual_q == stopped
    rig.request("power on")
    rig.request("brake release")
    rig.seconds(1.0)
    assert rig.now.robot_mode == 7
    assert rig.now.actual_q == pytest.approx(stopped, abs=2 * STEP)
    assert rig.now.target_q == pytest.approx(stopped, abs=2 * STEP)
    assert error_rad(rig) < 2 * STEP


# extreme conditions


@pytest.mark.parametrize("name", ["ur3", "ur20"])
def test_the_arm_recovers_from_any_push(make, name):
    rig = make(name, running=True, dynamic=True, initial_q=BENT)
    switch_off_safety_checks(rig)
    chance = random.Random(name)
    for _ in range(60):
        push = [chance.choice((1e9, -1e300, 1e4, math.nan, math.inf, chance.uniform(-1e3, 1e3))) for _ in range(6)]
        rig.controller.external_wrench = tuple(push)
        rig.seconds(0.05)
        assert all(map(math.isfinite, rig.now.actual_q + rig.now.actual_qd))
    rig.controller.external_wrench = ZERO6
    rig.seconds(8.0)
    assert rig.now.actual_q == pytest.approx(BENT, abs=1e-3)


def test_an_excessive_payload_pulls_the_arm_down_and_it_recovers(make):
    rig = make("ur5e", running=True, dynamic=True, initial_q=BENT)
    switch_off_safety_checks(rig)
    rig.controller.post(MountPayload(Payload(1e4, (10.0, 0.0, 0.0), (-0.0, 0.0, 0.0, 1e6, 1e6, 1e6))))
    rig.seconds(1.0)
    assert all(map(math.isfinite, rig.now.actual_q))
    rig.controller.post(MountPayload(None))
    rig.seconds(10.0)
    assert rig.now.actual_q == pytest.approx(BENT, abs=1e-3)


@each_row("payload", [{"mass_kg": -1.0}, {"mass_kg": math.nan}, {"mass_kg": 1.0, "cog_m": (math.inf, 0.0, 0.0)}])
def test_invalid_payloads_cannot_be_mounted(payload):
    with pytest.raises(BadArguments, match="is not a payload"):
        virtual_robot("ur3").mount_payload(**payload)


# direct torque


def torque_rig(make, **config):
    return make("ur5e", "5.25.1", running=True, initial_q=BENT, **config)


def torque_program(*phases, more="", end="stopj(10)"):
    """A program with torques of joint 1 [Nm], each for a number of control periods, and its end."""
    loops = "".join(
        f"""
      i = 0
      while i < {count}:
        direct_torque([{torque}, 0, 0, 0, 0, 0]{more})
        i = i + 1
      end"""
        for torque, count in phases
    )
    return f"def push():{loops}\n  {end}\nend\n"


def test_torque_accelerates_the_true_body(make):
    """Joint 1 about the vertical: torque less friction, over the inertia with the rotor, as in pinocchio's ABA."""
    rig = torque_rig(make, dynamic=True)
    rig.script(torque_program((20, 1000), more=", friction_comp=False"))
    rig.until(lambda _: rig.controller.motion.torque is not None)
    reference = Body(rig.controller.model)
    body = rig.controller.arm.drives.body
    reference.q, reference.qd = body.q, body.qd
    for _ in range(100):
        gravity = rig.controller.arm.dynamics.gravity_torques(body.q)
        rig.tick()
        for _ in range(2):
            reference.step([20.0 + gravity[0], *gravity[1:]], ZERO6, 0.001)
        assert body.q == pytest.approx(reference.q, abs=1e-9)
    assert body.qd[0] > 0.3
    assert rig.now.target_q == pytest.approx(rig.now.actual_q, abs=2e-3)
    assert error_rad(rig) < 2e-3


def test_zero_torque_holds_the_arm_against_gravity_and_friction_stops_it(make):
    rig = torque_rig(make, dynamic=True)
    rig.script(torque_program((0, 500)))
    rig.seconds(0.9)
    assert rig.now.actual_q == pytest.approx(BENT, abs=2 * STEP)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_friction_compensation_keeps_the_arm_moving(make, share):
    rig = torque_rig(make, dynamic=True)
    scale = f", viscous_scale={[share] * 6}, coulomb_scale={[share] * 6}"
    rig.script(torque_program((24, 100), (0, 200), more=scale))
    rig.until(lambda snapshot: snapshot.actual_qd[0] > 0.05)
    rig.seconds(0.25)
    fast = rig.now.actual_qd[0]
    rig.seconds(0.2)
    left = rig.now.actual_qd[0] / fast
    assert left > 0.95 if share else left < 0.5


def test_missing_torque_commands_stop_the_arm(make):
    rig = torque_rig(make, dynamic=True)
    rig.script(torque_program((30, 100), end="sleep(1)"))
    rig.until(lambda snapshot: abs(snapshot.actual_qd[0]) > 0.3)
    speeds = [abs(rig.now.target_qd[0])]
    while speeds[-1] and len(speeds) < 400:
        speeds.append(abs(rig.tick().target_qd[0]))
    assert rig.now.program_running
    assert not any(rig.now.target_qd)
    drops = [before - after for before, after in itertools.pairwise(speeds)]
    assert max(drops) < 1.5 * 10.0 * rig.controller.period_s, "10 rad/s2, not in one step"


def test_an_external_push_moves_an_arm_under_torque_control(make):
    rig = torque_rig(make, dynamic=True)
    rig.script(torque_program((0, 400)))
    rig.seconds(0.1)
    rig.controller.external_wrench = (0.0, 60.0, 0.0, 0.0, 0.0, 0.0)
    rig.seconds(0.3)
    assert abs(rig.now.actual_q[0] - BENT[0]) > 0.01


@pytest.mark.parametrize("stop", ["pause", "protective stop"])
def test_a_stop_ends_torque_control_and_holds_the_arm(make, stop):
    rig = torque_rig(make, dynamic=True)
    rig.script(torque_program((40, 5000)))
    rig.until(lambda snapshot: snapshot.actual_qd[0] > 0.5)
    assert rig.now.control_mode is ControlMode.TORQUE
    if stop == "pause":
        rig.controller.programs.pause("")
    else:
        rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.seconds(1.0)
    assert not any(rig.now.target_qd)
    assert rig.now.control_mode is ControlMode.POSITION
    assert error_rad(rig) < 5e-4


def test_friction_scales_outside_0_to_1_end_the_program(make):
    rig = torque_rig(make)
    rig.script("direct_torque([0, 0, 0, 0, 0, 0], True, [0.9, 0.9, 1.1, 0.9, 0.9, 0.9])")
    rig.seconds(0.2)
    assert any("viscous_scale must be from 0 to 1" in str(message) for message in rig.messages)


def test_target_moment_includes_rotors_and_target_current_modelled_friction(make):
    """As recordings of a real UR10e show them, in every period: see ``urproto/robots/measured.toml``."""
    rig = make("ur10e", running=True, dynamic=True, initial_q=BENT)
    rig.script("movej([1.0, -1.5, 1.6, -1.2, 0.2, 1.0], a=2, v=1)")
    drives, oracle = drivetrain_of(rig.controller.model), Dynamics(rig.controller.model)
    speeds = set()
    while not speeds or any(rig.now.target_qd):
        now = rig.tick()
        qd, qdd = now.target_qd, now.target_qdd
        rigid = oracle.inverse_dynamics(now.target_q, qd, qdd)
        rotors = [inertia * rate for inertia, rate in zip(drives.rotor_kg_m2, qdd, strict=True)]
        assert now.target_moment == pytest.approx(np.add(rigid, rotors), abs=1e-9)
        currents = np.multiply(now.target_current, drives.torque_constants_Nm_A)
        for joint, speed in enumerate(map(abs, qd)):
            expected = drives.known_coulomb_Nm[joint] * min(speed / 0.012, 1.0)
            expected += drives.known_viscous_Nm_s[joint] * min(speed, 0.5)
            expected += drives.known_fast_viscous_Nm_s[joint] * max(speed - 0.5, 0.0)
            expected = math.copysign(expected, qd[joint])
            assert currents[joint] - now.target_moment[joint] == pytest.approx(expected, abs=1e-9)
        speeds.add(max(map(abs, qd)))
    assert max(speeds) > 0.9, "beyond the bend"
    assert sum(0.0 < speed < 0.5 for speed in speeds) > 50


def test_targets_of_an_ideal_arm_include_neither_rotors_nor_friction(make):
    rig = make("ur10e", running=True, initial_q=BENT)
    rig.script("speedj([0.5, 0, 0, 0, 0, 0], 2, 3)")
    rig.until(lambda snapshot: snapshot.target_qd[0] > 0.2)
    now, model = rig.now, rig.controller.model
    rigid = Dynamics(model).inverse_dynamics(now.target_q, now.target_qd, now.target_qdd)
    assert now.target_moment == pytest.approx(rigid, abs=1e-9)
    currents = np.multiply(now.target_current, model.torque_constants)
    assert currents == pytest.approx(rigid, abs=1e-9)


@pytest.mark.parametrize(("model", "target"), [("ur5e", True), ("ur10", False)])
def test_control_currents_of_an_arm_that_is_pushed_in_motion(make, model, target):
    """philipmarschner/dmp_project, a real UR5e: they are its target currents; at rest, a UR10's are its motors'."""
    rig = make(model, running=True, dynamic=True, initial_q=BENT)
    rig.script("speedj([0.3, 0.1, 0, 0, 0, 0], 2, 3)")
    rig.controller.external_wrench = (0.0, 20.0, -20.0, 0.0, 0.0, 0.0)
    rig.seconds(0.5)
    assert (rig.now.joint_control_output == rig.now.target_current) is target


def test_currents_are_noisier_in_motion_than_at_rest(make):
    rig = make("ur10e", running=True, dynamic=True, initial_q=BENT)
    drives = drivetrain_of(rig.controller.model)

    def error():
        actual = rig.tick().actual_current
        return np.subtract(actual, np.divide(rig.controller.arm.drives.torque, drives.torque_constants_Nm_A))

    def noise():
        return np.std([error() for _ in range(500)], axis=0)

    assert noise() == pytest.approx(drives.rest_noise_A, rel=0.2)
    rig.script("speedj([0.1, 0, 0, 0.1, 0, 0], 2, 3)")
    rig.seconds(0.5)
    moving = noise()
    assert moving[[0, 3]] == pytest.approx(np.array(drives.motion_noise_A)[[0, 3]], rel=0.2)


def test_the_weight_of_an_unannounced_payload_acts_at_its_centre(make):
    """About the flange: the payload's lever in base axes times its weight, independent of the TCP."""
    rig = make("ur5e", running=True, initial_q=BENT)
    rig.controller.set_tcp((0.0, 0.05, 0.2, 0.0, 0.0, 0.0))
    rig.controller.post(MountPayload(Payload.of(2.0, (0.03, 0.0, 0.08))))
    rig.tick()
    flange = rig.controller.arm.flange_pose
    hangs = pose_trans(flange, (0.03, 0.0, 0.08, 0.0, 0.0, 0.0))
    lever = [a - b for a, b in zip(hangs[:3], flange[:3], strict=True)]
    weight = (0.0, 0.0, -2.0 * 9.82)
    assert rig.now.actual_TCP_force[:3] == pytest.approx(weight, abs=1e-9)
    assert rig.now.actual_TCP_force[3:] == pytest.approx(np.cross(lever, weight), abs=1e-9)
    rig.controller.arm.zero_force()
    assert rig.tick().actual_TCP_force == pytest.approx(ZERO6, abs=1e-12)
