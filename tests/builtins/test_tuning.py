"""Settings of the motion controller, checked by their effect on the arm."""

import math

import numpy as np
import pytest

from emulator.lifecycle.safety import SafetyEvent
from tests.rows import each_row
from urproto.modes import RuntimeState, SafetyMode
from urproto.robots.pose import pose_inv, pose_trans, rotvec_to_matrix


def tool_z(pose):
    m = rotvec_to_matrix(*pose[3:])
    return np.array([m[2], m[5], m[8]])


# screw driving


def test_screw_driving_pushes_along_the_tool_at_limited_speed(rig):
    before = rig.value("get_actual_tcp_pose()")
    rig.run("screw_driving(50, 0.01)\nsleep(2)\nend_screw_driving()\nsleep(0.5)")
    after = rig.value("get_actual_tcp_pose()")
    way = np.subtract(after[:3], before[:3])
    assert way @ tool_z(before) == pytest.approx(0.02, abs=0.002)
    assert np.linalg.norm(np.cross(way, tool_z(before))) < 1e-6
    assert after[3:] == pytest.approx(before[3:], abs=1e-6)


def test_a_screw_resisting_with_equal_force_holds_the_tool(rig):
    z = tool_z(rig.value("get_actual_tcp_pose()"))
    before = rig.q
    rig.controller.external_wrench = (*(-5 * z), 0.0, 0.0, 0.0)
    rig.run("screw_driving(5, 0.1)\nsleep(1)\nend_screw_driving()")
    assert rig.q == pytest.approx(before, abs=1e-6)


def test_screw_driving_follows_the_tool_when_it_is_turned(rig):
    rig.start(
        """
        screw_driving(30, 0.02)
        movel(pose_trans(get_target_tcp_pose(), p[0, 0, 0, 0.8, 0, 0]), a=1, v=0.3)
        sleep(1)
        end_screw_driving()
        sleep(1)
        """
    )
    start = tool_z(rig.controller.snapshot.actual_TCP_pose)
    rig.until(lambda: np.dot(tool_z(rig.controller.snapshot.actual_TCP_pose), start) < math.cos(0.79))
    rig.seconds(0.9)
    snapshot = rig.controller.snapshot
    speed = np.array(snapshot.actual_TCP_speed[:3])
    assert speed == pytest.approx(0.02 * tool_z(snapshot.actual_TCP_pose), abs=2e-4)
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert not any(rig.controller.snapshot.actual_qd)


@each_row("call", ["screw_driving(5, 0)", "screw_driving(5, -0.1)", "screw_driving(5 / 0.0, 0.1)"])
def test_screw_driving_requires_a_force_and_a_speed(rig, call):
    assert rig.fault(call).count("screw_driving")


# errors that pause


def test_a_selected_error_pauses_instead_of_stopping(rig):
    rig.start('pause_on_error_code(209)\nprotective_stop()\nsleep(0.1)\ntextmsg("went on")')
    rig.until(lambda: rig.state is RuntimeState.PAUSED)
    assert rig.controller.safety.mode is SafetyMode.NORMAL
    assert rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.texts == ["went on"]


@pytest.mark.parametrize(("argument", "mode"), [(0, SafetyMode.NORMAL), (3, SafetyMode.PROTECTIVE_STOP)])
def test_errors_are_selected_by_their_argument_too(rig, argument, mode):
    rig.start(f"pause_on_error_code(209, {argument})\nprotective_stop()\nsleep(0.1)")
    rig.until(lambda: rig.state is RuntimeState.PAUSED)
    assert rig.controller.safety.mode is mode


def test_selected_errors_are_reset_when_the_program_ends(rig):
    rig.run("pause_on_error_code(209)\nsleep(0.1)")
    rig.start("protective_stop()\nsleep(0.1)")
    rig.until(lambda: rig.state is RuntimeState.PAUSED)
    assert rig.controller.safety.mode is SafetyMode.PROTECTIVE_STOP


def test_a_failing_move_pauses_and_fails_when_resumed(rig):
    rig.start("pause_on_error_code(204)\nmovel(p[3, 0, 0, 0, 0, 0])")
    rig.until(lambda: rig.state is RuntimeState.PAUSED)
    assert rig.controller.safety.mode is SafetyMode.NORMAL
    assert rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert "out of reach" in rig.exceptions[-1].text


# transitions


def hardest_stop(rig, hardness, event):
    """Largest deceleration of the base joint [rad/s2] after the event, at 2 rad/s."""
    rig.start(f"set_safety_mode_transition_hardness({hardness})\nspeedj([2, 0, 0, 0, 0, 0], a=5, t=1.2)\nstopj(5)")
    rig.until(lambda: rig.controller.snapshot.actual_qd[0] > 1.99 and not rig.controller.snapshot.target_qdd[0])
    rig.controller.safety_event(event)
    decelerations = []
    for _ in range(100):
        rig.tick()
        decelerations.append(-rig.controller.snapshot.target_qdd[0])
    return max(decelerations)


