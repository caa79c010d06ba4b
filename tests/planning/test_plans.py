"""Plans keep clear of everything, by geometry independent of the planner, and keep the joints' limits."""

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.budget import subset
from tests.rows import each_row

pytest.importorskip("ompl")

from clearance import Clearance
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import SCENES, free_configurations, samples, scene_of

from client.errors import PlanningError, SceneError
from client.planning import (
    Box,
    CollisionChecker,
    GoalSet,
    GoalUnreachableError,
    JointGoal,
    NamedGoal,
    NoPathError,
    Plane,
    Planner,
    PlanningScene,
    PoseGoal,
    Sphere,
    StartInCollisionError,
)
from urproto.robots import MODELS, START_Q, Kinematics, load_model

NEAR = 1e-6


@pytest.mark.parametrize("place", SCENES)
@pytest.mark.parametrize("model", subset(["ur3", "ur10e"], now=["ur3"]))
def test_plans_keep_clear_and_within_the_limits(model: str, place: str) -> None:
    scene = scene_of(place, model)
    planner = Planner(scene)
    clearance = Clearance(load_model(model), scene)
    configurations = free_configurations(planner.checker, Random(f"{model} {place}"), 8)
    found = 0
    for number in range(4):
        start, goal = configurations[2 * number : 2 * number + 2]
        try:
            plan = planner.plan(start, JointGoal(goal), seed=number, time_limit_s=20.0)
        except NoPathError:
            continue
        found += 1
        assert plan.trajectory.q[0] == pytest.approx(start, abs=NEAR)
        assert plan.trajectory.q[-1] == pytest.approx(goal, abs=NEAR)
        assert not plan.trajectory.qd[[0, -1]].any()
        nearest = min(clearance(q) for q in samples(plan))
        assert nearest > scene.padding_m - 0.001, f"{number}: {nearest}"
        step = np.diff(plan.trajectory.times_s)[:, None]
        for values, rates, limit in (
            (plan.trajectory.q, plan.trajectory.qd, planner.limits.velocity),
            (plan.trajectory.qd, plan.trajectory.qdd, planner.limits.acceleration),
        ):
            assert (abs(rates) <= limit * (1 + NEAR)).all()
            assert (abs(np.diff(values, axis=0) / step) <= limit * 1.01).all()
        assert (abs(np.diff(plan.trajectory.qdd, axis=0) / step) <= planner.limits.jerk * 1.01).all()
    assert found >= 3


def test_a_seed_gives_the_same_plan_again() -> None:
    planner = Planner(scene_of("slot", "ur3"))
    start, goal = free_configurations(planner.checker, Random(5), 2)
    one, other = (planner.plan(start, JointGoal(goal), seed=3, time_limit_s=20.0) for _ in range(2))
    assert one.path == other.path
    assert (one.trajectory.q == other.trajectory.q).all()


@each_row("planner", ["RRTConnect", "RRTstar", "PRM"])
def test_each_planner_finds_a_path_around_a_post(planner: str) -> None:
    scene = PlanningScene("ur3")
    scene.add("post", Box((0.1, 0.1, 1.0)), (0.3, 0.0, 0.5, 0.0, 0.0, 0.0))
    start, goal = (2.0, -1.0, 1.5, -1.0, 0.5, 0.0), (4.2, -1.0, 1.5, -1.0, 0.5, 0.0)
    assert not CollisionChecker(scene).path_is_free(start, goal)
    plan = Planner(scene).plan(
        start, JointGoal(goal), planner=planner, time_limit_s=5.0 if planner == "RRTstar" else 20.0
    )
    clearance = Clearance(load_model("ur3"), scene)
    assert min(clearance(q) for q in samples(plan)) > scene.padding_m - 0.001


@each_row("model", MODELS)
def test_poses_are_reached_by_any_configuration(model: str) -> None:
    arm = load_model(model)
    tcp = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    q = (0.4, -1.3, 1.4, -1.6, -1.5, 0.2)
    pose = Kinematics(arm.dh).forward(q, tcp)
    plan = Planner(PlanningScene(arm)).plan((0.4 + np.pi, -1.3, 1.4, -1.6, -1.5, 0.2), PoseGoal(pose, tcp))
    assert Kinematics(arm.dh).forward(plan.path[-1], tcp) == pytest.approx(pose, abs=1e-6)


