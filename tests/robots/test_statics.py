"""Dynamics against hand-derived statics and the equations of motion."""

import random

import numpy as np
import pytest

from urproto.robots import MODELS, Kinematics, load_model
from urproto.robots.dynamics import Dynamics

GRAVITY = 9.82


@pytest.fixture(params=MODELS)
def model(request):
    return load_model(request.param)


def random_state(seed: str) -> list[list[float]]:
    chance = random.Random(seed)
    return [[chance.uniform(-2.0, 2.0) for _ in range(6)] for _ in range(3)]


def test_outstretched_ur3_calculated_manually() -> None:
    """All joints 0: the arm lies along -x, so the shoulder lift carries every mass times its lever.

    Link 2's centre is 0.24365 - 0.13 out, link 3's 0.24365 + 0.21325 - 0.05, the wrists are at the end, next to the
    plane but without an additional lever along x.
    """
    upper, forearm = 3.42 * (0.24365 - 0.13), 1.26 * (0.24365 + 0.21325 - 0.05)
    wrists = (0.8 + 0.8 + 0.35) * (0.24365 + 0.21325)
    expected = -GRAVITY * (upper + forearm + wrists)
    torques = Dynamics(load_model("ur3")).gravity_torques([0.0] * 6)
    assert torques[0] == pytest.approx(0.0, abs=1e-12)
    assert torques[1] == pytest.approx(expected, rel=1e-9)


def test_gravity_is_the_gradient_of_potential_energy(model) -> None:
    """The torque that holds the arm is dV/dq, with V only from the links' heights."""
    dynamics, step = Dynamics(model), 1e-6
    q = random_state(model.name)[0]
    torques = dynamics.gravity_torques(q)
    for joint in range(6):
        energies = []
        for sign in (1.0, -1.0):
            moved = list(q)
            moved[joint] += sign * step
            energies.append(potential_energy(model, moved))
        assert torques[joint] == pytest.approx((energies[0] - energies[1]) / (2 * step), abs=1e-5)


def potential_energy(model, q) -> float:
    frame, energy = np.eye(4), 0.0
    for link, a, d, alpha, theta in zip(model.links, model.dh.a, model.dh.d, model.dh.alpha, q, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        frame = frame @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
        energy += link.mass_kg * GRAVITY * (frame @ np.array([*link.com_m, 1.0]))[2]
    return energy


def test_equations_of_motion_agree(model) -> None:
    dynamics = Dynamics(model)
    dynamics.set_payload(1.5, (0.01, -0.02, 0.1), (0.01, 0.02, 0.015, 0.001, 0.0, -0.002))
    q, qd, qdd = random_state(model.name)
    torques = dynamics.inverse_dynamics(q, qd, qdd)
    parts = np.array(dynamics.mass_matrix(q)) @ qdd + dynamics.coriolis_torques(q, qd) + dynamics.gravity_torques(q)
    assert np.allclose(torques, parts)
    assert np.allclose(dynamics.forward_dynamics(q, qd, torques), qdd)


def test_payload_is_attached_to_the_flange(model) -> None:
    """The extra torque of a point mass is the Jacobian's, at the mass, times its weight."""
    dynamics, kinematics = Dynamics(model), Kinematics(model.dh)
    q, centre, mass = random_state(model.name)[0], (0.02, -0.01, 0.12), 2.0
    bare = np.array(dynamics.gravity_torques(q))
    dynamics.set_payload(mass, centre)
    extra = np.array(dynamics.gravity_torques(q)) - bare
    lever = np.array(kinematics.jacobian(q, (*centre, 0.0, 0.0, 0.0)))[2]
    assert np.allclose(extra, lever * mass * GRAVITY)
    dynamics.set_payload(0.0, (0.0, 0.0, 0.0))
    assert np.allclose(dynamics.gravity_torques(q), bare)


def test_momentum_is_mass_times_velocity_of_its_centre(model) -> None:
    """Only the base turns: the momentum is that of the centre of mass on its circle."""
    dynamics = Dynamics(model)
    q, step = random_state(model.name)[0], 1e-6
    centres = []
    for sign in (1.0, -1.0):
        moved = [q[0] + sign * step, *q[1:]]
        centres.append(weighted_centre(model, moved))
    assert dynamics.linear_momentum(q, [1.0, 0, 0, 0, 0, 0]) == pytest.approx(
        float(np.linalg.norm((centres[0] - centres[1]) / (2 * step))), rel=1e-6
    )


def weighted_centre(model, q) -> np.ndarray:
    frame, total = np.eye(4), np.zeros(3)
    for link, a, d, alpha, theta in zip(model.links, model.dh.a, model.dh.d, model.dh.alpha, q, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        frame = frame @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
        total += link.mass_kg * (frame @ np.array([*link.com_m, 1.0]))[:3]
    return total


def test_jacobian_time_derivative(model) -> None:
    dynamics, kinematics, tcp, step = Dynamics(model), Kinematics(model.dh), (0.1, 0.05, 0.2, 0, 0, 0), 1e-6
    q, qd, _ = random_state(model.name)
    ahead = np.array(kinematics.jacobian([a + step * b for a, b in zip(q, qd, strict=True)], tcp))
    behind = np.array(kinematics.jacobian([a - step * b for a, b in zip(q, qd, strict=True)], tcp))
    assert np.allclose(dynamics.jacobian_time_derivative(q, qd, tcp), (ahead - behind) / (2 * step), atol=1e-5)


def test_mounting_rotates_gravity() -> None:
    dynamics = Dynamics(load_model("ur5e"))
    q = random_state("mounting")[0]
    upright = np.array(dynamics.gravity_torques(q))
    dynamics.set_gravity((0.0, 0.0, -GRAVITY))
    assert np.allclose(dynamics.gravity_torques(q), -upright)
