"""Timing by closed forms, the candidates of a goal by enumeration, and distances that are known from the scene."""

from collections.abc import Callable
from math import inf, nan, sqrt, tau
from typing import Any

import numpy as np
import pytest

from tests.rows import each_row

pytest.importorskip("ompl")

from client.errors import PlanningError
from client.planning import CollisionChecker, JointGoal, PlanningScene, PoseGoal, Sphere
from client.planning.goals import GoalUnreachableError, goal_configurations
from client.planning.parameterisation import Limits, Trajectory, parameterise, subdivide

STEP_S = 0.01
UPRIGHT = (0.0, -1.6, 0.0, 0.0, 0.0, 0.0)
Q = (0.4, -1.3, 1.4, -1.6, -1.5, 0.2)


def straight(*lengths: float) -> Callable[[Any], Any]:
    """A path from 0 to 1 on which each joint moves by a length."""

    def path(s: Any) -> Any:
        way = np.array(lengths)
        return s[:, None] * way, np.ones((len(s), 1)) * way, np.zeros((len(s), len(lengths)))

    return path


def limits(v: float, a: float, j: float, count: int = 1) -> Limits:
    return Limits(*(np.full(count, value) for value in (v, a, j)))


def timed(path: Callable[[Any], Any], allowed: Limits, scalings: Any = None) -> Trajectory:
    return parameterise(path, np.linspace(0.0, 1.0, 401), allowed, step_s=STEP_S, scalings=scalings)


# length, limits of speed, acceleration and jerk
@each_row(
    ("length", "v", "a", "j"),
    [
        (2.0, 1.0, 5.0, 100.0),
        (-2.0, 1.0, 5.0, 100.0),
        (2.0, 0.5, 5.0, 100.0),
        (2.0, 1.0, 2.0, 100.0),
        (2.0, 1.0, 5.0, 20.0),
        (0.1, 9.0, 5.0, 200.0),
    ],
)
def test_a_straight_path_is_followed_as_fast_as_the_limits_allow(length: float, v: float, a: float, j: float) -> None:
    """The trapezoid of speed takes |l|/v + v/a, and the bounded jerk adds a/j.

    If the path is too short for a trapezoid, it takes 2 sqrt(|l|/a), and is slowed down by the cube root of 2, because
    the jerk between acceleration and braking is twice as large. Less than a/j is too short to reach a.
    """
    found = timed(straight(length, 0.3 * length), limits(v, a, j, 2))
    cruising = abs(length) > v * v / a
    slower = 1.0 if cruising else 2.0 ** (1.0 / 3.0)
    expected = ((abs(length) / v + v / a if cruising else 2.0 * sqrt(abs(length) / a)) + a / j) * slower
    assert found.duration_s == pytest.approx(expected, rel=0.03)
    assert (found.q[0], found.q[-1]) == (pytest.approx([0.0, 0.0]), pytest.approx([length, 0.3 * length], abs=1e-6))
    assert np.max(np.diff(found.times_s)) <= STEP_S + 1e-9
    for rates, most in ((found.qd, v), (found.qdd, a)):
        assert np.max(abs(rates)) <= most * (1.0 + 1e-6)
    if cruising:
        assert np.max(abs(found.qd[:, 0])) == pytest.approx(v, rel=1e-3)
    assert np.max(abs(found.qdd[:, 0])) == pytest.approx(min(a / slower**2, v * j / a), rel=0.05)
    assert (found.qd[[0, -1]], found.qdd[[0, -1]]) == (pytest.approx(0.0), pytest.approx(0.0, abs=1e-6))
    assert found.qd[1:-1] == pytest.approx(np.gradient(found.q, found.times_s, axis=0)[1:-1], abs=0.02 * v)
    assert found.qdd[1:-1] == pytest.approx(np.gradient(found.qd, found.times_s, axis=0)[1:-1], abs=0.2 * a)


def test_the_joint_with_the_tightest_limit_leads() -> None:
    allowed = Limits(np.array([1.0, 0.2]), np.array([5.0, 5.0]), np.array([200.0, 200.0]))
    found = timed(straight(1.0, 0.5), allowed)
    assert found.duration_s == pytest.approx(0.5 / 0.2 + 0.2 / 2.5, rel=0.05)
    assert np.max(abs(found.qd), axis=0) == pytest.approx([0.4, 0.2], rel=1e-3)