def test_named_configurations_match_moveit() -> None:
    plan = Planner(PlanningScene("ur5e")).plan(START_Q, NamedGoal("up"))
    assert plan.path[-1] == pytest.approx((0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0))


def test_the_reachable_goal_of_a_set_is_planned() -> None:
    planner, far = Planner(PlanningScene("ur5e")), PoseGoal((2.0, 0.0, 0.3, 0.0, 3.1, 0.0))
    near = JointGoal((0.1, *START_Q[1:]))
    for goals in ([far, NamedGoal("up"), near], [near, NamedGoal("up"), far]):
        assert planner.plan(START_Q, GoalSet(goals)).path[-1] == pytest.approx(near.q_rad)
    with pytest.raises(
        GoalUnreachableError, match=r"none of 2 goals can be reached: goal 1: .* reach of .*; goal 2: .*"
    ):
        planner.plan(START_Q, GoalSet([far, NamedGoal("sleep")]))
    with pytest.raises(PlanningError, match="a GoalSet needs at least one goal"):
        GoalSet([])
    with pytest.raises(PlanningError, match="LIN needs a pose"):
        planner.plan(START_Q, GoalSet([near]), planner="LIN")


def test_impossible_plans_are_refused_with_the_reason() -> None:
    scene = PlanningScene("ur3")
    scene.add("table", Plane(), (0.0, 0.0, -0.03, 0.0, 0.0, 0.0))
    scene.add("box", Box((0.2, 0.2, 0.4)), (0.3, 0.0, 0.2, 0.0, 0.0, 0.0))
    planner = Planner(scene)
    above = (0.0, -1.9, 0.5, -1.5, -1.5, 0.0)
    with pytest.raises(StartInCollisionError, match=r"cannot start here: \w+_link is .* mm (deep in|from) table"):
        planner.plan((0.0, 0.6, 0.2, 0.0, 0.0, 0.0), JointGoal(above))
    with pytest.raises(GoalUnreachableError, match=r"out of the reach of a UR3"):
        planner.plan(above, PoseGoal((2.0, 0.0, 0.3, 0.0, 3.1, 0.0)))
    with pytest.raises(GoalUnreachableError, match=r"elbow would be at 9.0000 rad, its limits are"):
        planner.plan(above, JointGoal((0.0, -1.5, 9.0, 0.0, 0.0, 0.0)))
    with pytest.raises(GoalUnreachableError, match=r"deep in (table|box)"):
        planner.plan(above, JointGoal((0.0, 0.6, 0.2, 0.0, 0.0, 0.0)))
    with pytest.raises(GoalUnreachableError, match="unknown configuration 'sleep': choose one of home, up"):
        planner.plan(above, NamedGoal("sleep"))
    with pytest.raises(PlanningError, match="velocity scaling: above 0 and up to 1, not 2"):
        planner.plan(above, NamedGoal("up"), velocity_scaling=2.0)
    nan = float("nan")
    for wrong, message in (
        ({"planner": "A*"}, "unknown planner 'A\\*': choose one of RRTConnect"),
        ({"seed": -1}, "a seed: a whole number from 0"),
        ({"seed": 2**31}, "a seed: a whole number from 0"),  # OMPL takes 32 bits
        ({"time_limit_s": nan}, "a time limit: above 0"),
        ({"start_rad": (nan, *above[1:])}, "joint angles: 6 numbers .* not .nan"),
        ({"start_rad": above[1:]}, "joint angles: 6 numbers"),
    ):
        with pytest.raises(PlanningError, match=message):
            planner.plan(**({"start_rad": above, "goal": NamedGoal("up")} | wrong))


def test_a_failed_search_reports_what_was_tried() -> None:
    """The shoulder, which is offset from the base's axis, cannot pass these walls."""
    scene = PlanningScene("ur3")
    for number, side in enumerate((-1.0, 1.0)):
        scene.add(f"wall {number}", Box((1.4, 0.02, 3.0)), (side * 0.8, 0.0, 0.0, 0.0, 0.0, 0.0))
    planner = Planner(scene)
    (q,) = free_configurations(planner.checker, Random(1), 1)
    with pytest.raises(NoPathError, match=r"RRTConnect searched for one to 1 configuration .* padding is 10 mm"):
        planner.plan(q, JointGoal((q[0] - np.copysign(np.pi, q[0]), *q[1:])), time_limit_s=0.3)


