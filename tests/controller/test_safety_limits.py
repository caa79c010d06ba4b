"""Limits: motion stays below them, excess is detected in time, and the arm stops before boundaries."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from emulator.lifecycle.safety import SafetyEvent, StopCategory
from emulator.robot.arm import Arm
from emulator.robot.installation import Installation
from emulator.safety.board import StopMonitor
from emulator.safety.geometry import Boundaries, clamping_room
from emulator.safety.governor import TRANSITION_S, Governor, operational
from emulator.safety.signals import SafetyDevice
from emulator.world.links import Links
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import START_Q, load_model
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO6
from urscript.polyscope.safety_configuration import (
    BoundaryMode,
    LimitSet,
    Plane,
    ToolOrientation,
    ToolSphere,
    factory_configuration,
)

STRETCHED = (0.0, -0.3, 0.2, 0.0, 0.0, 0.0)
BENT = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
SWING = "def swing():\n  movej([3.0, -0.3, 0.2, 0.0, 0.0, 0.0], a=6, v=3)\nend\n"


def safe(model, **changes):
    return replace(factory_configuration(load_model(model)), **changes)


def started(make, model, body=SWING, q=STRETCHED, **config):
    rig = make(model, running=True, initial_q=q, **config)
    rig.tick()
    rig.script(body)
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
    return rig


def tool_speed(snapshot):
    return math.hypot(*snapshot.actual_TCP_speed[:3])


def codes(rig):
    return [(message.code, message.argument) for message in rig.messages_of(ErrorCodeMessage)]


def to_the_end(rig, watch=tool_speed):
    """Values of ``watch`` until the program ends or the safety system stops it."""
    seen = []
    while rig.now.runtime_state is RuntimeState.PLAYING and len(seen) < 20_000:
        seen.append(watch(rig.tick()))
    return seen


# without a configuration


def test_without_a_configuration_only_joints_are_limited(make):
    """A trajectory that the official library's tests send at the vendor's simulator: 2 m/s at the tool, 1 s."""
    far = (-1.6, -1.72, -2.175, -0.78, 1.623, -0.5)
    body = f"def far():\n  movej({list(far)}, t=1.1)\nend\n"
    rig = started(make, "ur5e", body, (0.0, -1.57, 0.0, -1.57, 0.0, 0.1))
    assert max(to_the_end(rig)) > 1.55
    assert rig.now.actual_q == pytest.approx(far, abs=1e-9)
    assert codes(rig) == []


# motion below the limits


@each_row(("model", "reduced", "most"), [("ur5", False, 1.35), ("ur5e", False, 1.35), ("ur5e", True, 0.6)])
def test_paths_stay_below_the_tool_speed_limit(make, model, reduced, most):
    rig = make(model, running=True, initial_q=STRETCHED, safety=safe(model))
    rig.tick()
    if reduced:
        rig.controller.safety_event(SafetyEvent.REDUCED)
    rig.script(SWING)
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
    scalings = []
    speeds = to_the_end(rig, lambda s: (scalings.append(s.speed_scaling), tool_speed(s))[1])
    assert max(speeds) == pytest.approx(most, rel=0.02)
    assert min(scaling for scaling in scalings[1:-1]) < 0.9
    assert rig.now.actual_q == pytest.approx((3.0, -0.3, 0.2, 0.0, 0.0, 0.0), abs=1e-9)
    assert codes(rig) == []


def test_stricter_limits_slow_a_move_without_leaving_its_path(make):
    rig = started(make, "ur5e")
    rig.until(lambda s: tool_speed(s) > 1.3)
    rig.controller.safety_event(SafetyEvent.REDUCED)
    begin = rig.now.timestamp
    before = rig.now.actual_qd[0]
    while tool_speed(rig.tick()) > 0.61:
        assert before - rig.now.actual_qd[0] <= 1.05 * 40.0 * 0.002
        before = rig.now.actual_qd[0]
        assert rig.now.actual_q[1:] == pytest.approx(STRETCHED[1:], abs=1e-9)
    assert rig.now.timestamp - begin < 0.5  # hardware manual: duration for which both sets of limits are accepted
    assert max(to_the_end(rig)) <= 0.615
    assert codes(rig) == []


def test_elbow_speed_is_limited_only_on_e_series(make):
    slow = replace(safe("ur5e").normal, elbow_speed=0.4)
    body = "def swing():\n  movej([0.0, -1.2, 0.2, 0.0, 0.0, 0.0], a=6, v=3)\nend\n"
    rig = started(make, "ur5e", body, safety=safe("ur5e", normal=slow))
    assert max(to_the_end(rig, lambda s: math.hypot(*s.elbow_velocity))) == pytest.approx(0.25, rel=0.02)


def test_momentum_of_arm_and_payload_is_limited(make):
    light = replace(safe("ur10e").normal, momentum=13.0)
    rig = make("ur10e", running=True, initial_q=STRETCHED, safety=safe("ur10e", normal=light))
    rig.script(SWING.replace("  movej", "  set_payload(10)\n  movej"))
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
    assert max(to_the_end(rig, lambda s: s.actual_momentum)) == pytest.approx(10.0, rel=0.02)


def test_stopping_time_is_limited_by_speed(make):
    quick = replace(safe("ur3e").normal, stopping_time=0.02)
    rig = started(make, "ur3e", SWING, safety=safe("ur3e", normal=quick))
    assert max(to_the_end(rig, lambda s: abs(s.actual_qd[0]))) == pytest.approx(0.02 * 40.0, rel=0.02)


def test_joints_keep_a_margin_to_narrower_limits(make):
    limits = safe("ur5").normal
    narrow = replace(limits, joint_max=(1.0, *limits.joint_max[1:]))
    rig = started(
        make, "ur5", "def far():\n  speedj([0.5,0,0,0,0,0], a=1, t=9)\nend\n", safety=safe("ur5", normal=narrow)
    )
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP)
    rig.seconds(0.5)
    assert rig.now.actual_q[0] <= 1.0 - math.radians(3.0) + 1e-9
    assert rig.now.actual_q[0] > 0.9
    assert codes(rig) == [(150, 0)]


# violations

SERVO = """def servo():
  i = 0
  while i < 4000:
    i = i + 1
    servoj([0.004 * i, -0.3, 0.2, 0.0, 0.0, 0.0], t=0.002, lookahead_time=0.03, gain=2000)
  end
