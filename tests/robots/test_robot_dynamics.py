"""Dynamics against a model with other frames, manual calculations, and consistency conditions."""

import csv
import math
import random
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from tests.rows import each_row
from urproto.robots import MODELS, load_model
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import DH
from urproto.robots.pinocchio_dynamics import Dynamics
from urproto.robots.plain_dynamics import PlainDynamics

G = 9.82
ZERO = (0.0,) * 6
TOOL = (0.03, -0.05, 0.12, 0.4, -0.3, 0.9)


@pytest.fixture(params=MODELS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=[Dynamics, PlainDynamics], ids=["Pinocchio", "plain"])
def kind(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture
def dynamics(name: str, kind: Any) -> Any:
    return kind(load_model(name))


def states(count: int, seed: int) -> list[tuple[list[float], list[float], list[float]]]:
    source = random.Random(seed)

    def six(bound: float) -> list[float]:
        return [source.uniform(-bound, bound) for _ in range(6)]

    return [(six(math.pi), six(3.0), six(10.0)) for _ in range(count)]


@cache
def description_rows() -> list[dict[str, str]]:
    lines = (Path(__file__).parent / "description_inertials.csv").read_text().splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def built_from_description_frames(name: str) -> Any:
    """The arm in the link frames of the ROS description: other origins, other axes, same mechanism."""
    dh = load_model(name).dh
    d1, _, _, d4, d5, d6 = dh.d
    # joint origins (x y z, roll pitch yaw) as ur_macro.xacro chains them
    origins = [
        ((0, 0, d1), (0, 0, 0)),
        ((0, 0, 0), (math.pi / 2, 0, 0)),
        ((dh.a[1], 0, 0), (0, 0, 0)),
        ((dh.a[2], 0, d4), (0, 0, 0)),
        ((0, -d5, 0), (math.pi / 2, 0, 0)),
        ((0, d6, 0), (math.pi / 2, math.pi, math.pi)),
    ]
    model, parent = pin.Model(), 0
    model.gravity.linear = np.array((0.0, 0.0, -G))
    rows = [row for row in description_rows() if row["model"] == name]
    for row, (xyz, rpy) in zip(rows, origins, strict=True):
        placement = pin.SE3(pin.rpy.rpyToMatrix(*map(float, rpy)), np.array(xyz, dtype=float))
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, row["link"])
        n = {key: float(value) for key, value in row.items() if key not in ("model", "link")}
        local = np.array(
            ((n["ixx"], n["ixy"], n["ixz"]), (n["ixy"], n["iyy"], n["iyz"]), (n["ixz"], n["iyz"], n["izz"]))
        )
        axes = pin.rpy.rpyToMatrix(n["inertia_roll"], n["inertia_pitch"], n["inertia_yaw"])
        com = np.array((n["com_x"], n["com_y"], n["com_z"]))
        body = pin.Inertia(n["mass_kg"], com, axes @ local @ axes.T)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def test_dynamics_do_not_depend_on_link_frames(name: str, dynamics: Dynamics) -> None:
    other = built_from_description_frames(name)
    data = other.createData()
    for q, qd, qdd in states(20, 1):
        expected = pin.rnea(other, data, np.array(q), np.array(qd), np.array(qdd))
        # 1e-6 Nm on up to 1e3 Nm: the error of alpha with nine decimals
        assert dynamics.inverse_dynamics(q, qd, qdd) == pytest.approx(expected, abs=1e-6)


@each_row("calibrated", [False, True])
def test_plain_python_agrees_with_pinocchio(name: str, calibrated: bool) -> None:
    model = load_model(name)
    if calibrated:
        model = replace(model, calibration=slightly_off(model.dh))
    both = Dynamics(model), PlainDynamics(model)
    for dynamics in both:
        dynamics.set_payload(2.0, (0.01, -0.02, 0.05), (0.01, 0.02, 0.015, 0.001, -0.002, 0.003))
        dynamics.set_gravity((1.0, -2.0, 9.0))
        dynamics.set_rotor_inertia((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    for q, qd, qdd in states(10, 10):
        for method, arguments in {
            "inverse_dynamics": (q, qd, qdd),
            "base_wrench": (q, qd, qdd),
            "forward_dynamics": (q, qd, qdd),
            "gravity_torques": (q,),
            "coriolis_torques": (q, qd),
            "mass_matrix": (q,),
            "energy": (q, qd),
            "linear_momentum": (q, qd),
            "jacobian_time_derivative": (q, qd, TOOL),
        }.items():
            expected, found = (np.array(getattr(dynamics, method)(*arguments)) for dynamics in both)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max()))


