"""The data files: complete, physically possible, and the figures that clients compare."""

import math

import numpy as np
import pytest

from urproto.robots import MODELS, UnknownModel, load_model
from urproto.versions import Series


@pytest.mark.parametrize("name", MODELS)
def test_links_are_physical(name) -> None:
    for link in load_model(name).links:
        xx, yy, zz, xy, xz, yz = link.inertia_kg_m2
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert link.mass_kg > 0.0
        assert moments[0] > 0.0
        assert moments[2] < (moments[0] + moments[1]) * 1.05, "no body is thinner than a plate"


@pytest.mark.parametrize("name", MODELS)
def test_long_links_are_slender_along_their_length(name) -> None:
    """Upper arm and forearm run along x of their DH frames, so Ixx is the smallest moment."""
    for link in load_model(name).links[1:3]:
        xx, yy, zz, _, _, _ = link.inertia_kg_m2
        assert xx < yy
        assert xx < zz


def test_ur3_is_the_one_drivers_ship() -> None:
    model = load_model("ur3")
    assert model.dh.d[0] == 0.1519
    assert model.series is Series.CB3
    assert model.qd_max == pytest.approx([math.pi] * 3 + [2 * math.pi] * 3)
    assert (model.robot_type, model.sub_type, model.controller_box) == (3, 2, 6)


def test_total_masses() -> None:
    """Sums given beside the masses in the kinematics sheet."""
    totals = {"ur3": 8.630, "ur5": 17.049, "ur10": 28.435, "ur3e": 8.798, "ur5e": 17.700, "ur20": 60.960}
    for name, total in totals.items():
        assert sum(link.mass_kg for link in load_model(name).links) == pytest.approx(total, abs=1e-3)


def test_unknown_model_lists_the_known() -> None:
    with pytest.raises(UnknownModel, match=r"unknown robot model 'ur4'.*ur3, ur5"):
        load_model("ur4")
