"""Payload estimation and a moving base, against numpy and against the rigid-body model."""

import math

import numpy as np
import pytest

from tests.rows import each_row
from urproto.robots.pose import rotvec_to_matrix

GRAVITY = np.array([0.0, 0.0, 9.82])
TURNS = [(0, 0, 0), (2.2, 0, 0), (0, 1.4, 0), (1.0, 1.0, 1.0), (-1.2, 0.7, 0.3), (0.4, -2.0, 1.1)]


def axes(turn):
    return np.array(rotvec_to_matrix(*turn)).reshape(3, 3)


def weights(mass, cog, turns, gravity=GRAVITY, offset=(0.0,) * 6, noise=0.0, seed=1):
    """Wrench of a payload on the flange in base axes, with an offset of the sensor in flange axes."""
    rng = np.random.default_rng(seed)
    wrenches = []
    for turn in turns:
        force = -mass * gravity
        torque = np.cross(axes(turn) @ cog, force)
        biased = [*(force + axes(turn) @ offset[:3]), *(torque + axes(turn) @ offset[3:])]
        wrenches.append([float(v) for v in np.array(biased) + noise * rng.normal(size=6)])
    return wrenches


def call(turns, wrenches):
    poses = ", ".join(f"p[0.1, 0.2, 0.3, {x}, {y}, {z}]" for x, y, z in turns)
    return f"estimate_payload([{poses}], {wrenches})"


def estimate(rig, turns, wrenches):
    members = rig.value(call(turns, wrenches)).members
    return members["mass"], members["cog"]


def test_mass_and_centre_of_gravity(rig):
    cog = np.array([0.02, -0.03, 0.11])
    mass, found = estimate(rig, TURNS, weights(2.3, cog, TURNS))
    assert mass == pytest.approx(2.3, abs=1e-9)
    assert found == pytest.approx(list(cog), abs=1e-9)


def test_a_zeroed_sensor_and_a_tilted_mounting_give_the_same_estimate(rig):
    cog, gravity = np.array([0.02, -0.03, 0.11]), np.array([4.0, -2.0, 8.7])
    first = weights(2.3, cog, TURNS, gravity)[0]
    zeroed = weights(2.3, cog, TURNS, gravity, [-v for v in first])
    assert zeroed[0] == pytest.approx([0] * 6, abs=1e-12)
    rig.run(f"set_gravity({gravity.tolist()})")
    mass, found = estimate(rig, TURNS, zeroed)
    assert mass == pytest.approx(2.3, abs=1e-9)
    assert found == pytest.approx(list(cog), abs=1e-9)


def test_the_estimate_does_not_depend_on_the_tcp_of_the_poses(rig):
    rig.run("set_tcp(p[0, 0, 0.2, 0.5, 0, 0])")
    flange_turns = [tuple(_turn(axes(turn) @ axes((0.5, 0, 0)).T)) for turn in TURNS]
    mass, cog = estimate(rig, TURNS, weights(1.5, np.array([0.0, 0.05, 0.1]), flange_turns))
    assert (mass, *cog) == pytest.approx((1.5, 0, 0.05, 0.1), abs=1e-9)


def _turn(m):
    """Rotation vector of a matrix away from pi."""
    angle = math.acos((np.trace(m) - 1) / 2)
    vector = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    return vector * angle / (2 * math.sin(angle)) if angle > 1e-9 else vector


def test_noise_is_averaged_by_least_squares(rig):
    cog = np.array([0.02, -0.03, 0.11])
    noisy = weights(2.3, cog, TURNS, noise=0.1)
    mass, found = estimate(rig, TURNS, noisy)
    rows, right = [], []
    for turn, wrench in zip(TURNS, noisy, strict=True):
        rows.append(np.hstack([(axes(turn).T @ -GRAVITY)[:, None], np.eye(3)]))
        right.append(axes(turn).T @ wrench[:3])
    expected = np.linalg.lstsq(np.vstack(rows), np.hstack(right), rcond=None)[0][0]
    assert mass == pytest.approx(expected, abs=1e-9)
    rows, right = [], []
    for turn, wrench in zip(TURNS, noisy, strict=True):
        x, y, z = axes(turn).T @ -GRAVITY * mass
        rows.append(np.hstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)]))
        right.append(axes(turn).T @ wrench[3:])
    expected = np.linalg.lstsq(np.vstack(rows), np.hstack(right), rcond=None)[0][:3]
    assert found == pytest.approx(list(expected), abs=1e-9)