end
"""


def test_streamed_targets_that_are_too_fast_violate_the_speed_limit(make):
    rig = started(make, "ur5e", SERVO, safety=safe("ur5e"))
    rig.until(lambda s: tool_speed(s) > 1.55)
    begin = rig.now.timestamp
    rig.until(lambda s: s.safety_mode is SafetyMode.VIOLATION)
    assert rig.now.timestamp - begin == pytest.approx(0.25, abs=0.01)  # hardware manual: detection
    assert codes(rig) == [(191, 3)]
    assert rig.now.robot_mode is RobotMode.POWER_OFF  # power is removed immediately, the brakes stop the arm
    q, qd = rig.now.actual_q[0], rig.now.actual_qd[0]
    assert qd > 1.0
    rig.until(lambda s: not any(s.actual_qd), 0.5)
    brake = 20.0
    assert rig.now.actual_q[0] - q <= qd * qd / (2.0 * brake) + qd * 0.002 + 1e-9
    stop = rig.controller.safety_board.last_stop
    assert (stop.category, stop.done) == (StopCategory.POWER_REMOVED, True)
    assert 0.0 < stop.distance_m < 0.15
    rig.until(lambda s: s.runtime_state is RuntimeState.STOPPED, 0.5)


FREE = "def free():\n  freedrive_mode()\n  sleep(5)\nend\n"


def test_a_force_over_the_limit_is_a_violation_after_a_quarter_of_a_second(make):
    rig = started(
        make,
        "ur5e",
        "def hold():\n  force_mode(p[0,0,0,0,0,0],[0,0,0,0,0,0],[0,0,0,0,0,0],2,[1,1,1,1,1,1])\n  sleep(5)\nend\n",
        BENT,
        safety=safe("ur5e"),
    )
    rig.controller.external_wrench = (0.0, 0.0, -170.0, 0.0, 0.0, 0.0)
    rig.seconds(1.0)
    assert codes(rig) == []  # over 150 N, but within the tolerance of 25 N
    rig.controller.external_wrench = (0.0, 0.0, -180.0, 0.0, 0.0, 0.0)
    begin = rig.now.timestamp
    rig.until(lambda s: s.safety_mode is SafetyMode.VIOLATION, 1.0)
    assert rig.now.timestamp - begin == pytest.approx(0.25, abs=0.005)
    assert codes(rig) == [(191, 7)]


def test_a_short_peak_of_force_is_no_violation(make):
    rig = started(make, "ur5e", FREE, BENT)
    for _ in range(5):
        rig.controller.external_wrench = (0.0, 0.0, 200.0, 0.0, 0.0, 0.0)
        rig.seconds(0.2)
        rig.controller.external_wrench = (0.0,) * 6
        rig.seconds(0.2)
    assert rig.now.safety_mode is not SafetyMode.VIOLATION


# protective stops


def test_a_push_detected_in_the_currents_is_a_collision(make):
    rig = started(make, "ur5e", "def stand():\n  sleep(5)\nend\n", BENT)
    rig.controller.external_wrench = (0.0, 0.0, -40.0, 0.0, 0.0, 0.0)
    rig.seconds(0.5)
    assert rig.now.collision_detection_ratio < 1.0
    assert codes(rig) == []
    rig.controller.external_wrench = (0.0, 0.0, -140.0, 0.0, 0.0, 0.0)
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 0.1)
    [(code, joint)] = codes(rig)
    window, now = rig.now.actual_current_window, rig.now
    shares = [abs(a - t) / w for a, t, w in zip(now.actual_current, now.target_current, window, strict=True)]
    assert (code, joint) == (157, shares.index(max(shares)))


def test_the_same_push_moves_a_compliant_arm(make):
    rig = started(make, "ur5e", FREE, BENT)
    rig.controller.external_wrench = (0.0, 0.0, 140.0, 0.0, 0.0, 0.0)
    before = rig.now.actual_TCP_pose[2]
    rig.seconds(0.2)
    assert codes(rig) == []
    assert rig.now.actual_TCP_pose[2] > before


def test_a_joint_far_from_its_target_deviates_from_the_path(make, monkeypatch):
    rig = started(make, "ur5e")
    monkeypatch.setattr(Arm, "following_error", property(lambda _: (0.0, 0.0, 0.0, -0.2, 0.0, 0.0)))
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 0.1)
    assert codes(rig) == [(153, 3)]


DOWN = "def down():\n  movel(pose_add(get_actual_tcp_pose(), p[0, 0, -0.4, 0, 0, 0]), a=1.2, v=0.8)\nend\n"


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_the_arm_stops_before_a_safety_plane(make, model):
    height = make(model, initial_q=BENT).now.actual_TCP_pose[2]
    table = Plane("table", (0.0, 0.0, 1.0), -(height - 0.2), BoundaryMode.BOTH)
    rig = started(make, model, DOWN, BENT, safety=safe(model, planes=(table,)))
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 5.0)
    rig.seconds(0.5)
    assert 0.0 <= table.depth(rig.now.actual_TCP_pose[:3]) < 0.05
    assert codes(rig) == [(152, 0)]
    assert rig.now.runtime_state is RuntimeState.PAUSED
    rig.seconds(5.0)
    rig.request("unlock protective stop")
    assert rig.now.safety_mode is SafetyMode.NORMAL
    rig.request("stop")
    rig.script(DOWN.replace("-0.4", "0.1"))  # away from it
    rig.until(lambda s: s.runtime_state is RuntimeState.PLAYING, 1.0)
    to_the_end(rig)
    assert rig.now.safety_mode is SafetyMode.NORMAL
    assert table.depth(rig.now.actual_TCP_pose[:3]) > 0.1


def test_a_reduced_mode_plane_is_inactive_in_normal_mode(make):
    height = make("ur5e", initial_q=BENT).now.actual_TCP_pose[2]
    table = Plane("table", (0.0, 0.0, 1.0), -(height - 0.1), BoundaryMode.REDUCED)
    rig = started(make, "ur5e", DOWN.replace("-0.4", "-0.2"), BENT, safety=safe("ur5e", planes=(table,)))
    to_the_end(rig)
    assert codes(rig) == []
    assert table.depth(rig.now.actual_TCP_pose[:3]) < -0.05


def test_a_tool_sphere_reaches_a_plane_before_the_tool_centre(make):
    height = make("ur5e", initial_q=BENT).now.actual_TCP_pose[2]
    table = Plane("table", (0.0, 0.0, 1.0), -(height - 0.2), BoundaryMode.NORMAL)
    sphere = ToolSphere((0.0, 0.0, 0.0), 0.08)
    rig = started(make, "ur5e", DOWN, BENT, safety=safe("ur5e", planes=(table,), tool_spheres=(sphere,)))
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 5.0)
    rig.seconds(0.3)
    assert 0.08 <= table.depth(rig.now.actual_TCP_pose[:3]) < 0.12


def test_the_elbow_stops_before_a_plane_that_restricts_it(make):
    """The tool stays far inside; the elbow's sphere of 0.13 m must not pass the plane."""
    q, there = (math.pi, -1.57, 2.6, -1.6, -1.57, 0.0), [math.pi, -2.7, 2.6, -1.6, -1.57, 0.0]
    body = f"def lean():\n  movej({there}, a=1, v=0.5)\nend\n"
    for elbow, expected in ((True, [(400, 0)]), (False, [])):
        wall = Plane("wall", (1.0, 0.0, 0.0), 0.3, BoundaryMode.NORMAL, elbow=elbow)
        rig = started(make, "ur5e", body, q, safety=safe("ur5e", planes=(wall,)))
        to_the_end(rig)
        rig.seconds(0.3)
        assert codes(rig) == expected
        assert (rig.now.elbow_position[0] >= 0.13 - 0.3) is elbow


