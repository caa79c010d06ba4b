"""The data files: complete, checked, and physically possible."""

import re
from dataclasses import FrozenInstanceError
from math import radians

import numpy as np
import pytest

from tests.rows import each_row
from urproto.robots import MODELS, START_Q, Link, RobotModel, UnknownModelError, load_model
from urproto.robots.model import _DATA
from urproto.versions import Series

UR3_TEXT = (_DATA / "ur3.toml").read_text(encoding="utf-8")


def tensor(link: Link) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = link.inertia_kg_m2
    return np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def test_all_arms_are_there() -> None:
    assert " ".join(MODELS) == "ur3 ur3e ur5 ur5e ur7e ur8long ur10 ur10e ur12e ur15 ur16e ur18 ur20 ur30"


def test_series() -> None:
    assert {name for name in MODELS if load_model(name).series is Series.CB3} == {"ur3", "ur5", "ur10"}


def test_ur3_shoulder_height() -> None:
    assert load_model("ur3").dh.d[0] == 0.1519


def test_ur5e_matches_its_simulator() -> None:
    # configuration data captured from a UR5e simulator 5.24; speeds there carry 0.2 rad/s on top
    model = load_model("ur5e")
    assert (model.robot_type, model.sub_type, model.controller_box) == (1, 3, 4)
    assert model.q_max == pytest.approx((6.3355451848,) * 6)
    assert model.q_min == tuple(-q for q in model.q_max)
    assert model.qd_max == pytest.approx((3.341592653589793 - 0.2,) * 6)
    assert model.qdd_max == (40.0,) * 6
    assert (model.v_joint_default, model.a_joint_default) == (1.0471975511965976, 1.3962634015954636)
    assert (model.v_tool_default, model.a_tool_default, model.eq_radius) == (0.25, 1.2, 0.25)


@each_row(
    ("name", "total_kg"),
    # sums of the masses of the moving links in Universal_Robots_ROS2_Description
    [
        ("ur3", 8.63),
        ("ur5", 17.0489),
        ("ur10", 28.435),
        ("ur3e", 8.7985),
        ("ur16e", 27.26),
        ("ur20", 60.96),
        ("ur15", 36.2578),
        ("ur18", 34.9517),
        ("ur8long", 39.9439),
    ],
)
def test_moving_mass(name: str, total_kg: float) -> None:
    assert sum(link.mass_kg for link in load_model(name).links) == pytest.approx(total_kg)


@each_row("name", MODELS)
def test_plausible(name: str) -> None:
    model = load_model(name)
    assert model.title.lower().replace(" ", "") == model.name == name
    reach = -model.dh.a[1] - model.dh.a[2]
    assert 0.8 * model.reach_m < reach + model.dh.d[4] < 1.25 * model.reach_m
    assert all(low <= q <= high for low, q, high in zip(model.q_min, START_Q, model.q_max, strict=True))
    assert all(radians(90) < speed <= radians(360) for speed in model.qd_max)
    assert all(value > 0.0 for value in (*model.torque_max, *model.torque_constants, model.payload_max_kg))


@each_row("name", MODELS)
def test_inertias_are_physically_possible(name: str) -> None:
    for link in load_model(name).links:
        smallest, middle, largest = np.linalg.eigvalsh(tensor(link))
        assert smallest > 0.0
        assert smallest + middle >= largest * (1 - 1e-9)  # no body is flatter than flat


@each_row("name", MODELS)
@each_row("index", [1, 2])
def test_long_links_lie_along_their_x_axis(name: str, index: int) -> None:
    link = load_model(name).links[index]
    moments, axes = np.linalg.eigh(tensor(link))
    assert abs(axes[0, 0]) > np.cos(radians(10)), "least inertia about the length of the link"
    assert moments[0] < 0.6 * moments[1]
    # x runs against the link (a is negative): the centre of mass lies between its two joints
    assert 0.0 < link.com_m[0] < -load_model(name).dh.a[index]
    assert abs(link.com_m[1]) < 0.001