@pytest.mark.parametrize("event", [SafetyEvent.REDUCED, SafetyEvent.SAFEGUARD_OPEN])
def test_hard_transitions_use_the_joint_limits_and_soft_ones_do_not(make_rig, event):
    hard, soft = (hardest_stop(make_rig("ur5e", None), hardness, event) for hardness in (0, 1))
    most = min(make_rig("ur5e", None).controller.model.qdd_max)
    assert soft <= 10.0 + 1e-6
    assert 15.0 < hard <= most + 1e-6


# the tool wrench


MOVES = {
    "movej": "movej([1.2, -1.2, 1.2, -1.6, -1.57, 0.8], a=6, v=2)",
    "movel": "movel(pose_trans(get_target_tcp_pose(), p[0.2, 0.15, -0.1, 0.5, 0, 0.4]), a=5, v=1)",
}
FRAME = (0.02, 0.0, 0.1, 0.0, 0.3, 0.0)
MASS, COG, INERTIA = 2.0, np.array([0.03, -0.02, 0.08]), np.diag([0.01, 0.012, 0.004])


def wrenches(rig, body):
    """Wrenches that accelerate the payload in FRAME, from the published flange poses; one row per period."""
    rig.start(body)
    poses = []
    rig.until(lambda: rig.state is RuntimeState.PLAYING)
    while rig.state is RuntimeState.PLAYING:
        rig.tick()
        poses.append(rig.controller.arm.flange_pose)
    h = rig.period
    turns = [np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3) for pose in poses]
    at = np.array([np.array(pose[:3]) + turn @ COG for pose, turn in zip(poses, turns, strict=True)])
    spins = [pose_trans(poses[i + 1], pose_inv(poses[i])) for i in range(len(poses) - 1)]
    spins = [np.array(spin[3:]) / h for spin in spins]
    frame = np.array(rotvec_to_matrix(*FRAME[3:])).reshape(3, 3)
    rows = []
    for i in range(1, len(poses) - 1):
        turn = turns[i]
        force = MASS * (at[i + 1] - 2 * at[i] + at[i - 1]) / h**2
        inertia = turn @ INERTIA @ turn.T
        spin = 0.5 * (spins[i] + spins[i - 1])
        torque = inertia @ (spins[i] - spins[i - 1]) / h + np.cross(spin, inertia @ spin)
        origin = np.array(poses[i][:3]) + turn @ FRAME[:3]
        torque = torque + np.cross(at[i] - origin, force)
        rows.append([*(frame.T @ turn.T @ force), *(frame.T @ turn.T @ torque)])
    return np.abs(rows)


PAYLOAD = "set_target_payload(2, [0.03, -0.02, 0.08], [0.01, 0.012, 0.004, 0, 0, 0])\n"
SET = f"tool_wrench_limit_set(p{list(FRAME)}, "


@each_row("move", MOVES)
@each_row(("name", "column"), [("Fx", 0), ("Fz", 2), ("My", 4)])
def test_the_wrench_limit_is_kept_without_slowing_more_than_necessary(make_rig, move, name, column):
    free = wrenches(make_rig("ur5e", "5.20"), PAYLOAD + MOVES[move])[:, column].max()
    limit = free / 3
    rig = make_rig("ur5e", "5.20")
    held = wrenches(rig, f"{PAYLOAD}{SET}{name}={limit})\n{MOVES[move]}")[:, column].max()
    assert 0.85 * limit < held < 1.03 * limit
    freed = wrenches(rig, "tool_wrench_limit_disable()\nmovej([0, -1.5, 1.5, -1.6, -1.57, 0])\n" + MOVES[move])
    assert freed[:, column].max() > 2 * limit


def test_a_wrench_limit_does_not_affect_gentle_moves(make_rig):
    rig = make_rig("ur5e", "5.20")
    plain = rig.run(PAYLOAD + "movej([0.5, -1.5, 1.5, -1.6, -1.57, 0])")
    rig.run("movej([0, -1.5, 1.5, -1.6, -1.57, 0])")
    assert rig.run(f"{SET}Fx=500)\nmovej([0.5, -1.5, 1.5, -1.6, -1.57, 0])") == pytest.approx(plain, abs=0.01)


def test_a_wrench_limit_must_be_positive(rig):
    assert "greater than 0" in rig.fault("tool_wrench_limit_set(p[0, 0, 0, 0, 0, 0], Fx=0)")


# settings that are stored only


def test_jerk_gain(rig):
    assert rig.value("jerk_gain_scaling_get()") == 1
    rig.run("jerk_gain_scaling_set(0.5)")
    assert rig.value("jerk_gain_scaling_get()") == 0.5
    assert "0.01 to 1" in rig.fault("jerk_gain_scaling_set(0)")
    assert rig.value("jerk_gain_scaling_get()") == 0.5


def test_holding_torque(rig):
    rig.run("high_holding_torque_disable()")
    assert not rig.controller.programs.high_holding_torque
    rig.run("high_holding_torque_enable()")
    assert rig.controller.programs.high_holding_torque