def test_the_tool_stops_before_its_orientation_limit(make):
    rig = make("ur5e", running=True, initial_q=BENT)
    rig.tick()
    limit = ToolOrientation((0.0, 0.0, -1.0), 0.5, BoundaryMode.BOTH)
    rig = started(
        make,
        "ur5e",
        "def tilt():\n  movel(pose_trans(get_actual_tcp_pose(), p[0, 0, 0, 1.0, 0, 0]), a=1, v=0.2)\nend\n",
        BENT,
        safety=safe("ur5e", tool_orientation=limit),
    )
    rig.until(lambda s: s.safety_mode is SafetyMode.PROTECTIVE_STOP, 10.0)
    rig.seconds(0.5)
    down = rig.controller.arm.flange_pose[3:]
    angle = math.acos(-rotvec_to_matrix(*down)[8])
    assert 0.45 < angle <= 0.5 + 1e-9
    assert codes(rig) == [(151, 0)]


def test_a_trigger_plane_activates_reduced_mode_beyond_and_slightly_before_it(make):
    height = make("ur5e", initial_q=BENT).now.actual_TCP_pose[2]
    plane = Plane("zone", (0.0, 0.0, 1.0), -(height - 0.1), BoundaryMode.TRIGGER)
    rig = started(make, "ur5e", DOWN.replace("-0.4", "-0.2"), BENT, safety=safe("ur5e", planes=(plane,)))
    rig.until(lambda s: s.safety_mode is SafetyMode.REDUCED, 3.0)
    assert -0.01 < plane.depth(rig.now.actual_TCP_pose[:3]) <= 0.0
    to_the_end(rig)
    rig.script(DOWN.replace("-0.4", "0.2"))
    rig.until(lambda s: s.safety_mode is SafetyMode.NORMAL, 3.0)
    assert 0.02 <= plane.depth(rig.now.actual_TCP_pose[:3]) < 0.03
    to_the_end(rig)
    assert codes(rig) == []


