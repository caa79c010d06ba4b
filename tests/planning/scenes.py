"""Three scenes scaled to the size of an arm, configurations in them, and dense samples of a plan."""

from random import Random

import numpy as np

from client.planning import Box, CollisionChecker, Plan, Plane, PlanningScene, Sphere
from urproto.robots import Joints, load_model

SCENES = ("table and wall", "shelf", "slot")
_TOOL_M = 0.03


def scene_of(name: str, model: str) -> PlanningScene:
    """One of the scenes, scaled by the arm's reach."""
    arm = load_model(model)
    scene = PlanningScene(arm)
    r = arm.reach_m
    scene.add("table", Plane(), (0.0, 0.0, -0.03, 0.0, 0.0, 0.0))
    if name == "table and wall":
        scene.add("wall", Box((0.05, 3.0 * r, 2.0 * r)), (0.8 * r, 0.0, r, 0.0, 0.0, 0.0))
        scene.add("board", Box((0.6 * r, 0.04, 0.5 * r)), (-0.7 * r, 0.0, 0.25 * r, 0.0, 0.0, 0.0))
    elif name == "shelf":
        for number, height in enumerate((0.2, 0.75, 1.3)):
            scene.add(f"board {number}", Box((0.4 * r, 1.2 * r, 0.03)), (0.85 * r, 0.0, height * r, 0.0, 0.0, 0.0))
        for number, side in enumerate((-0.6, 0.6)):
            scene.add(f"side {number}", Box((0.4 * r, 0.03, 1.1 * r)), (0.85 * r, side * r, 0.75 * r, 0.0, 0.0, 0.0))
    else:
        for number, side in enumerate((-1.0, 1.0)):  # two blocks with a gap between them, in front of the arm
            place = (0.75 * r, side * 0.55 * r, 0.5 * r, 0.0, 0.0, 0.0)
            scene.add(f"block {number}", Box((0.2 * r, 0.6 * r, r)), place)
    scene.attach("tool", Sphere(_TOOL_M), (0.0, 0.0, _TOOL_M, 0.0, 0.0, 0.0))
    return scene


def free_configurations(checker: CollisionChecker, random: Random, count: int) -> list[Joints]:
    """Free configurations as in normal use: above the table, any base angle, elbow and wrists bent either way."""
    found: list[Joints] = []
    while len(found) < count:
        q = (
            random.uniform(-3.1, 3.1),
            random.uniform(-3.1, 0.0),
            random.uniform(-2.6, 2.6),
            random.uniform(-3.1, 3.1),
            random.uniform(-2.6, 2.6),
            random.uniform(-3.1, 3.1),
        )
        if checker.is_free(q):
            found.append(q)
    return found


def samples(plan: Plan, count: int = 5) -> np.ndarray:
    """Samples of the quintic splines that a robot creates from the trajectory's points, ``count`` per interval."""
    trajectory, rows = plan.trajectory, []
    powers = np.arange(6)
    for i, step in enumerate(np.diff(trajectory.times_s)):
        known = np.array(
            [
                trajectory.q[i],
                trajectory.qd[i],
                trajectory.qdd[i],
                trajectory.q[i + 1],
                trajectory.qd[i + 1],
                trajectory.qdd[i + 1],
            ]
        )
        equations = np.array(
            [
                [1, 0, 0, 0, 0, 0],
                [0, 1, 0, 0, 0, 0],
                [0, 0, 2, 0, 0, 0],
                step**powers,
                powers * step ** np.maximum(powers - 1, 0),
                powers * (powers - 1) * step ** np.maximum(powers - 2, 0),
            ],
            dtype=float,
        )
        spline = np.linalg.solve(equations, known)
        rows += [(share * step) ** powers @ spline for share in np.linspace(0.0, 1.0, count, endpoint=False)]
    return np.array([*rows, trajectory.q[-1]])
