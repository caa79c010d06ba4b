"""Lines, arcs and sequences: the TCP follows the whole path, and errors state the cause."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import dist, pi

import numpy as np
import pytest

from tests.rows import each_row

pytest.importorskip("ompl")

from clearance import Clearance
from scenes import samples

from client.errors import PlanningError
from client.planning import (
    Box,
    CircGoal,
    IncompletePathError,
    JointGoal,
    MotionSequenceItem,
    Plan,
    Plane,
    Planner,
    PlanningScene,
    PoseGoal,
)
from urproto.robots import MODELS, Kinematics, load_model
from urproto.robots.pose import Pose, interpolate_pose, pose_inv, pose_trans

TCP = (0.0, 0.02, 0.1, 0.3, 0.0, 0.0)
START = (0.4, -1.3, 1.6, -1.9, -1.5, 0.2)
ON_M = 5e-5
ON_RAD = 5e-4


def moved(pose: Pose, x: float, y: float, z: float, turn: Sequence[float] = (0.0, 0.0, 0.0)) -> Pose:
    """Moved in the base frame, and rotated in the tool frame."""
    return pose_trans((pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:]), (0.0, 0.0, 0.0, *turn))


def angle(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(pose_trans(pose_inv((0.0, 0.0, 0.0, *one[3:])), (0.0, 0.0, 0.0, *other[3:]))[3:]))


def tool(plan: Plan, model: str, count: int = 5) -> list[Pose]:
    return [Kinematics(load_model(model).dh).forward(q, TCP) for q in samples(plan, count)]


def off_line(pose: Pose, start: Pose, goal: Pose) -> tuple[float, float]:
    """Distance of a pose from the line, and its rotation relative to the orientation of the line there."""
    line = np.subtract(goal[:3], start[:3])
    share = float(np.subtract(pose[:3], start[:3]) @ line / (line @ line))
    there = interpolate_pose(start, goal, share)
    return dist(there[:3], pose[:3]), angle(there, pose)


@each_row("model", MODELS)
def test_a_line_is_straight_and_turns_evenly(model: str) -> None:
    arm = load_model(model)
    size = 0.2 * arm.reach_m
    start = Kinematics(arm.dh).forward(START, TCP)
    goal = moved(start, -size, size, 0.5 * size, (0.0, 0.4, 0.3))
    plan = Planner(PlanningScene(arm)).plan(START, PoseGoal(goal, TCP), planner="LIN")
    poses = tool(plan, model)
    # the robot interpolates the samples by its own splines; these have the same accelerations
    assert max(off_line(pose, start, goal)[0] for pose in poses) < ON_M
    assert max(off_line(pose, start, goal)[1] for pose in poses) < ON_RAD
    assert poses[-1] == pytest.approx(goal, abs=1e-6)
    assert plan.planner == "LIN"


def test_tool_limits_apply_to_lines_and_arcs_but_not_to_ptp() -> None:
    planner = Planner(PlanningScene("ur10e"))
    start = planner.scene.kinematics.forward(START, TCP)
    goal = moved(start, 0.0, 1.1, 0.0)
    fast = {
        name: np.array([one[:3] for one in tool(planner.plan(START, wanted, planner=name), "ur10e", 1)])
        for name, wanted in (
            ("LIN", PoseGoal(goal, TCP)),
            ("CIRC", CircGoal(goal, moved(start, 0.2, 0.5, 0.0)[:3], None, TCP)),
            ("PTP", PoseGoal(goal, TCP)),
        )
    }
    speed = {
        name: float(np.max(np.linalg.norm(np.diff(points, axis=0), axis=1))) / 0.04 for name, points in fast.items()
    }
    assert 0.7 < speed["LIN"] <= 1.001
    assert 0.7 < speed["CIRC"] <= 1.001
    assert speed["PTP"] > 1.2
    slow = planner.plan(START, PoseGoal(goal, TCP), planner="LIN", velocity_scaling=0.5, acceleration_scaling=0.5)
    assert (abs(slow.trajectory.qd) <= 0.5 * planner.limits.velocity * 1.001).all()


@pytest.mark.parametrize("by", ["interim", "center"])
def test_an_arc_keeps_its_radius(by: str) -> None:
    planner = Planner(PlanningScene("ur5e"))
    start = planner.scene.kinematics.forward(START, TCP)
    goal = moved(start, 0.0, 0.2, 0.0, (0.0, 0.0, 0.5))
    center = moved(start, 0.0, 0.1, 0.0)[:3] if by == "interim" else moved(start, -0.1, 0.1, 0.0)[:3]
    radius = 0.1 if by == "interim" else 0.1 * 2**0.5
    wanted = (
        CircGoal(goal, moved(start, 0.1, 0.1, 0.0)[:3], tcp_offset=TCP)
        if by == "interim"
        else CircGoal(goal, center=center, tcp_offset=TCP)
    )
    poses = tool(planner.plan(START, wanted, planner="CIRC"), "ur5e")
    assert max(abs(dist(pose[:3], center) - radius) for pose in poses) < ON_M
    assert max(abs(pose[2] - start[2]) for pose in poses) < ON_M
    assert max(pose[0] for pose in poses) == pytest.approx(center[0] + radius, abs=1e-3)
    assert poses[-1] == pytest.approx(goal, abs=1e-6)


def test_more_than_half_a_circle_goes_over_the_interim_point() -> None:
    planner = Planner(PlanningScene("ur5e"))
    start = planner.scene.kinematics.forward(START, TCP)
    goal, over = moved(start, -0.05, 0.05, 0.0), moved(start, 0.05, 0.05, 0.0)
    poses = tool(planner.plan(START, CircGoal(goal, over[:3], None, TCP), planner="CIRC"), "ur5e")
    length = sum(dist(one[:3], other[:3]) for one, other in pairwise(poses))
    assert length == pytest.approx(1.5 * pi * 0.05, rel=1e-3)
    goal = moved(start, 0.0, 0.01, 0.0)
    far = tool(planner.plan(START, CircGoal(goal, over[:3], None, TCP), planner="CIRC"), "ur5e")
    assert min(dist(pose[:3], over[:3]) for pose in far) < 0.005
    assert sum(dist(one[:3], other[:3]) for one, other in pairwise(far)) > 0.15


def test_a_sequence_stays_on_its_lines_except_in_blends() -> None:
    planner = Planner(PlanningScene("ur5e"))
    start = planner.scene.kinematics.forward(START, TCP)
    corner, end = moved(start, 0.0, 0.2, 0.0), moved(start, 0.0, 0.2, 0.2)
    radius = 0.05
    items = [MotionSequenceItem(PoseGoal(corner, TCP), "LIN", radius), MotionSequenceItem(PoseGoal(end, TCP))]
    blended = planner.plan_sequence(START, items)
    stopping = planner.plan_sequence(START, [MotionSequenceItem(item.goal, "LIN") for item in items])
    assert blended.duration_s < stopping.duration_s
    poses = tool(blended, "ur5e", 20)
    for pose in poses:
        if dist(pose[:3], corner[:3]) > radius:
            assert min(off_line(pose, start, corner)[0], off_line(pose, corner, end)[0]) < ON_M
    assert min(dist(pose[:3], corner[:3]) for pose in poses) == pytest.approx(0.16 * radius, rel=0.3)
    speeds = abs(blended.trajectory.qd).max(axis=1)
    assert min(speeds[3:-3]) > 0.1  # it does not stop at the corner
    assert poses[-1] == pytest.approx(end, abs=1e-6)


def test_motions_of_all_kinds_can_be_combined() -> None:
    planner = Planner(PlanningScene("ur5e"))
    start = planner.scene.kinematics.forward(START, TCP)
    side, top = moved(start, 0.0, 0.2, 0.0), moved(start, 0.0, 0.0, 0.2)
    items = [
        MotionSequenceItem(PoseGoal(side, TCP), "LIN", 0.03, velocity_scaling=0.1),
        MotionSequenceItem(CircGoal(top, moved(start, 0.0, 0.2, 0.2)[:3], None, TCP), "CIRC", 0.03),
        MotionSequenceItem(JointGoal(START), "PTP"),
        MotionSequenceItem(JointGoal((1.0, *START[1:])), "RRTConnect"),
    ]
    plan = planner.plan_sequence(START, items)
    assert plan.planner == "LIN, CIRC, PTP, RRTConnect"
    assert plan.trajectory.q[-1] == pytest.approx((1.0, *START[1:]), abs=1e-6)
    assert (abs(plan.trajectory.qd) <= planner.limits.velocity * 1.001).all()
    assert (abs(plan.trajectory.qdd) <= planner.limits.acceleration * 1.001).all()
    assert (np.diff(plan.trajectory.times_s) > 0.0).all()
    points = [pose[:3] for pose in tool(plan, "ur5e", 1)]
    slow = [
        dist(one, other) / 0.04 for one, other in pairwise(points) if dist(one, side[:3]) > 0.031 and one[1] < side[1]
    ]
    first = slow[: int(0.1 / 0.004)]
    assert max(first) < 0.103  # a tenth of 1 m/s on the first line alone
    assert plan.path[0] == START


def test_sequences_that_cannot_be_blended_say_why() -> None:
    planner = Planner(PlanningScene("ur5e"))
    start = planner.scene.kinematics.forward(START, TCP)
    one, two = PoseGoal(moved(start, 0.0, 0.1, 0.0), TCP), PoseGoal(moved(start, 0.0, 0.1, 0.1), TCP)
    three = PoseGoal(moved(start, 0.1, 0.1, 0.1), TCP)
    for items, why in (
        ([MotionSequenceItem(one, "LIN", 0.12), MotionSequenceItem(two)], "motion 1, 120 mm, is too large: motion 1"),
        (
            [MotionSequenceItem(one, "LIN", 0.06), MotionSequenceItem(two, "LIN", 0.06), MotionSequenceItem(three)],
            "motion 2, 60 mm, is too large: motion 2 lies entirely within it, or within it and the blend before",
        ),
        ([MotionSequenceItem(one, "LIN", 0.01)], "set its blend radius to 0"),
        ([], "at least one motion"),
        ([MotionSequenceItem(one, "STRAIGHT")], "unknown planner 'STRAIGHT': choose one of RRTConnect"),
    ):
        with pytest.raises(PlanningError, match=why):
            planner.plan_sequence(START, items)
    with pytest.raises(PlanningError, match="a blend radius: from 0 to 10 m, not -1"):
        MotionSequenceItem(one, "LIN", -1.0)


def test_the_reason_a_line_fails_is_reported() -> None:
    scene = PlanningScene("ur5e")
    scene.add("table", Plane(), (0.0, 0.0, -0.03, 0.0, 0.0, 0.0))
    planner = Planner(scene)
    start = scene.kinematics.forward(START, TCP)

    def line(*by: float) -> Plan:
        return planner.plan(START, PoseGoal(moved(start, *by), TCP), planner="LIN")

    with pytest.raises(
        IncompletePathError, match=r"is free for \d+ % of its path, then wrist_3_link is .* table"
    ) as low:
        line(0.0, 0.0, -0.4)
    clearance = Clearance(load_model("ur5e"), scene)
    assert scene.padding_m < clearance(low.value.q_rad) < scene.padding_m + 0.02
    with pytest.raises(
        IncompletePathError, match=r"followed for \d.* % of its path, then p\[.*out of the reach"
    ) as far:
        line(1.5, 0.0, 0.2)
    ends = scene.kinematics.forward(far.value.q_rad, TCP)
    assert ends == pytest.approx(moved(start, 1.5 * far.value.fraction, 0.0, 0.2 * far.value.fraction), abs=1e-4)
    assert scene.kinematics.inverse_all(pose_trans(moved(ends, 1e-3, 0.0, 0.0), pose_inv(TCP))) == []
    with pytest.raises(IncompletePathError, match=r"would bring the wrist to 13\d mm from the base's axis, and it can"):
        line(-2.0 * start[0], -2.0 * start[1], 0.0)
    for goal, name, why in (
        (JointGoal(START), "LIN", "LIN needs a pose"),
        (PoseGoal(start), "CIRC", "CIRC needs a point of its circle: give a CircGoal"),
        (CircGoal(start), "CIRC", "either an interim point or a center"),
        (CircGoal(moved(start, 0.0, 0.2, 0.0), moved(start, 0.0, 0.1, 0.0)[:3], None, TCP), "CIRC", "collinear"),
        (CircGoal(moved(start, 0.0, 0.2, 0.0), None, moved(start, 0.0, 0.15, 0.1)[:3], TCP), "CIRC", "no circle about"),
        (CircGoal(start, (0.0, 0.0, 1.0)), "RRTConnect", "a CircGoal needs the planner CIRC"),
    ):
        with pytest.raises(PlanningError, match=why):
            planner.plan(START, goal, planner=name)


def test_a_line_is_slow_near_a_singularity_and_ends_at_one() -> None:
    straight = (0.4, -1.3, 1.6, -1.9, -0.2, 0.2)
    turned = (*straight[:4], 0.2, 0.2)
    planner = Planner(PlanningScene("ur5e"))
    start, goal = (planner.scene.kinematics.forward(q, TCP) for q in (straight, turned))
    plan = planner.plan(straight, PoseGoal(goal, TCP), planner="LIN")
    assert abs(plan.path[-1][3] - straight[3]) > 3.0  # joints 4 and 6 flip on the path
    assert max(off_line(pose, start, goal)[0] for pose in tool(plan, "ur5e")) < ON_M
    assert (abs(plan.trajectory.qd) <= planner.limits.velocity * 1.001).all()
    # a smaller arm is stretched before it arrives, where it would have to change its branch
    planner = Planner(PlanningScene("ur3"))
    tcp = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    goal = planner.scene.kinematics.forward((*straight[:4], 0.3, 0.2), tcp)
    with pytest.raises(
        IncompletePathError, match=r"reaches its elbow singularity \(elbow at 0\.0\d\d rad\): the joints"
    ):
        planner.plan((*straight[:4], -0.3, 0.2), PoseGoal(goal, tcp), planner="LIN")


def test_ptp_goes_straight_or_reports_the_obstacle_that_blocks_it() -> None:
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    there = (3.6, *START[1:])
    plan = planner.plan(START, JointGoal(there), planner="PTP")
    assert (abs(plan.trajectory.q[:, 1:] - np.array(START)[1:]) < 1e-9).all()
    assert abs(plan.trajectory.qd[:, 0]).max() == pytest.approx(planner.limits.velocity[0], rel=0.15)
    x, y, *_ = scene.kinematics.forward((2.0, *START[1:]))
    scene.add("post", Box((0.08, 0.08, 2.0)), (x, y, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(IncompletePathError, match=r"PTP is free for \d+ % of its path, then .* post.*use RRTConnect"):
        planner.plan(START, JointGoal(there), planner="PTP")


def test_a_cartesian_path_goes_as_far_as_possible() -> None:
    scene = PlanningScene("ur5e")
    planner = Planner(scene)
    start = scene.kinematics.forward(START, TCP)
    waypoints = [moved(start, 0.0, 0.1, 0.0), moved(start, 0.0, 0.1, 0.1), moved(start, -0.1, 0.1, 0.1)]
    plan, fraction = planner.compute_cartesian_path(START, waypoints, 0.01, tcp_offset=TCP)
    assert fraction == 1.0
    assert not plan.stopped_by
    for pose in tool(plan, "ur5e"):
        assert min(off_line(pose, *line)[0] for line in pairwise([start, *waypoints])) < ON_M
    rounded = planner.compute_cartesian_path(START, waypoints, 0.01, tcp_offset=TCP, blend_radius_m=0.02).plan
    assert rounded.duration_s < plan.duration_s
    # a post next to the end of the second of three lines, and the same without collision checks
    waypoints = [moved(start, 0.0, 0.0, 0.1), moved(start, 0.0, 0.3, 0.1), moved(start, -0.1, 0.3, 0.1)]
    scene.add("post", Box((0.08, 0.08, 2.0)), (start[0], start[1] + 0.35, 0.0, 0.0, 0.0, 0.0))
    plan, fraction = planner.compute_cartesian_path(START, waypoints, 0.01, tcp_offset=TCP)
    assert 1 / 3 < fraction < 2 / 3
    assert "line 2 ends after" in plan.stopped_by
    assert "post; the required clearance is 10 mm" in plan.stopped_by
    ends = scene.kinematics.forward(plan.path[-1], TCP)
    assert ends == pytest.approx(moved(start, 0.0, (3 * fraction - 1) * 0.3, 0.1), abs=1e-4)
    blind = planner.compute_cartesian_path(START, waypoints, 0.01, tcp_offset=TCP, avoid_collisions=False)
    assert blind.fraction == 1.0
    # a first line of zero length is a plan that stays in place
    scene.remove("post")
    far = planner.compute_cartesian_path(START, [moved(start, 0.1, 0.0, 0.0), (5.0, *start[1:])], tcp_offset=TCP)
    assert 0.5 < far.fraction < 0.7
    assert "out of the reach" in far.plan.stopped_by


def test_joint_jumps_above_the_threshold_end_a_cartesian_path() -> None:
    planner = Planner(PlanningScene("ur5e"))
    near = (0.4, -1.3, 1.6, -1.9, -0.3, 0.2)  # the wrist straightens on the path
    start = planner.scene.kinematics.forward(near, TCP)
    waypoint = [planner.scene.kinematics.forward((0.4, -1.3, 1.6, -1.9, -0.005, 1.2), TCP)]
    whole = planner.compute_cartesian_path(near, waypoint, 0.01, tcp_offset=TCP)
    assert whole.fraction == 1.0
    steps = abs(np.diff(whole.plan.trajectory.q, axis=0)).max()
    assert steps > 0.04
    for options, threshold in (({"revolute_jump_threshold_rad": 0.03}, 0.03), ({"jump_threshold": 1.5}, None)):
        cut = planner.compute_cartesian_path(near, waypoint, 0.01, tcp_offset=TCP, **options)
        assert 0.0 <= cut.fraction < 1.0
        assert "more than the jump threshold allows" in cut.plan.stopped_by
        assert threshold is None or cut.fraction > 0.0
    assert start != waypoint[0]
    for options, why in (
        ({"waypoints": []}, "at least one waypoint"),
        ({"waypoints": [(0.0,) * 5]}, "number 1 of the list: a pose: 6 numbers"),
        ({"max_step_m": 0.0}, "a step: above 0"),
        ({"jump_threshold": -1.0}, r"from 0 to 1e\+09, not -1"),
        ({"blend_radius_m": float("nan")}, "from 0 to 10 m, not nan"),
    ):
        with pytest.raises(PlanningError, match=why):
            planner.compute_cartesian_path(**({"start_rad": near, "waypoints": waypoint} | options))


def test_a_calibrated_arm_stays_on_the_line() -> None:
    nominal = load_model("ur5e")
    off = (0.0, 0.002, -0.001, 0.001, -0.002, 0.0)
    d = tuple(one + other for one, other in zip(nominal.dh.d, (0.0005, 0.0, 0.0, -0.0004, 0.0003, 0.0), strict=True))
    model = replace(nominal, calibration=replace(nominal.dh, theta=off, d=d))
    planner = Planner(PlanningScene(model))
    start = planner.scene.kinematics.forward(START, TCP)
    assert dist(start[:3], Kinematics(nominal.dh).forward(START, TCP)[:3]) > 0.001
    goal = moved(start, -0.1, 0.15, 0.1, (0.0, 0.2, 0.0))
    plan = planner.plan(START, PoseGoal(goal, TCP), planner="LIN")
    for q in samples(plan, 2):
        offset, turn = off_line(planner.scene.kinematics.forward(q, TCP), start, goal)
        assert offset < ON_M
        assert turn < ON_RAD
