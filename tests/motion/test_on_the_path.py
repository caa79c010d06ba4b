"""Changes of speed on any arm do not change the path of a move, and limits are kept.

Geometry is independent of the code under test: lines and circles by their definitions.
"""

from itertools import pairwise
from math import dist, sqrt

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from tests.budget import examples, subset
from urproto.robots import MODELS, load_model

GOAL = (1.1, -1.2, 1.3, -1.3, -1.9, 0.7)  # the rig starts at (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)
ON_PATH_M = 1e-6
OUT_OF_REACH = 204
STRETCHED_RAD = 0.2

every_model = pytest.mark.parametrize("name", subset(MODELS, now=("ur3", "ur5e", "ur30")))
few = settings(max_examples=examples(2), deadline=None, suppress_health_check=list(HealthCheck))


def minus(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def off_line(point, start, end):
    """Distance from the segment between two points."""
    way, there = minus(end, start), minus(point, start)
    share = max(0.0, min(1.0, dot(there, way) / dot(way, way)))
    return dist(point, [s + share * w for s, w in zip(start, way, strict=True)])


def off_joint_line(rig, goal):
    """Largest distance [rad] of any configuration so far from the straight line to the goal in joint space."""
    return max(off_line(q, rig.q[0], goal) for q in rig.q)


def places(rig):
    return [rig.kinematics.forward(q)[:3] for q in rig.q]


def shifted(pose, x=0.0, y=0.0, z=0.0):
    return (pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:])


# slider, pause and protective stop at any moment

_touches = st.lists(
    st.tuples(
        st.integers(1, 25),  # periods of 8 ms
        st.one_of(st.floats(0.0, 1.0), st.sampled_from((0.0, 1.0, "pause", "protective stop", "resume"))),
    ),
    min_size=1,
    max_size=12,
)


def disturbed(rig, move, touches):
    """Execute a move with random slider changes and stops."""
    fraction = 1.0
    for periods, touch in touches:
        match touch:
            case "pause":
                rig.motion.pause()
            case "protective stop":
                rig.motion.protective_stop()
            case "resume":
                rig.motion.resume()
            case _:
                fraction = touch
        rig.steps(max(1, round(periods * 0.008 / rig.motion.period_s)), fraction)
    rig.motion.resume()
    rig.finish(move)
    assert rig.fault is None
    # the last period of a protective stop also removes the acceleration of the move
    assert rig.largest_acceleration() <= min(rig.model.qdd_max) * 1.25, "speed never steps"


@pytest.fixture
def start_rig(make_rig):
    return lambda name: make_rig(name, period_s=load_model(name).series.period_s)


@every_model
@few
@given(touches=_touches)
def test_movej_stays_on_its_joint_line(start_rig, name, touches):
    rig = start_rig(name)
    disturbed(rig, rig.commands.movej(GOAL, v=1.5, a=5.0), touches)
    assert off_joint_line(rig, GOAL) < 1e-9
    assert rig.motion.q == GOAL


@every_model
@pytest.mark.parametrize("command", ["movel", "movep"])
@few
@given(touches=_touches)
def test_lines_stay_straight(start_rig, name, command, touches):
    rig = start_rig(name)
    start = rig.pose()
    goal = shifted(start, 0.04, 0.05, 0.06)
    disturbed(rig, getattr(rig.commands, command)(goal, v=0.4, a=2.0), touches)
    assert max(off_line(place, start[:3], goal[:3]) for place in places(rig)) < ON_PATH_M
    assert rig.pose() == pytest.approx(goal, abs=1e-9)


@every_model
@few
@given(touches=_touches)
def test_arcs_stay_round(start_rig, name, touches):
    rig = start_rig(name)
    start, radius = rig.pose(), 0.04
    centre = shifted(start, x=radius)
    disturbed(rig, rig.commands.movec(shifted(centre, y=radius), shifted(centre, x=radius), v=0.4, a=2.0), touches)
    for x, y, z in places(rig):
        assert sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2) == pytest.approx(radius, abs=ON_PATH_M)
        assert z == pytest.approx(centre[2], abs=ON_PATH_M)
        assert y >= centre[1] - ON_PATH_M, "on the half over the via point"


