"""A tool that must stay level, or in a box, does so along the whole path, for every planner."""

from math import acos, pi

import numpy as np
import pytest

pytest.importorskip("ompl")

from scenes import samples

from client.errors import PlanningError
from client.planning import (
    Box,
    GoalUnreachableError,
    IncompletePathError,
    JointGoal,
    OrientationConstraint,
    PathConstraints,
    Planner,
    PlanningScene,
    PoseGoal,
    PositionConstraint,
    StartInCollisionError,
)
from client.planning.constraints import ConstrainedChecker
from client.planning.search import TaskSpaceSearch
from urproto.robots import Kinematics, load_model
from urproto.robots.pose import pose_inv, pose_trans, rotvec_to_matrix

TCP = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
DOWN = (0.0, pi, 0.0)
AHEAD = (0.0, pi / 2, 0.0)
TILT = 0.1


def tilts(plan: object, axis: tuple[float, float, float]) -> list[float]:
    """The angle between the tool's z axis and this one."""
    arm = Kinematics(load_model("ur5e").dh)
    directions = [np.array(rotvec_to_matrix(*arm.forward(q, TCP)[3:]))[2::3] for q in samples(plan, 3)]
    return [acos(max(-1.0, min(1.0, float(direction @ np.array(axis))))) for direction in directions]


def reaching(scene: PlanningScene, pose: tuple[float, ...]) -> tuple[float, ...]:
    """An elbow-up configuration for this pose."""
    configurations = scene.kinematics.inverse_all(pose_trans(pose, pose_inv(TCP)))
    return min(configurations, key=lambda q: (abs(q[1] + 1.2) + abs(q[2] - 1.5), q[4]))


def test_a_level_tool_stays_level_around_a_post() -> None:
    scene = PlanningScene("ur5e")
    scene.add("post", Box((0.12, 0.12, 1.0)), (-0.45, 0.0, 0.5, 0.0, 0.0, 0.0))
    scene.add("wall", Box((0.05, 2.0, 2.0)), (0.3, 0.0, 1.0, 0.0, 0.0, 0.0))
    planner = Planner(scene)
    start = reaching(scene, (-0.45, 0.35, 0.3, *DOWN))
    goal = PoseGoal((-0.45, -0.35, 0.25, *DOWN), TCP)
    level = PathConstraints(OrientationConstraint(DOWN, (TILT, TILT, pi)), tcp_offset=TCP)
    assert not planner.checker.path_is_free(start, reaching(scene, goal.pose))
    plan = planner.plan(start, goal, path_constraints=level, time_limit_s=30.0)
    assert max(tilts(plan, (0.0, 0.0, -1.0))) < TILT * 2**0.5 + 1e-3
    assert len(plan.path) > 2
    assert (abs(plan.trajectory.qd) <= planner.limits.velocity * 1.001).all()
    pose = scene.kinematics.forward(plan.path[-1], TCP)
    assert pose[:3] == pytest.approx(goal.pose[:3], abs=1e-5)


def test_poses_are_sampled_if_no_joint_is_constant() -> None:
    """A tool that points forward into a shelf, above and below a board, so a straight line in joint space is
    impossible."""
    scene = PlanningScene("ur5e")
    scene.add("board", Box((0.3, 0.6, 0.03)), (0.75, 0.0, 0.45, 0.0, 0.0, 0.0))
    constraints = PathConstraints(OrientationConstraint(AHEAD, (TILT, TILT, TILT)), tcp_offset=TCP)
    planner = Planner(scene)
    start = reaching(scene, (0.6, 0.1, 0.6, *AHEAD))
    checker = ConstrainedChecker(scene, constraints)
    pose = (0.6, -0.1, 0.3, *AHEAD)
    goals = scene.kinematics.inverse_all(scene.kinematics.forward(reaching(scene, pose)))
    found = TaskSpaceSearch(checker, start, goals, True).find("RRTConnect", 20.0, 0)
    assert found is not None
    assert found.path is not None
    for s in np.linspace(0.0, found.path.length, 300):
        assert checker.is_free(found.path.at(float(s))[:6])
    plan = planner.plan(start, PoseGoal(pose, TCP), path_constraints=constraints, time_limit_s=30.0)
    assert max(tilts(plan, (1.0, 0.0, 0.0))) < TILT * 3**0.5


def test_the_tcp_stays_in_its_box() -> None:
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    start, goal = (reaching(scene, (-0.4, y, 0.3, *DOWN)) for y in (0.4, -0.4))
    away = [scene.kinematics.forward(q, TCP)[0] for q in samples(planner.plan(start, JointGoal(goal), planner="PTP"))]
    assert min(away) < -0.5  # in an arc about the base
    box = PathConstraints(None, PositionConstraint((0.12, 1.0, 0.3), (-0.4, 0.0, 0.3, 0.0, 0.0, 0.0)), TCP)
    plan = planner.plan(start, PoseGoal((-0.4, -0.4, 0.3, *DOWN), TCP), path_constraints=box, time_limit_s=30.0)
    for q in samples(plan):
        x, y, z, *_ = scene.kinematics.forward(q, TCP)
        assert abs(x + 0.4) < 0.061
        assert abs(y) < 0.501
        assert abs(z - 0.3) < 0.151


def test_violated_constraints_are_reported() -> None:
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    start = reaching(scene, (-0.45, 0.3, 0.3, *DOWN))
    level = PathConstraints(OrientationConstraint(DOWN, (TILT, TILT, pi)), tcp_offset=TCP)
    tilted = (*start[:3], start[3] + 0.3, *start[4:])
    with pytest.raises(StartInCollisionError, match=r"start here: the TCP is rotated about [xy] by 0\.\d+ rad more"):
        planner.plan(tilted, JointGoal(start), path_constraints=level)
    with pytest.raises(GoalUnreachableError, match=r"rotated about [xy] by 0\.\d+ rad more than the constraint allows"):
        planner.plan(start, JointGoal(tilted), path_constraints=level)
    box = PathConstraints(None, PositionConstraint((0.2, 0.2, 0.2), (-0.45, 0.3, 0.3, 0.0, 0.0, 0.0)), TCP)
    with pytest.raises(IncompletePathError, match=r"LIN is free for .* the TCP is displaced along y by .* mm more"):
        planner.plan(start, PoseGoal((-0.45, -0.1, 0.3, *DOWN), TCP), planner="LIN", path_constraints=box)
    plan, fraction = planner.compute_cartesian_path(
        start, [(-0.45, 0.1, 0.3, *DOWN)], tcp_offset=TCP, path_constraints=box
    )
    assert fraction == pytest.approx(0.5, abs=0.06)
    assert "the TCP is displaced along y" in plan.stopped_by
    for wrong, why in (
        (lambda: OrientationConstraint(DOWN, (0.1, -0.1, 0.1)), "from 0 to"),
        (lambda: OrientationConstraint(DOWN, (2.0, 0.1, 0.1)), "below pi/2"),
        (lambda: PositionConstraint((0.1, 0.1, float("nan"))), "edge lengths: 3 numbers above 0"),
        (lambda: PositionConstraint((0.1, 0.1, 0.1), (0.0,) * 5), "a pose: 6 numbers"),
    ):
        with pytest.raises(PlanningError, match=why):
            wrong()
