"""The shapes that planning uses for the arm, and the pairs of links that are checked."""

from random import Random

import pytest

from tests.rows import each_row

pytest.importorskip("coal")

from clearance import Clearance
from scenes import scene_of

from client.planning import CollisionChecker, PlanningScene
from urproto.robots import MODELS, load_model
from urproto.robots.model import LinkCylinders


@each_row("model", MODELS)
def test_a_folded_arm_touches_itself(model: str) -> None:
    """Wrist 1 meets the upper arm, which the elbow's own limits do not prevent."""
    checker = CollisionChecker(PlanningScene(model))
    assert "wrist_1_link" in checker.violation((0.0, -1.5, 3.0, -1.5, 1.5, 0.0))
    assert checker.is_free((0.0, -1.5, 1.5, -1.5, 1.5, 0.0))


@each_row("model", MODELS)
def test_cylinders_meet_at_the_joints(model: str) -> None:
    arm = load_model(model)
    links: tuple[LinkCylinders, ...] = arm.cylinders
    assert links[2].tube.high > -arm.dh.a[1]
    assert links[3].tube.high > -arm.dh.a[2]
    for link in links[2:4]:
        assert link.joint.low < link.tube_height < link.joint.high
    assert links[6].joint.high <= 0.001  # the flange


@pytest.mark.parametrize("model", ["ur3", "ur20"])
def test_distances_match_independent_geometry(model: str) -> None:
    """Points on the same cylinders, calculated independently by the tests."""
    scene = scene_of("shelf", model)
    checker, clearance = CollisionChecker(scene), Clearance(load_model(model), scene)
    around = {name for name, obj in scene.objects.items() if not obj.attached}
    random, seen = Random(model), 0
    while seen < 30:
        q = tuple(random.uniform(-2.5, 2.5) for _ in range(6))
        if checker.is_free(q):
            seen += 1
            nearest = next(pair for pair in checker.distances(q) if {pair.one, pair.other} & around)
            assert clearance(q) == pytest.approx(nearest.distance_m, abs=2e-3)