@each_row("name", MODELS)
def test_every_number_has_a_source(name: str) -> None:
    """A comment is on the line, or at the beginning of its block of lines (or the mass section)."""
    covered = False
    for line in (_DATA / f"{name}.toml").read_text(encoding="utf-8").split("[[links]]")[0].splitlines():
        if not line or line.startswith("["):
            covered = False
        elif line.startswith("#"):
            covered = True
        elif re.search(r"= .*\d", line) and '"' not in line:
            assert covered or "#" in line, line


def test_unknown_model_lists_the_known() -> None:
    with pytest.raises(UnknownModelError, match=r"'ur4': choose one of ur3, ur3e, .*, ur30") as caught:
        load_model("ur4")
    assert caught.value.name == "ur4"


def test_a_name_is_not_a_path() -> None:
    with pytest.raises(UnknownModelError):
        load_model("../data/ur3")


def test_models_are_shared_and_immutable() -> None:
    model = load_model("ur3")
    assert load_model("ur3") is model
    with pytest.raises(FrozenInstanceError):
        model.name = "mine"  # type: ignore[misc]  # the point of the test


@each_row(
    ("before", "after", "complaint"),
    [
        ("reach_m = 0.5", "", r"ur3.toml: reach_m is missing"),
        ("reach_m = 0.5", 'reach_m = "far"', r"ur3.toml: reach_m must be a number, not text"),
        ("reach_m = 0.5", "reach_m = true", r"ur3.toml: reach_m must be a number, not true or false"),
        ("robot_type = 3", "robot_type = 3.5", r"ur3.toml: robot_type must be a whole number"),
        ("wrist3_unlimited = true", "wrist3_unlimited = 1", r"wrist3_unlimited must be true or false"),
        ("a = [0.0, ", "a = [", r"ur3.toml: dh.a must be a list of length 6, not 5"),
        ("com_m = [0.13, ", 'com_m = ["?", ', r"links\[1\].com_m\[0\] must be a number, not text"),
        ("[shape]", "[form]", r"ur3.toml: tube_offsets is missing"),
        ("base_light = false", "", r"ur3.toml: base_light is missing"),
        ("[electrics]", "[electric]", r"ur3.toml: torque_constants is missing"),
        ("[[links]]  # wrist_3", "[[toes]]", r"ur3.toml: links must be a list of length 6, not 5"),
        ('"CB3"', '"CB4"', r"ur3.toml: series: unknown 'CB4'; allowed are CB3, e-Series"),
    ],
)
def test_an_invalid_file_is_reported_with_the_entry(before: str, after: str, complaint: str) -> None:
    assert before in UR3_TEXT
    with pytest.raises(ValueError, match=complaint):
        RobotModel.from_toml(UR3_TEXT.replace(before, after, 1), "ur3")


@pytest.mark.parametrize("name", ["ur3", "ur3e"])
def test_the_wrists_of_the_smallest_arms_accelerate_faster(name: str) -> None:
    """a_max of joint size 0: configuration files of URSim 3.5.0 and of a UR5e's controller."""
    assert load_model(name).qdd_max == (40.0, 40.0, 40.0, 80.0, 80.0, 80.0)


# torque constants of the motors by joint size, as in the configuration files of a UR5e's controller (2023), but for the
# smallest, which a recording of a UR3e simulator shows; the gears are 101:1
MOTORS_NM_A = {0: 0.037543, 1: 0.07695, 2: 0.10756, 3: 0.098322, 4: 0.11968}


@each_row(
    ("name", "sizes"),
    [
        ("ur3e", (2, 2, 1, 0, 0, 0)),
        ("ur5e", (3, 3, 3, 1, 1, 1)),
        ("ur7e", (3, 3, 3, 1, 1, 1)),
        ("ur10e", (4, 4, 3, 2, 2, 2)),
        ("ur12e", (4, 4, 3, 2, 2, 2)),
        ("ur16e", (4, 4, 3, 2, 2, 2)),
    ],
)
def test_torque_constants_of_e_series_joints(name: str, sizes: tuple[int, ...]) -> None:
    expected = [101 * MOTORS_NM_A[size] for size in sizes]
    assert load_model(name).torque_constants == pytest.approx(expected, rel=2e-4)