def test_scalings_apply_where_they_are_given() -> None:
    def slow_at_first(s: Any) -> Any:
        return np.where((s < 0.5)[:, None], [0.1, 1.0], [1.0, 1.0])

    found = timed(straight(2.0), limits(1.0, 5.0, 100.0), slow_at_first)
    first = found.q[:, 0] < 0.95
    fast, slow = np.max(abs(found.qd)), np.max(abs(found.qd[first]))
    assert slow == pytest.approx(0.1 * fast, rel=1e-2)
    assert 0.5 < fast <= 1.0


@each_row("share", [0.0, -0.5, 1.01, nan, inf])
def test_limits_are_only_reduced(share: float) -> None:
    allowed = limits(1.0, 5.0, 100.0)
    half = allowed.scaled(0.5, 0.25)
    assert (half.velocity[0], half.acceleration[0], half.jerk[0]) == (0.5, 1.25, 25.0)
    assert allowed.scaled(1.0, 1.0).velocity[0] == 1.0
    for wrong, name in (((share, 1.0), "velocity"), ((1.0, share), "acceleration")):
        with pytest.raises(PlanningError, match=f"the {name} scaling must be above 0 and at most 1"):
            allowed.scaled(*wrong)
    for bad in ([1.0], np.ones((1, 1)), np.array([1]), np.array([1.0, 0.0]), np.array([-1.0])):
        with pytest.raises(PlanningError, match="one number above 0 for each joint"):
            Limits(np.array([1.0]), bad, np.array([1.0]))  # type: ignore[arg-type]


def test_trajectories_follow_each_other_and_paths_are_divided() -> None:
    one, two = (timed(straight(length), limits(1.0, 5.0, 100.0)) for length in (1.0, 0.5))
    both = one.followed_by(two)
    assert both.duration_s == pytest.approx(one.duration_s + two.duration_s)
    assert len(both.times_s) == len(one.times_s) + len(two.times_s) - 1
    assert (np.diff(both.times_s) > 0.0).all()
    assert len(both.q) == len(both.qd) == len(both.qdd) == len(both.times_s)
    assert subdivide([2.0, 0.5], 2) == pytest.approx([0.0, 1.0, 2.0, 2.25, 2.5])


# goals


def enumerated(scene: PlanningScene, pose: Any, start: Any) -> set[tuple[float, ...]]:
    """Each solution with each joint as near to the start as its limits allow, or one joint turned once more the other
    way, if that moves it by 270 degrees at most."""
    low, high = scene.model.position_limits
    found = set()
    for solution in scene.kinematics.inverse_all(pose, start):
        turns = [
            [turned for n in (-2, -1, 0, 1, 2) if low[i] <= (turned := angle + tau * n) <= high[i]]
            for i, angle in enumerate(solution)
        ]
        near = [min(choice, key=lambda angle, i=i: abs(angle - start[i])) for i, choice in enumerate(turns)]
        found.add(tuple(near))
        for i, choice in enumerate(turns):
            for angle in choice:
                if angle != near[i] and abs(angle - start[i]) <= 0.75 * tau:
                    found.add((*near[:i], angle, *near[i + 1 :]))
    return {tuple(round(value, 6) for value in q) for q in found}


@each_row("start", [Q, (3.0, -1.0, 1.0, -2.0, 1.2, -3.1), (-6.0, -2.0, 0.5, 6.0, 1.0, 5.5)])
def test_a_pose_has_all_configurations_nearest_first(start: tuple[float, ...]) -> None:
    scene = PlanningScene("ur5e")
    checker = CollisionChecker(scene)
    pose = scene.kinematics.forward(Q)
    found = goal_configurations(PoseGoal(pose), start, checker)
    free = {q for q in enumerated(scene, pose, start) if checker.is_free(q)}
    assert {tuple(round(value, 6) for value in q) for q in found} == free
    far = [sum((a - b) ** 2 for a, b in zip(q, start, strict=True)) for q in found]
    assert far == sorted(far)
    assert len(free) > 8
    beyond = PoseGoal(pose, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    for q in goal_configurations(beyond, start, checker):
        assert scene.kinematics.forward(q, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)) == pytest.approx(pose, abs=1e-6)