# the pose of a UR5e at which the forum's reporter was stopped, and one on the way there
CLAMPED = tuple(map(math.radians, (136.46, 4.19, 63.94, 98.65, -133.19, -10.6)))
OPEN = (*CLAMPED[:3], CLAMPED[3] + 0.5, *CLAMPED[4:])


def test_a_reported_pose_counts_as_clamping():
    model = load_model("ur5e")
    arm = Arm(model)
    arm.update((CLAMPED, ZERO6, ZERO6), Installation(), ZERO6, model.series.period_s, driven=True)
    assert -0.001 < clamping_room(model, arm) < 0.0


@pytest.mark.parametrize(("model", "expected"), [("ur5e", [(403, 0)]), ("ur5", [])])
def test_the_flange_does_not_clamp_the_lower_arm_on_e_series(make, model, expected):
    body = f"def fold():\n  movej({list(CLAMPED)}, a=1, v=0.5)\nend\n"
    rig = started(make, model, body, OPEN)
    to_the_end(rig)
    rig.seconds(0.3)
    assert codes(rig) == expected


# self-collision


@each_row("model", ["ur3e", "ur5", "ur5e", "ur10e"])
def test_ordinary_poses_are_free(model):
    links = Links(load_model(model))
    for q in (BENT, STRETCHED, START_Q):
        assert links.clearance(q) > 0.0


