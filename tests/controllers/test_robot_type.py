"""The type of the arm that a driver is told, and those that robots report."""

from types import SimpleNamespace

import pytest

from client.controllers.running import _check_type
from tests.rows import each_row
from urproto.errors import RobotRefused
from urproto.robots import UnknownModelError, load_model


def control(name: str | None):
    model = load_model(name) if name else None
    arm = model and SimpleNamespace(
        robot_type=model.robot_type,
        sub_type=model.sub_type,
        dh_a=model.dh.a,
        dh_d=model.dh.d,
        dh_alpha=model.dh.alpha,
        dh_theta=model.dh.theta,
    )
    return SimpleNamespace(driver=SimpleNamespace(link=SimpleNamespace(configuration=arm)))


@each_row(
    ("robot", "wanted"),
    [
        ("ur3", "ur3"),
        ("ur5e", "ur7e"),
        ("ur7e", "ur5e"),
        ("ur12e", "ur10e"),
        ("ur20", "ur20"),
        ("ur3", ""),
        (None, "ur3"),
    ],
)
def test_an_arm_of_the_type_is_accepted(robot, wanted):
    """Source of the types that share their number: robotTypeFromString of the official driver, July 2026."""
    _check_type(control(robot), wanted)


@each_row(
    ("robot", "wanted", "words"),
    [
        ("ur5e", "ur5", "it is a UR5e, not a UR5"),
        ("ur3e", "ur3", "it is a UR3e, not a UR3"),
        ("ur5e", "ur20", "it is a UR5e, not a UR20"),
    ],
)
def test_an_arm_of_another_type_is_refused(robot, wanted, words):
    with pytest.raises(RobotRefused, match=words):
        _check_type(control(robot), wanted)


def test_an_unknown_type_is_named():
    with pytest.raises(UnknownModelError, match="ur4"):
        _check_type(control("ur5e"), "ur4")