@each_row(
    ("turns", "problem"),
    [
        (TURNS[:3], "4 or more"),
        ([*TURNS[:3], (0.1, 0, 0)], "differ by only 0.100 rad"),
        ([(0, 0, z) for z in (0, 0.8, 1.6, 2.4)], "tilt the tool"),
        ([(x, 0, 0) for x in (0, 0.8, 1.6, 2.4)], None),
    ],
)
def test_insufficient_poses_are_refused(rig, turns, problem):
    program = call(turns, weights(1.0, np.array([0.0, 0.0, 0.1]), turns))
    if problem is None:  # turned about one axis: the weight sweeps a plane, which determines everything
        assert rig.value(program).members["cog"] == pytest.approx([0, 0, 0.1], abs=1e-9)
    else:
        assert problem in rig.fault(program)


@each_row("arguments", ["[1, 2, 3, 4], [1, 2, 3, 4]", "[[0]], [[0]]", '["a"], ["b"]'])
def test_invalid_pose_lists_are_refused(rig, arguments):
    assert rig.fault(f"estimate_payload({arguments})").startswith("estimate_payload:")


def test_a_program_sets_the_estimate_as_payload(rig):
    """The example of the vendor's support page, with an external wrench in each pose."""
    wrenches = weights(1.2, np.array([0.01, 0.0, 0.06]), TURNS)
    rig.run(f"payload = {call(TURNS, wrenches)}\nset_target_payload(payload.mass, payload.cog)")
    assert rig.value("get_target_payload()") == pytest.approx(1.2)
    assert rig.value("get_target_payload_cog()") == pytest.approx([0.01, 0, 0.06], abs=1e-9)


# a moving base


def test_a_base_that_accelerates_adds_to_gravity(make_rig):
    moving, tilted = make_rig("ur5e", None), make_rig("ur5e", None)
    payload = "set_target_payload(3, [0, 0.02, 0.1])\n"
    moving.run(payload + "set_base_acceleration([1.5, -0.5, 2])\nsync()")
    tilted.run(payload + "set_gravity([1.5, -0.5, 11.82])\nsync()")
    now, then = moving.controller.snapshot, tilted.controller.snapshot
    assert now.target_moment == pytest.approx(then.target_moment, abs=1e-9)
    assert now.actual_current == pytest.approx(then.actual_current, abs=1e-9)
    assert now.ft_raw_wrench == pytest.approx(then.ft_raw_wrench, abs=1e-9)
    assert math.hypot(*now.ft_raw_wrench[:3]) == pytest.approx(3 * math.hypot(1.5, 0.5, 11.82))
    assert now.actual_tool_accelerometer == pytest.approx(then.actual_tool_accelerometer, abs=1e-9)
    assert now.target_gravity == (0, 0, 9.82)
    assert now.target_base_acceleration == (1.5, -0.5, 2, 0, 0, 0)
    assert moving.value("get_base_acceleration()") == [1.5, -0.5, 2]
    assert moving.value("get_gravity()") == [0, 0, 9.82]
    moving.run("set_base_acceleration([0, 0, 0])\nsync()")
    assert math.hypot(*moving.controller.snapshot.ft_raw_wrench[:3]) == pytest.approx(3 * 9.82)


def test_a_base_acceleration_must_be_three_numbers(rig):
    assert rig.fault("set_base_acceleration([1, 2])").startswith("set_base_acceleration:")


# where the wrench is measured