@every_model
@few
@given(touches=_touches)
def test_a_blended_corner_has_the_same_path_at_any_speed(start_rig, name, touches):
    """At any speed, the corner has the same path as without disturbance."""

    def corner(rig, touches):
        start = rig.pose()
        rig.finish(rig.commands.movel(shifted(start, 0.07), v=0.2, r=0.03))
        disturbed(rig, rig.commands.movel(shifted(start, 0.07, 0.07), v=0.2), touches)
        return places(rig)

    undisturbed, path = corner(start_rig(name), []), corner(start_rig(name), touches)
    pieces = list(pairwise(undisturbed))
    for place in path[::25]:
        assert min(off_line(place, a, b) for a, b in pieces if a != b) < 2e-5  # chords of a curve sampled each period


# blends


_way = st.tuples(*[st.floats(-0.08, 0.08)] * 3).filter(lambda way: dist(way, (0, 0, 0)) > 0.03)
_bend = st.tuples(*[st.floats(-0.5, 0.5)] * 6).filter(lambda bend: max(map(abs, bend)) > 0.1)
_radius = st.floats(0.002, 0.1)


def check_blend(rig, moves):
    """Two moves, the second commanded as soon as the first is ready; no joint exceeds its acceleration.

    On an arm that is almost stretched out, a path determines the joints: twice as much is allowed there.
    """
    for move in moves:
        rig.finish(move())
    rig.rest()
    assume(rig.fault is None or rig.fault.code != OUT_OF_REACH)  # of the smallest arms
    assert rig.fault is None
    stretched = min(abs(q[2]) for q in rig.q) < STRETCHED_RAD
    assert rig.largest_acceleration() <= max(rig.model.qdd_max) * (2.0 if stretched else 1.01)


@every_model
@pytest.mark.parametrize("command", ["movel", "movep"])
@few
@given(first=_way, second=_way, radius=_radius, v=st.floats(0.05, 0.5))
def test_tool_blends(start_rig, name, command, first, second, radius, v):
    rig = start_rig(name)
    start = rig.pose()
    corner = shifted(start, *first)
    goal = shifted(corner, *second)
    move = getattr(rig.commands, command)
    check_blend(rig, [lambda: move(corner, v=v, r=radius), lambda: move(goal, v=v)])
    assert rig.pose() == pytest.approx(goal, abs=1e-8)
    for before, here in pairwise(places(rig)):
        assert dist(before, here) <= v * rig.motion.period_s * (1 + 1e-6) + 1e-9, "never faster than asked for"
        if dist(here, corner[:3]) > radius:
            off = min(off_line(here, start[:3], corner[:3]), off_line(here, corner[:3], goal[:3]))
            assert off < ON_PATH_M, "outside the radius the path is that of the moves"


@every_model
@few
@given(first=_bend, second=_bend, radius=_radius, v=st.floats(0.2, 2.0))
def test_joint_blends(start_rig, name, first, second, radius, v):
    rig = start_rig(name)
    start = rig.motion.q
    corner = tuple(q + bend for q, bend in zip(start, first, strict=True))
    goal = tuple(q + bend for q, bend in zip(corner, second, strict=True))
    move = rig.commands.movej
    check_blend(rig, [lambda: move(corner, v=v, a=4.0, r=radius), lambda: move(goal, v=v, a=4.0)])
    assert rig.motion.q == goal
    centre = rig.kinematics.forward(corner)[:3]
    for q, qd in zip(rig.q, rig.qd, strict=True):
        assert max(map(abs, qd)) <= v * (1 + 1e-6), "never faster than asked for"
        if dist(rig.kinematics.forward(q)[:3], centre) > radius + 1e-4:
            assert min(off_line(q, start, corner), off_line(q, corner, goal)) < 1e-6
