"""Plans stay within the robot's safety planes, as measured by the emulator."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ompl")

from scenes import samples

from client.errors import SceneError
from client.planning import JointGoal, Planner, PlanningScene, StartInCollisionError, read_safety
from urproto.robots import Joints, load_model
from urscript.polyscope.safety_configuration import (
    BoundaryMode,
    Plane,
    SafetyConfiguration,
    ToolSphere,
    factory_configuration,
)

TCP = (0.0, 0.0, 0.15, 0.0, 0.0, 0.0)
START = (-0.7, -1.2, 1.4, -1.7, -1.5, 0.0)
LOW_ELBOW = (-0.7, -0.3, -2.0, 0.73, -1.57, 0.0), (0.7, -0.3, -2.0, 0.73, -1.57, 0.0)
GOAL = (0.7, -1.2, 1.4, -1.7, -1.5, 0.0)


def configuration(*planes: Plane, spheres: tuple[ToolSphere, ...] = ()) -> SafetyConfiguration:
    factory = factory_configuration(load_model("ur5e"))
    return SafetyConfiguration(normal=factory.normal, reduced=factory.reduced, planes=planes, tool_spheres=spheres)


@pytest.mark.parametrize(
    ("plane", "start", "goal"),
    [
        (Plane("front", (1.0, 0.0, 0.0), 0.6, BoundaryMode.BOTH), START, GOAL),
        (Plane("front", (1.0, 0.0, 0.0), 0.52, BoundaryMode.BOTH, elbow=True), *LOW_ELBOW),
    ],
    ids=["tool", "elbow"],
)
def test_plans_stay_within_safety_planes(plane: Plane, start: Joints, goal: Joints) -> None:
    """The straight path takes the tool or the elbow beyond the plane."""
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    arm = scene.kinematics
    ball = ToolSphere((0.0, 0.05, 0.1), 0.04)

    def depth(q: np.ndarray) -> float:
        places = [plane.depth(arm.forward(q, TCP)[:3])]
        places.append(plane.depth(arm.forward(q, (*ball.centre, 0.0, 0.0, 0.0))[:3]) - ball.radius)
        if plane.elbow:
            elbow = arm.elbow_position(q, scene.model.elbow_offset)
            places.append(plane.depth(elbow) - scene.model.elbow_radius)
        return min(places)

    assert min(map(depth, samples(planner.plan(start, JointGoal(goal))))) < 0.0
    scene.set_safety(configuration(plane, spheres=(ball,)), TCP)
    plan = planner.plan(start, JointGoal(goal), time_limit_s=30.0)
    assert min(map(depth, samples(plan))) > scene.padding_m - 0.0015
    scene.set_safety(None)
    assert min(map(depth, samples(planner.plan(start, JointGoal(goal))))) < 0.0


def test_only_planes_of_the_active_mode_apply_to_what_they_restrict() -> None:
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    behind = 0.1  # the whole arm but its base is beyond it
    for mode, reduced, counts in (
        (BoundaryMode.NORMAL, False, True),
        (BoundaryMode.NORMAL, True, False),
        (BoundaryMode.REDUCED, False, False),
        (BoundaryMode.REDUCED, True, True),
        (BoundaryMode.BOTH, True, True),
        (BoundaryMode.TRIGGER, False, False),
    ):
        scene.set_safety(configuration(Plane("table", (0.0, 0.0, -1.0), behind, mode)), TCP, reduced=reduced)
        assert planner.checker.is_free(START) != counts
    scene.set_safety(configuration(Plane("table", (0.0, 0.0, -1.0), behind, BoundaryMode.BOTH)), TCP)
    with pytest.raises(StartInCollisionError, match=r"the TCP is .* mm deep in safety plane table"):
        planner.plan(START, JointGoal(GOAL))
    # the upper arm may cross a plane that restricts only the tool
    z = scene.kinematics.forward(START, TCP)[2]
    assert scene.kinematics.elbow_position(START)[2] > z + 0.2
    scene.set_safety(configuration(Plane("low", (0.0, 0.0, -1.0), z + 0.1, BoundaryMode.BOTH)), TCP)
    assert planner.checker.is_free(START)
    scene.set_safety(configuration(Plane("low", (0.0, 0.0, -1.0), z + 0.1, BoundaryMode.BOTH, elbow=True)), TCP)
    assert planner.checker.collisions(START)[0].one == "the elbow"


def test_planes_are_read_from_installations(tmp_path: Path) -> None:
    broken = tmp_path / "broken.installation"
    broken.write_text("no XML")
    with pytest.raises(SceneError, match=r"broken\.installation"):
        read_safety(broken)
    broken.write_text("<Installation/>")
    with pytest.raises(SceneError, match="has no safety settings"):
        read_safety(broken)