def test_the_wrench_refers_to_the_flange_on_e_series_and_to_the_tcp_on_cb3(rig, cb3):
    """Script Manual, get_tcp_force; the official ROS drivers rely on it."""
    wrench = np.array([3.0, -5.0, 7.0, 0.1, 0.2, -0.3])

    def push():
        for arm in (rig, cb3):
            arm.controller.external_wrench = tuple(wrench)

    for arm in (rig, cb3):
        arm.run("set_tcp(p[0.05, 0, 0.2, 0, 0, 0])\nsync()")
    flange, tcp = (np.array(rig.value(f"get_actual_{name}_pose()")[:3]) for name in ("tool_flange", "tcp"))
    expected = [*wrench[:3], *(wrench[3:] + np.cross(tcp - flange, wrench[:3]))]
    assert rig.value("get_tcp_force()", meanwhile=push) == pytest.approx(expected, abs=1e-12)
    assert rig.controller.snapshot.actual_TCP_force == pytest.approx(expected, abs=1e-12)
    assert cb3.value("get_tcp_force()") == pytest.approx(list(wrench), abs=1e-12)


def test_an_external_sensor_gives_the_wrench_at_the_tcp(rig):
    """As its users see it (ROS 2 driver, issue 1849)."""
    rig.run("set_tcp(p[0, 0, 0.2, 0, 0, 0])")
    rig.controller.ft_input.wrench_flange = (0.0, 6.0, 0.0, 0.0, 0.0, 0.0)
    rig.start("ft_rtde_input_enable(True)\nsleep(0.02)\nglobal found = get_tcp_force()\nsleep(0.05)")
    rig.until(lambda: "found" in rig.controller.programs.variables)
    found = rig.controller.programs.variables["found"]
    assert np.linalg.norm(found[:3]) == pytest.approx(6)
    assert np.linalg.norm(found[3:]) == pytest.approx(6 * 0.2)


def test_an_unset_payload_is_estimated_from_sensor_readings(rig):
    """The procedure of the vendor's manual, with a mounted tool that is unknown to the controller."""
    mass, cog = 1.7, np.array([0.01, -0.02, 0.09])
    rig.run("set_tcp(p[0.02, 0, 0.15, 0.3, 0, 0])\nzero_ftsensor()")
    poses, wrenches = [], []
    for q in (
        [0, -1.5, 1.5, -1.6, -1.57, 0],
        [0.3, -1.2, 1.0, 0.3, -0.8, 1],
        [0, -1.5, 1.5, -3, 1, 0.5],
        [1, -1, 1, 0, 1, 2],
    ):
        rig.run(f"movej({q}, a=5, v=2)")
        arm = rig.controller.arm
        at_flange = np.array(weights(mass, cog, [arm.flange_pose[3:]])[0])
        lever = np.subtract(arm.tcp_pose[:3], arm.flange_pose[:3])
        torque = at_flange[3:] - np.cross(lever, at_flange[:3])
        poses.append("p" + str([float(v) for v in rig.value("get_actual_tcp_pose()")]))

        def hang(wrench=(*at_flange[:3], *torque)):
            rig.controller.external_wrench = tuple(map(float, wrench))

        wrenches.append([float(v) for v in rig.value("get_tcp_force()", meanwhile=hang)])
        rig.controller.external_wrench = (0.0,) * 6
    members = rig.value(f"estimate_payload([{', '.join(poses)}], {wrenches})").members
    assert members["mass"] == pytest.approx(mass, abs=1e-6)
    assert members["cog"] == pytest.approx(list(cog), abs=1e-6)


@pytest.mark.parametrize("command", ["set_payload(12)", "set_target_payload(12, [0, 0, 0])", "set_payload_mass(12)"])
def test_a_payload_above_the_rating_is_accepted_with_one_warning(rig, command):
    rig.run(f"{command}\n{command}")
    assert rig.controller.installation.payload.mass == 12
    notes = [line for line in rig.controller.messages.history if "rated for" in line]
    assert len(notes) == 1
    assert "12 kg" in notes[0]
    assert "the UR5e is rated for 5 kg" in notes[0]


def test_a_payload_within_the_rating_causes_no_warning(rig):
    rig.run("set_payload(5)")
    assert not any("rated for" in line for line in rig.controller.messages.history)