def test_a_path_in_collision_between_two_checks_is_not_the_last_attempt() -> None:
    """With this seed, the first paths are in collision at any resolution."""
    start = (0.2111106006283685, -2.5909163579147267, 1.1463831298044607, -1.62657327, 0.26685483958120493, -1.22441638)
    goal = (1.0548333969381773, -2.2623695889905715, -2.396985062573857, 1.9316017931364171, 0.80756918465, 1.72507299)
    plan = Planner(scene_of("slot", "ur20")).plan(start, JointGoal(goal), seed=187)
    assert len(plan.path) > 2


def test_objects_are_picked_and_placed() -> None:
    scene = PlanningScene("ur3")
    q = (0.4, -1.3, 1.4, -1.6, -1.5, 0.2)
    flange = scene.kinematics.forward(q)
    scene.add("part", Sphere(0.04), flange)
    scene.pick("part", q)
    assert scene.objects["part"].attached
    assert scene.objects["part"].pose == pytest.approx((0.0,) * 6, abs=1e-9)
    there = (1.4, *q[1:])
    scene.place("part", there)
    assert scene.objects["part"].pose == pytest.approx(scene.kinematics.forward(there), abs=1e-9)
    checker = CollisionChecker(scene)
    assert not checker.is_free(there)
    scene.allow("part", "wrist_3_link")
    scene.allow("part", "wrist_2_link")
    assert checker.is_free(there)
    assert list(scene.allowed) == [("part", "wrist_2_link"), ("part", "wrist_3_link")]
    scene.remove("part")
    with pytest.raises(SceneError, match="the scene has no object 'part'; it has none"):
        scene.allow("part", "wrist_3_link")


def test_scenes_are_read_from_world_files(tmp_path: Path) -> None:
    examples = Path(__file__).parents[2] / "examples"
    scene = PlanningScene.read("ur3", examples / "table.yaml")
    assert set(scene.objects) == {"table", "block", "ball", "tool"}
    assert scene.objects["tool"].attached
    beyond = PlanningScene.read("ur3", examples / "table.yaml", tcp_offset=(0.0, 0.02, 0.1, 0.0, 0.0, 0.0))
    x, y, z, *_ = scene.objects["tool"].pose  # the file states it relative to the TCP
    assert beyond.objects["tool"].pose[:3] == pytest.approx((x, y + 0.02, z + 0.1))
    bad = tmp_path / "bad.yaml"
    for text, why in (
        ("objects: {a: {box: [1, 2]}}", "box must be a list of length 3"),
        ("objects: {a: {box: [0, 1, 1]}}", "a: edge lengths: 3 numbers above 0"),
        ("objects: {a: {sphere: .inf}}", "objects.a.sphere must be a finite number"),
        ("objects: {a: {sphere: 1, plane: {}}}", "must have exactly one of"),
        ("objects: {a: {sphere: 1, weight: 1}}", "has 'weight'"),
        ("objects: {upper_arm_link: {sphere: 1}}", "the name of a link"),
        ("objects: {a: {mesh: nothing.stl}}", "there is no file"),
        ("tool: {plane: {}}", "an arm cannot carry it"),
        ("[1, 2]", "it must be a mapping"),
        ("a: [", "is not YAML"),
    ):
        bad.write_text(text)
        with pytest.raises(SceneError, match=why) as caught:
            PlanningScene.read("ur3", bad)
        assert str(bad) in str(caught.value)


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 6),
    st.tuples(*[st.floats(-1.0, 1.0)] * 6),
)
def test_a_free_path_has_no_configuration_in_collision(start: tuple[float, ...], delta: tuple[float, ...]) -> None:
    checker = CollisionChecker(scene_of("shelf", "ur3"))
    end = [one + other for one, other in zip(start, delta, strict=True)]
    places = [np.array(start) + share * np.array(delta) for share in np.linspace(0.0, 1.0, 200)]
    if checker.is_free(start) and checker.path_is_free(start, end):
        assert min(map(checker.clearance, places)) > checker.scene.padding_m - 0.0006