@pytest.mark.parametrize(("monitored", "expected"), [(True, True), (False, False)])
def test_self_collision_is_detected_if_enabled(make, monitored, expected):
    body = "def fold():\n  movej([0, -1.57, 3.0, -1.57, -1.57, 0], a=1, v=0.5)\nend\n"
    rig = started(make, "ur5", body, BENT, self_collision=monitored)
    to_the_end(rig)
    assert bool(codes(rig)) is expected
    assert {code for code, _ in codes(rig)} <= {157}


def test_speeds_of_restricted_points_match_their_motion():
    """Tool centre, elbow and tool spheres against their positions a moment later, with all joints moving."""
    model, dt = load_model("ur5e"), 1e-6
    arm, qd = Arm(model), (0.4, -0.3, 0.5, 0.7, -0.6, 0.9)
    spheres = (ToolSphere((0.1, -0.05, 0.2), 0.05), ToolSphere((-0.1, 0.0, 0.0), 0.02))
    boundaries = Boundaries(safe("ur5e", tool_spheres=spheres), 0.1)
    tcp = (0.02, 0.03, 0.15, 0.1, 0.2, 0.3)
    seen = []
    for moment in range(3):
        q = tuple(angle + moment * dt * speed for angle, speed in zip(BENT, qd, strict=True))
        arm.update((q, qd, ZERO6), Installation(tcp=tcp), ZERO6, dt, driven=True)
        seen.append(boundaries.points(arm))
    assert len(seen[0]) == 4
    for before, now, after in zip(*seen, strict=True):
        moved = [(b - a) / (2.0 * dt) for a, b in zip(before.at, after.at, strict=True)]
        assert now.speed == pytest.approx(moved, abs=1e-4)
        assert math.hypot(*now.speed) > 0.05


def test_both_sets_of_limits_are_accepted_for_half_a_second_after_a_mode_change(make):
    """Hardware manuals. A stream is not slowed down by the controller, so it is a violation after this time."""
    stream = (
        "def stream():\n  x = 0\n  while True:\n    servoj([x, -0.3, 0.2, 0, 0, 0])\n    x = x + 0.0026\n  end\nend\n"
    )
    rig = started(make, "ur5e", stream, STRETCHED, safety=safe("ur5e"))
    rig.seconds(0.5)
    assert safe("ur5e").reduced.tcp_speed + 0.1 < tool_speed(rig.now) < safe("ur5e").normal.tcp_speed
    rig.controller.safety_board.inputs.set_device(SafetyDevice.REDUCED_MODE, True)
    assert rig.tick().safety_mode is SafetyMode.REDUCED
    begin = rig.now.timestamp
    rig.until(lambda s: s.safety_mode is SafetyMode.VIOLATION, 2.0)
    assert rig.now.timestamp - begin == pytest.approx(TRANSITION_S + 0.25, abs=0.02)


# the governor


WIDE = LimitSet(tcp_speed=99.0, force=99.0, power=99.0, momentum=999.0, elbow_speed=99.0)


@each_row(
    "limit",
    [
        {"tcp_speed": 0.5},
        {"elbow_speed": 0.3},
        {"momentum": 5.0},
        {"stopping_time": 0.02},
        {"stopping_distance": 0.01},
        {"joint_speed": (1.0,) * 6},
    ],
    ids=lambda limit: next(iter(limit)),
)
def test_the_used_share_of_a_limit_is_proportional_to_speed(limit):
    """This tells the pacer directly by how much to slow down."""
    model = load_model("ur5e")
    arm = Arm(model)
    arm.update((STRETCHED, ZERO6, ZERO6), Installation(), ZERO6, model.series.period_s, driven=True)
    governor = Governor(model, arm, 0.002, replace(WIDE, **limit))
    steps = [(speed * 0.002, *ZERO6[1:]) for speed in (1.0, 2.0, 3.0)]
    shares = [governor.excess(STRETCHED, step) for step in steps]
    assert shares[0] > 1.0
    assert shares == pytest.approx([shares[0], 2.0 * shares[0], 3.0 * shares[0]], rel=0.01)


