"""Excitation motions for identification: within bounds, from rest to rest, refused if there is no room."""

import numpy as np
import pytest

from client.errors import OutOfReachError
from client.identification.excitation import ExcitationBounds, excitation
from tests.rows import each_row
from urproto.robots import MODELS, kinematics_of, load_model

START = (0.0, -1.2, 1.0, -1.2, -1.57, 0.0)


@each_row("name", MODELS)
def test_every_joint_moves_both_ways_within_the_bounds(name):
    model, bounds = load_model(name), ExcitationBounds(0.4, 0.6, 2.0, 0.1)
    path = excitation(model, START, 30.0, bounds)
    way = path.q_rad - np.array(START)
    assert path.duration_s == 30.0
    assert np.abs(way).max() <= 0.4 + 1e-9
    assert np.abs(way[[0, -1]]).max() < 1e-9
    assert not path.qd_rad_s[[0, -1]].any()
    fine = path.at(np.arange(0.0, 30.0, 0.002))
    speed = np.gradient(fine, 0.002, axis=0)
    assert np.abs(speed).max() <= 0.6 * 1.05
    assert np.abs(np.gradient(speed, 0.002, axis=0)).max() <= 2.0 * 1.05
    assert (speed.max(axis=0) > 0.25).all()
    assert (speed.min(axis=0) < -0.25).all()
    kinematics = kinematics_of(model)
    lowest = min(min(kinematics.forward(q)[2], kinematics.elbow_position(q)[2]) for q in fine[::20].tolist())
    assert lowest > 0.1


def test_the_seed_chooses_the_motion():
    model = load_model("ur5e")
    one, same, other = (excitation(model, START, 20.0, seed=seed).q_rad for seed in (1, 1, 2))
    assert (one == same).all()
    assert (one != other).any()


def test_motions_without_room_are_refused():
    with pytest.raises(OutOfReachError, match="above 2 m and clear of itself: start elsewhere"):
        excitation(load_model("ur5e"), START, 20.0, ExcitationBounds(floor_m=2.0))
    folded = (0.0, -1.57, 2.6, -1.0, 1.57, 0.0)
    with pytest.raises(OutOfReachError, match="clear of itself"):
        excitation(load_model("ur5e"), folded, 20.0, ExcitationBounds(angle_rad=1.0, floor_m=-1.0))