@each_row("kind", [Dynamics, PlainDynamics])
def test_combined_torques_and_momentum_equal_separate_results(name: str, kind: type) -> None:
    dynamics = kind(load_model(name))
    dynamics.set_payload(2.0, (0.01, -0.02, 0.05))
    for q, qd, qdd in states(10, 12):
        torques, momentum = dynamics.torques_and_momentum(q, qd, qdd)
        assert torques == dynamics.inverse_dynamics(q, qd, qdd)
        assert momentum == pytest.approx(dynamics.linear_momentum(q, qd), rel=1e-12)


def test_both_kinds_have_the_same_methods() -> None:
    named = {kind: {name for name in vars(kind) if not name.startswith("_")} for kind in (Dynamics, PlainDynamics)}
    of_recordings = {"inverse_dynamics_along", "last_link_regressor", "payload_of"}  # identification uses Pinocchio
    assert named[Dynamics] - of_recordings == named[PlainDynamics]


def slightly_off(dh: DH) -> DH:
    """A typical factory calibration: tenths of a millimetre and of a milliradian."""
    source = random.Random(11)
    moved = {
        field: tuple(value + source.uniform(-2e-4, 2e-4) for value in getattr(dh, field))
        for field in ("a", "d", "alpha", "theta")
    }
    flange = {field: (*moved[field][:5], getattr(dh, field)[5]) for field in ("a", "alpha")}  # is its joint's frame
    return replace(dh, **moved | flange)


# manual calculations


def test_gravity_on_a_ur5e_stretched_out_level() -> None:
    # At zero the arm lies along -x. Lifting joint 2 by dq raises a mass at x by x dq, so its
    # torque is g * sum(m x); for joint 3 the lever starts at the elbow, x = -0.425.
    dynamics = Dynamics(load_model("ur5e"))
    upper_arm, forearm = (8.058, -0.425 + 0.2125), (2.846, -0.425 - 0.3922 + 0.15)
    wrists = (1.37 + 1.3 + 0.365, -0.425 - 0.3922)
    shoulder = G * sum(mass * x for mass, x in (upper_arm, forearm, wrists))
    elbow = G * sum(mass * (x + 0.425) for mass, x in (forearm, wrists))
    torques = dynamics.gravity_torques(ZERO)
    assert torques[0] == pytest.approx(0.0, abs=1e-9)
    assert torques[1] == pytest.approx(shoulder)
    assert torques[2] == pytest.approx(elbow)
    assert shoulder == pytest.approx(-59.8173, abs=1e-4)  # the sum, calculated manually


def test_payload_calculated_manually() -> None:
    # 2 kg, its centre 5 cm along the flange's x, which at zero is the base's x
    dynamics = Dynamics(load_model("ur5e"))
    before = dynamics.gravity_torques(ZERO)
    dynamics.set_payload(2.0, (0.05, 0.0, 0.0))
    after = dynamics.gravity_torques(ZERO)
    assert after[1] - before[1] == pytest.approx(2.0 * G * (-0.425 - 0.3922 + 0.05))
    assert after[2] - before[2] == pytest.approx(2.0 * G * (-0.3922 + 0.05))


def test_payload_inertia_about_the_flange_axis() -> None:
    # joint 6 turns about the flange's z: a payload on that axis adds its Izz and nothing else
    dynamics = Dynamics(load_model("ur10e"))
    before = dynamics.mass_matrix(ZERO)[5][5]
    dynamics.set_payload(3.0, (0.0, 0.0, 0.1), (0.5, 0.6, 0.07, 0.0, 0.0, 0.0))
    assert dynamics.mass_matrix(ZERO)[5][5] - before == pytest.approx(0.07)
    dynamics.set_payload(3.0, (0.1, 0.0, 0.1))  # 3 kg at 10 cm
    assert dynamics.mass_matrix(ZERO)[5][5] - before == pytest.approx(0.03)


def test_momentum_of_a_heavy_payload() -> None:
    model = load_model("ur3")
    dynamics, kinematics = Dynamics(model), Kinematics(model.dh)
    mass, (q, qd, _) = 1e7, states(1, 2)[0]
    dynamics.set_payload(mass, (0.02, 0.03, 0.1))
    rows = kinematics.jacobian(q, (0.02, 0.03, 0.1, 0.0, 0.0, 0.0))
    speed = math.hypot(*(sum(a * b for a, b in zip(row, qd, strict=True)) for row in rows[:3]))
    assert dynamics.linear_momentum(q, qd) == pytest.approx(mass * speed, rel=1e-5)
    assert dynamics.linear_momentum(q, ZERO) == 0.0


# consistency


