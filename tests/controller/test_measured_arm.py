"""A dynamic arm reproduces recordings of real arms; an ideal arm does not."""

from itertools import pairwise

import numpy as np
import pytest

from emulator.robot.body import STEP_S, Body
from tests.rows import each_row
from urproto.robots import load_model
from urproto.robots.measured import drivetrain_of

HERE = (0.3490658504, -1.9198621772, 1.0471975512, -2.0943951024, 0.6981317008, 1.0471975512)
MOVE = "def p():\n  movel(pose_add(get_target_tcp_pose(), p[0, 0, -0.1, 0, 0, 0]), a=0.1, v=0.05)\nend\n"
# el-Lennard/Robotik, Modularbeit/Aufgabe4/Aufnahme_Lennard_Messung.csv: speeds of a real UR3's target in periods 5 to
# 22 of a movel that begins a program [mm/s, by differences of its positions]
SPEEDS_MM_S = (
    0.13,
    0.22,
    0.34,
    0.51,
    0.73,
    1.00,
    1.33,
    1.73,
    2.20,
    2.74,
    3.38,
    4.10,
    4.91,
    5.83,
    6.86,
    8.00,
    8.80,
    9.60,
)


def speeds(rig, count):
    """Speeds of the target's tool in the periods after the first one in which it moves [mm/s]."""
    rig.script(MOVE)
    places = [rig.now.target_TCP_pose[2]]
    while len(places) <= count:
        before = places[-1]
        place = rig.tick().target_TCP_pose[2]
        if place != before or len(places) > 1:
            places.append(place)
    return [abs(b - a) / 0.008 * 1e3 for a, b in pairwise(places)]


def test_the_start_of_a_program_matches_a_recording(make):
    rig = make("ur3", running=True, dynamic=True, initial_q=HERE)
    found = speeds(rig, 22)
    assert found[4:22] == pytest.approx(SPEEDS_MM_S, abs=0.011)
    assert rig.now.speed_scaling == 1.0


def test_an_ideal_arm_starts_immediately(make):
    found = speeds(make("ur3", running=True, initial_q=HERE), 5)
    assert found == pytest.approx([0.4, 1.2, 2.0, 2.8, 3.6], abs=1e-6)


def test_speed_scaling_ramps_up_at_program_start(make):
    rig = make("ur3", running=True, dynamic=True, initial_q=HERE)
    rig.script("def p():\n  sleep(0.4)\nend\n")
    seen = [rig.tick().speed_scaling for _ in range(30)]
    begun = [value for value in seen if value]
    assert begun[:20] == pytest.approx([n / 20 for n in range(1, 21)])
    assert set(begun[20:]) == {1.0}


def test_currents_at_rest_include_static_friction(make):
    rig = make("ur10e", running=True, dynamic=True)
    drives = drivetrain_of(load_model("ur10e"))
    constants, coulomb = drives.torque_constants_Nm_A, drives.coulomb_Nm

    def shares():
        """Deviation of actual from target currents as shares of Coulomb friction: the mean of 200 periods."""
        rows = [(now.actual_current, now.target_current) for now in (rig.tick() for _ in range(200))]
        return [
            sum(actual[j] - target[j] for actual, target in rows) / len(rows) * constants[j] / coulomb[j]
            for j in range(6)
        ]

    rig.seconds(1.0)
    before, again = shares(), shares()
    assert again == pytest.approx(before, abs=0.02)  # noise
    rig.script("def p():\n  movej([-1.4, -1.5, -2.0, -0.6, 1.8, 0.2], a=3, v=2)\nend\n")
    rig.seconds(3.0)
    after = shares()
    assert max(map(abs, (*before, *after))) < 0.83
    assert min(abs(a - b) for a, b in zip(before, after, strict=True)) > 1e-3
    assert sum(after) > 0.0  # all joints arrived from below


@pytest.mark.parametrize(
    ("name", "wrist_lag_ms", "angle_urad", "speed_mrad_s"),
    [
        # kkufieta/ur5_modeling_force_estimate: 0.7 to 1.1 ms; MingyuTang0728/Universal-Robots-Notts: 0.5 ms
        ("ur5", (0.5, 1.2), (90.0, 260.0), (20.0, 50.0)),
        ("ur5e", (0.4, 0.6), (90.0, 150.0), (2.0, 3.5)),
    ],
)
def test_delay_and_noise_of_angles_match_recordings(make, name, wrist_lag_ms, angle_urad, speed_mrad_s):
    """Lags of base and wrist 1; noise of wrist 1 at about 0.8 rad/s. Almost no noise at rest."""
    rig = make(name, running=True, dynamic=True, initial_q=HERE)
    rig.script("def p():\n  movej([1.7, -1.5, 0.7, -0.5, 1.2, 1.9], a=1.4, v=0.8)\nend\n")
    rig.seconds(0.3)
    states = [rig.tick() for _ in range(round(1.5 / rig.controller.period_s))]
    target, speed, q, qd = (
        np.array([getattr(state, field) for state in states])
        for field in ("target_q", "target_qd", "actual_q", "actual_qd")
    )
    off = target - q
    lags = 1e3 * (off * speed).sum(axis=0) / (speed**2).sum(axis=0)
    assert lags[0] == pytest.approx(0.5, abs=0.1)
    assert wrist_lag_ms[0] < lags[3] < wrist_lag_ms[1]
    even = slice(len(states) // 2, 3 * len(states) // 4)
    assert np.ptp(speed[even, 3]) < 1e-6 < 0.7 < speed[even, 3][0]
    noises = [np.diff(values[even, 3], 2).std() / 6**0.5 for values in (off, qd - speed)]
    assert angle_urad[0] < 1e6 * noises[0] < angle_urad[1]
    assert speed_mrad_s[0] < 1e3 * noises[1] < speed_mrad_s[1]
    rig.seconds(3.0)
    assert not any(rig.now.actual_qd)
    assert rig.tick().actual_q == rig.tick().actual_q


def test_supply_values_match_a_real_arm(make):
    rig = make("ur10", running=True, dynamic=True)
    rig.seconds(1.0)
    volts = [rig.tick().actual_main_voltage for _ in range(100)]
    assert sum(volts) / 100 == pytest.approx(48.21, abs=0.02)
    assert len(set(volts)) == 100
    assert make("ur10", running=True).seconds(1.0).actual_main_voltage == 48.0


@each_row(
    ("name", "joint", "manual_rad"),
    [("ur5", 0, 0.31), ("ur5", 1, 0.70), ("ur3", 0, 0.18)],
)
def test_brakes_stop_the_arm_as_in_the_manual(name, joint, manual_rad):
    """User manuals, appendix A: category 0, 183 degrees/s, stretched out, full payload, shoulder downwards."""
    model = load_model(name)
    body = Body(model)
    body.dynamics.set_payload(model.payload_max_kg, (0.0, 0.0, 0.0))
    ways = []
    for way in (1.0, -1.0):
        body.place((0.0,) * 6)
        body.qd = tuple(way * 3.194 if index == joint else 0.0 for index in range(6))
        for _ in range(1000):
            body.brake((0.0,) * 6, STEP_S)
        assert body.standing
        ways.append(abs(body.q[joint]))
    assert max(ways) == pytest.approx(manual_rad, rel=0.08)