def test_a_limit_smaller_than_its_margin_still_allows_some_motion():
    found = operational(replace(WIDE, tcp_speed=0.1, elbow_speed=1.0, momentum=2.0, joint_speed=(0.2,) * 6))
    assert (found.tcp_speed, found.elbow_speed, found.momentum) == pytest.approx((0.02, 0.85, 0.4))
    assert found.joint_speed == pytest.approx((0.04,) * 6)


# stops


@each_row(
    ("event", "category"),
    [
        (SafetyEvent.PROTECTIVE_STOP, StopCategory.CONTROLLED),
        (SafetyEvent.SAFEGUARD_OPEN, StopCategory.CONTROLLED),
        (SafetyEvent.ROBOT_EMERGENCY_STOP, StopCategory.CONTROLLED_THEN_OFF),
        (SafetyEvent.FAULT, StopCategory.POWER_REMOVED),
    ],
)
@each_row("model", ["ur5", "ur5e"])
def test_stopping_distance_and_deceleration_of_each_stop(make, model, event, category):
    rig = started(make, model)
    rig.until(lambda s: tool_speed(s) > 1.3)
    rig.seconds(0.1)
    rig.controller.safety_event(event)
    speed, q, period = rig.now.actual_qd[0], rig.now.actual_q[0], rig.controller.period_s
    decelerations, powered = [], []
    while any(rig.tick().actual_qd) or not decelerations:
        decelerations.append(-rig.now.target_qdd[0])
        powered.append(rig.now.robot_mode is RobotMode.RUNNING)
        if category is not StopCategory.POWER_REMOVED:
            assert rig.now.actual_q[1:] == pytest.approx(STRETCHED[1:], abs=1e-6)  # on its path
    most = 20.0 if category is StopCategory.POWER_REMOVED else 40.0
    assert max(decelerations[:-1]) <= 1.05 * most
    assert all(powered) is (category is not StopCategory.POWER_REMOVED)
    moved, ideal = rig.now.actual_q[0] - q, speed * speed / (2.0 * most)
    assert ideal - speed * period <= moved <= ideal + 3.0 * speed * period
    rig.tick()
    stop = rig.controller.safety_board.last_stop
    assert (stop.category, stop.done) == (category, True)
    assert stop.duration_s == pytest.approx(speed / most, abs=3.0 * period)
    assert stop.distance_m == pytest.approx(moved * 0.95, rel=0.4)
    assert rig.now.robot_mode is (RobotMode.RUNNING if category is StopCategory.CONTROLLED else RobotMode.POWER_OFF)


@each_row(
    ("category", "mode", "hard", "too_slow"),
    [
        (StopCategory.CONTROLLED, SafetyMode.SAFEGUARD_STOP, True, True),
        (StopCategory.CONTROLLED, SafetyMode.SAFEGUARD_STOP, False, False),  # slows down as for a pause
        (StopCategory.CONTROLLED, SafetyMode.PROTECTIVE_STOP, False, True),  # is never gentle
        (StopCategory.CONTROLLED_THEN_OFF, SafetyMode.ROBOT_EMERGENCY_STOP, False, True),
        (StopCategory.POWER_REMOVED, SafetyMode.FAULT, True, False),  # as well as the brakes can
    ],
)
def test_which_stops_have_a_time_limit(category, mode, hard, too_slow):
    arm = SimpleNamespace(tcp_speed=ZERO6, qd=(0.0, -0.3, 0.0, 0.0, 0.0, 0.0))
    motion = SimpleNamespace(hard_transitions=hard)
    machine = SimpleNamespace(time_s=5.0, period_s=0.008, standing=False, arm=arm, motion=motion)
    monitor = StopMonitor(machine)
    monitor.begin(category, mode)
    for elapsed_s, expected in ((0.52, False), (0.53, too_slow)):
        machine.time_s = 5.0 + elapsed_s
        assert monitor.follow() is expected


def test_a_stop_that_takes_too_long_is_a_violation(make):
    """CB3 manual: braking begins within 24 ms and is over after 500 ms."""
    weak = replace(load_model("ur5"), qdd_max=(2.0,) * 6)
    rig = started(make, weak, SWING.replace("a=6, v=3", "a=2, v=1.4"))
    rig.until(lambda s: s.actual_qd[0] > 1.3)
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    begin = rig.now.timestamp
    rig.until(lambda s: s.safety_mode is SafetyMode.VIOLATION, 1.0)
    assert rig.now.timestamp - begin == pytest.approx(0.524, abs=0.02)
    assert codes(rig)[-1] == (191, 16)
