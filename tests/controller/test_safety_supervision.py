"""Violations, limit by limit, and recovery to normal operation after any sequence of events."""

import math
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.robot.arm import Arm
from emulator.safety.causes import Cause
from emulator.safety.geometry import Boundaries
from emulator.safety.signals import SafetyDevice
from emulator.safety.supervision import Supervision
from tests.budget import examples
from tests.commands import ArmSupply, FreedriveButton, SetSafetyDevice, TripSafety
from tests.rows import each_row
from urproto.modes import RobotMode, SafetyMode
from urproto.robots import load_model
from urscript.polyscope.safety_configuration import BoundaryMode, Plane, ToolOrientation, factory_configuration

PERIOD_S = {"ur5": 0.008, "ur5e": 0.002}
ZERO = (0.0,) * 6


# where an arm keeps what is calculated from its motion
CALCULATED = {
    "tcp_pose": lambda arm: (arm.state.tool.now, "pose"),
    "tcp_speed": lambda arm: (arm.state.tool.now, "speed"),
    "flange_pose": lambda arm: (arm.state.tool.now, "flange_pose"),
    "elbow_velocity": lambda arm: (arm.state.tool, "elbow_velocity"),
    "momentum": lambda arm: (arm.efforts, "momentum"),
}


def placed(model, **state):
    """An arm at rest with the given state."""
    arm = Arm(load_model(model))
    for name, value in state.items():
        holder, attribute = CALCULATED[name](arm) if name in CALCULATED else (arm, name)
        setattr(holder, attribute, value)
    return arm


def vector(first, length=6):
    return (first, *(0.0,) * (length - 1))


# supervised quantity -> attribute, its limit in Default, tolerance on CB3 and on e-Series, detection time, cause
DEGREES = math.radians(1.0)
LIMITS = {
    "joint position": ("q", 363 * DEGREES, (1.15 * DEGREES, 5 * DEGREES), 0.1, Cause.JOINT_POSITION_VIOLATION),
    "joint speed": ("qd", math.pi + 0.2, (1.15 * DEGREES,) * 2, 0.25, Cause.JOINT_SPEED_VIOLATION),
    "tool speed": ("tcp_speed", 1.5, (0.05, 0.05), 0.25, Cause.TCP_SPEED_VIOLATION),
    "force": ("wrench", 150.0, (25.0, 25.0), 0.25, Cause.FORCE_VIOLATION),
    "momentum": ("momentum", 25.0, (3.0, 3.0), 0.25, Cause.MOMENTUM_VIOLATION),
}


def periods_to_violation(model, arm, configuration=None, mode=SafetyMode.NORMAL, most=1000):
    configuration = configuration or factory_configuration(load_model(model))
    boundaries = Boundaries(configuration, 0.0)
    watching = Supervision(load_model(model), PERIOD_S[model])
    for period in range(1, most):
        finding = watching.violation(arm, configuration.normal, boundaries, mode)
        if finding is not None:
            return period, finding
    return None


@each_row("model", PERIOD_S)
@each_row("what", LIMITS)
def test_exceeding_limit_and_tolerance_for_the_detection_time_is_a_violation(model, what):
    attribute, limit, tolerances, seconds, cause = LIMITS[what]
    tolerance = tolerances[model == "ur5e"]
    shaped = (lambda value: value) if attribute == "momentum" else vector
    inside = placed(model, **{attribute: shaped(limit + 0.98 * tolerance)})
    assert periods_to_violation(model, inside) is None
    periods, finding = periods_to_violation(model, placed(model, **{attribute: shaped(limit + 1.02 * tolerance)}))
    assert finding.cause is cause
    assert periods == pytest.approx(seconds / PERIOD_S[model], abs=1.01)
    assert finding.joint == (0 if attribute in ("q", "qd") else None)


def test_power_is_force_times_speed():
    arm = placed("ur5e", wrench=vector(150.0), tcp_speed=vector(-1.5))
    assert periods_to_violation("ur5e", arm) is None  # 225 W
    arm = placed("ur5e", wrench=vector(170.0), tcp_speed=vector(-1.54))
    assert periods_to_violation("ur5e", arm) is None  # 262 W
    configuration = factory_configuration(load_model("ur5e"))
    weaker = replace(configuration, normal=replace(configuration.normal, power=250.0))
    assert periods_to_violation("ur5e", arm, weaker)[1].cause is Cause.POWER_VIOLATION


@pytest.mark.parametrize(("model", "expected"), [("ur5", None), ("ur5e", Cause.ELBOW_SPEED_VIOLATION)])
def test_the_elbow_force_is_limited_on_e_series(model, expected):
    found = periods_to_violation(model, placed(model, elbow_velocity=vector(1.6, 3)))
    assert (found and found[1].cause) is expected