@each_row("joint", range(6))
@each_row(("beyond", "allowed"), [(-1e-6, True), (1e-6, False)])
def test_joint_limits_of_a_goal(joint: int, beyond: float, allowed: bool) -> None:
    scene = PlanningScene("ur5e")
    names = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
    checker = CollisionChecker(scene)
    for edge, sign in zip(scene.model.position_limits, (-1.0, 1.0), strict=True):
        q = tuple(edge[i] + sign * beyond if i == joint else angle for i, angle in enumerate(UPRIGHT))
        assert (checker.violation(q) == "") is allowed
        assert checker.is_free(q) is allowed
        if allowed:
            assert goal_configurations(JointGoal(q), Q, checker) == [pytest.approx(q)]
        else:
            with pytest.raises(GoalUnreachableError, match=f"{names[joint]} would be at"):
                goal_configurations(JointGoal(q), Q, checker)


# distances


TOOL = (0.0, 0.0, 0.2, 0.0, 0.0, 0.0)
BALL_M, OBSTACLE_M = 0.05, 0.04


def opposite(distance_m: float, padding_m: float = 0.01) -> PlanningScene:
    """A ball on the flange, and an obstacle in front of it at a distance; nothing else is as near."""
    scene = PlanningScene("ur5e", padding_m=padding_m)
    there = scene.kinematics.forward(Q, (0.0, 0.0, TOOL[2] + BALL_M + distance_m + OBSTACLE_M, 0.0, 0.0, 0.0))
    scene.attach("ball", Sphere(BALL_M), TOOL)
    scene.add("obstacle", Sphere(OBSTACLE_M), there)
    return scene


@each_row("padding_m", [0.0, 0.01, 0.04])
@each_row(("beyond_m", "free"), [(-0.0002, False), (0.0002, True)])
def test_a_configuration_is_free_if_nothing_is_nearer_than_the_padding(
    padding_m: float, beyond_m: float, free: bool
) -> None:
    scene = opposite(padding_m + beyond_m, padding_m)
    checker = CollisionChecker(scene)
    pair = checker.distances(Q)[0]
    assert {pair.one, pair.other} == {"ball", "obstacle"}
    assert (pair.distance_m, checker.clearance(Q)) == (pytest.approx(padding_m + beyond_m, abs=1e-6),) * 2
    middle = scene.kinematics.forward(Q, (0.0, 0.0, TOOL[2] + BALL_M + 0.5 * pair.distance_m, 0.0, 0.0, 0.0))
    assert pair.point == pytest.approx(middle[:3], abs=1e-4)
    ends = [scene.objects["obstacle"].pose[:3], scene.kinematics.forward(Q, TOOL)[:3]]
    towards = np.subtract(*(ends if pair.other == "obstacle" else ends[::-1]))
    assert pair.normal == pytest.approx(towards / np.linalg.norm(towards), abs=1e-4)
    assert (checker.is_free(Q), not checker.collisions(Q), checker.violation(Q) == "") == (free,) * 3
    assert checker.path_is_free(Q, Q) is free
    scene.allow("ball", "obstacle")
    assert checker.is_free(Q), "the scene as it is now"
    scene.remove("obstacle")
    assert checker.clearance(Q) > padding_m + 0.01


@each_row("turn_rad", [0.3, -0.3])
@each_row("share", [0.1, 0.5, 0.9])
def test_a_motion_is_blocked_by_what_is_between_its_ends(turn_rad: float, share: float) -> None:
    scene = PlanningScene("ur5e")
    scene.attach("ball", Sphere(0.01), TOOL)
    end = (Q[0] + turn_rad, *Q[1:])
    place = scene.kinematics.forward((Q[0] + share * turn_rad, *Q[1:]), TOOL)
    scene.add("pin", Sphere(0.002), place)
    checker = CollisionChecker(scene)
    assert not checker.path_is_free(Q, end)
    start, delta = np.array(Q), np.array([turn_rad, *[0.0] * 5])
    at = checker.blocked_at(lambda way: start + way * delta, abs(delta))
    radius = float(np.hypot(*place[:2]))
    assert at is not None
    assert abs(at - share) * abs(turn_rad) * radius < 0.01 + 0.002 + scene.padding_m + 0.002
    scene.move("pin", (place[0], place[1], place[2] + 0.5, 0.0, 0.0, 0.0))
    assert checker.path_is_free(Q, end)