def test_payload_replaces_the_previous_one(dynamics: Dynamics) -> None:
    q = states(1, 3)[0][0]
    bare = dynamics.gravity_torques(q)
    dynamics.set_payload(2.0, (0.0, 0.02, 0.05))
    dynamics.set_payload(0.0, (0.0, 0.0, 0.0))
    assert dynamics.gravity_torques(q) == pytest.approx(bare, abs=1e-12)


def test_negative_payload_is_refused_and_changes_nothing() -> None:
    dynamics = Dynamics(load_model("ur3"))
    before = dynamics.gravity_torques(ZERO)
    with pytest.raises(ValueError, match="negative"):
        dynamics.set_payload(-1.0, (0.0, 0.0, 0.0))
    assert dynamics.gravity_torques(ZERO) == before


def test_gravity_follows_the_mounting(dynamics: Dynamics) -> None:
    q = states(1, 4)[0][0]
    upright = dynamics.gravity_torques(q)
    dynamics.set_gravity((0.0, 0.0, -G))  # hanging from the ceiling
    assert dynamics.gravity_torques(q) == pytest.approx([-t for t in upright], abs=1e-9)
    dynamics.set_gravity((0.0, 0.0, 0.0))
    assert dynamics.gravity_torques(q) == pytest.approx(ZERO, abs=1e-12)


def test_forward_dynamics_undoes_inverse(dynamics: Dynamics) -> None:
    dynamics.set_payload(1.5, (0.01, -0.02, 0.05), (0.01, 0.02, 0.015, 0.001, -0.002, 0.0))
    for q, qd, qdd in states(20, 5):
        torque = dynamics.inverse_dynamics(q, qd, qdd)
        assert dynamics.forward_dynamics(q, qd, torque) == pytest.approx(qdd, abs=1e-7)


def test_torque_is_inertia_plus_coriolis_plus_gravity(dynamics: Dynamics) -> None:
    for q, qd, qdd in states(10, 6):
        mass, coriolis = np.array(dynamics.mass_matrix(q)), np.array(dynamics.coriolis_torques(q, qd))
        total = mass @ qdd + coriolis + np.array(dynamics.gravity_torques(q))
        assert dynamics.inverse_dynamics(q, qd, qdd) == pytest.approx(total, abs=1e-9)
        np.testing.assert_array_equal(mass, mass.T)
        assert np.linalg.eigvalsh(mass)[0] > 0.0


def test_coriolis_torques_do_the_work_that_changes_the_inertia(dynamics: Dynamics) -> None:
    # energy: qd . C(q, qd) qd = 1/2 qd . dM/dt qd
    step = 1e-6
    for q, qd, _ in states(5, 7):
        ahead = np.array(dynamics.mass_matrix([a + step * b for a, b in zip(q, qd, strict=True)]))
        behind = np.array(dynamics.mass_matrix([a - step * b for a, b in zip(q, qd, strict=True)]))
        rate = (ahead - behind) / (2 * step)
        expected = 0.5 * np.dot(qd, rate @ qd)
        assert np.dot(qd, dynamics.coriolis_torques(q, qd)) == pytest.approx(expected, rel=1e-5, abs=1e-5)


@each_row("tcp", [None, TOOL])
def test_jacobian_time_derivative(name: str, dynamics: Dynamics, tcp: tuple[float, ...] | None) -> None:
    kinematics, step = Kinematics(load_model(name).dh), 1e-6
    for q, qd, _ in states(5, 8):
        ahead = np.array(kinematics.jacobian([a + step * b for a, b in zip(q, qd, strict=True)], tcp))
        behind = np.array(kinematics.jacobian([a - step * b for a, b in zip(q, qd, strict=True)], tcp))
        found = np.array(dynamics.jacobian_time_derivative(q, qd, tcp))
        np.testing.assert_allclose(found, (ahead - behind) / (2 * step), rtol=0, atol=1e-6)


def test_results_are_bit_identical(dynamics: Dynamics) -> None:
    (q, qd, qdd), (other, _, _) = states(2, 9)
    first = dynamics.inverse_dynamics(q, qd, qdd)
    dynamics.inverse_dynamics(other, qd, qdd)
    dynamics.jacobian_time_derivative(other, qd, TOOL)
    assert dynamics.inverse_dynamics(q, qd, qdd) == first


@pytest.mark.parametrize("wrong", [(0.0,) * 5, (0.0,) * 7])
def test_wrong_length_is_refused(wrong: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"dimension|size"):
        Dynamics(load_model("ur3")).gravity_torques(wrong)


def test_the_package_itself_does_not_load_pinocchio() -> None:
    code = "import sys, urproto.robots, urproto.robots.kinematics; sys.exit('pinocchio' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