@each_row(
    ("force", "speed", "watts"),
    [
        ((100.0, 0.0, 0.0), (1.0, 0.0, 0.0), 100.0),
        ((0.0, 100.0, 0.0), (0.0, -1.0, 0.0), 100.0),
        ((0.0, 0.0, 100.0), (0.0, 0.0, 1.0), 100.0),
        ((80.0, 0.0, -80.0), (0.8, 0.0, -0.8), 128.0),
        ((0.0, 80.0, 80.0), (0.0, 0.8, 0.8), 128.0),
        ((80.0, 0.0, 80.0), (0.8, 0.0, -0.8), 0.0),
        ((80.0, -80.0, 0.0), (0.8, 0.8, 0.0), 0.0),
    ],
)
def test_only_force_along_the_motion_counts_as_power(force, speed, watts):
    configuration = factory_configuration(load_model("ur5e"))
    weaker = replace(configuration, normal=replace(configuration.normal, power=80.0))
    arm = placed("ur5e", wrench=(*force, 0.0, 0.0, 0.0), tcp_speed=(*speed, 0.0, 0.0, 0.0))
    found = periods_to_violation("ur5e", arm, weaker)
    assert (found and found[1].cause) is (Cause.POWER_VIOLATION if watts else None)


@each_row("what", ["tcp_speed", "elbow_speed"])
@each_row("limit", [0.25, 3.0])
def test_the_quick_check_of_each_period_covers_slow_and_fast_limits(what, limit):
    configuration = factory_configuration(load_model("ur5e"))
    limits = replace(configuration.normal, tcp_speed=9.0, elbow_speed=9.0)
    configured = replace(configuration, normal=replace(limits, **{what: limit}))
    attribute, length = ("tcp_speed", 6) if what == "tcp_speed" else ("elbow_velocity", 3)
    inside = placed("ur5e", **{attribute: vector(-(limit + 0.04), length)})
    beyond = placed("ur5e", **{attribute: vector(-(limit + 0.06), length)})
    assert periods_to_violation("ur5e", inside, configured) is None
    assert periods_to_violation("ur5e", beyond, configured)


@pytest.mark.parametrize(("depth", "expected"), [(-0.039, None), (-0.041, Cause.TCP_POSITION_VIOLATION)])
def test_beyond_a_plane(depth, expected):
    configuration = factory_configuration(load_model("ur5e"))
    planes = (Plane("floor", (0.0, 0.0, 1.0), 0.0, BoundaryMode.NORMAL),)
    arm = placed("ur5e", tcp_pose=(0.0, 0.0, depth, 0.0, 0.0, 0.0))
    found = periods_to_violation("ur5e", arm, replace(configuration, planes=planes))
    assert (found and found[1].cause) is expected
    assert periods_to_violation("ur5e", arm, replace(configuration, planes=planes), SafetyMode.REDUCED) is None


@pytest.mark.parametrize(("tilt", "expected"), [(0.55, None), (0.56, Cause.TCP_ORIENTATION_VIOLATION)])
def test_beyond_the_tool_orientation(tilt, expected):
    configuration = factory_configuration(load_model("ur5e"))
    orientation = ToolOrientation((0.0, 0.0, 1.0), 0.5, BoundaryMode.BOTH)
    arm = placed("ur5e", flange_pose=(0.0, 0.0, 0.5, tilt, 0.0, 0.0))
    found = periods_to_violation("ur5e", arm, replace(configuration, tool_orientation=orientation))
    assert (found and found[1].cause) is expected


events = st.one_of(
    st.tuples(st.just("device"), st.sampled_from(SafetyDevice), st.booleans()),
    st.tuples(st.just("trip"), st.sampled_from([c for c in Cause if c.value.code]), st.integers(0, 5)),
    st.tuples(
        st.just("request"), st.sampled_from(["power on", "power off", "brake release", "restart safety", "play"])
    ),
    st.tuples(st.just("script"), st.just("set unlock protective stop")),
    st.tuples(st.just("supply"), st.booleans()),
    st.tuples(st.just("button"), st.booleans()),
    st.tuples(st.just("wait"), st.integers(1, 60)),
)


def happen(rig, event):
    kind, *what = event
    if kind == "device":
        rig.controller.post(SetSafetyDevice(*what))
    elif kind == "trip":
        rig.controller.post(TripSafety(*what))
    elif kind == "request":
        rig.request(*what)
    elif kind == "script":
        rig.script(*what)
    elif kind == "supply":
        rig.controller.post(ArmSupply(*what))
    elif kind == "button":
        rig.controller.post(FreedriveButton(*what))
    else:
        rig.tick(*what)
    rig.tick()


@settings(max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_every_sequence_of_events_can_be_recovered_from(make, data):
    rig = make("ur5e", running=True)
    rig.script("def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n")
    for event in data.draw(st.lists(events, max_size=25)):
        happen(rig, event)
        now = rig.now
        assert (now.safety_status_bits & 1 == 1) is (now.safety_mode is SafetyMode.NORMAL)
        if now.safety_mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
            assert now.robot_mode is RobotMode.POWER_OFF
    for device in SafetyDevice:
        happen(rig, ("device", device, False))
    happen(rig, ("supply", True))
    happen(rig, ("button", False))
    rig.controller.signals.digital_inputs |= 0b11 << 8  # the safeguard's reset
    rig.tick()
    happen(rig, ("script", "set unlock protective stop"))
    happen(rig, ("request", "restart safety"))
    happen(rig, ("script", "set unlock protective stop"))
    happen(rig, ("request", "brake release"))
    rig.until(lambda s: s.robot_mode is RobotMode.RUNNING, 2.0)
    assert rig.now.safety_mode is SafetyMode.NORMAL
