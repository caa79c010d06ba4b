"""Each kind of move on each arm, in every control period, against an independent copy of its formula."""

from math import cos, exp, pi, sin, sqrt

import pytest

from tests.budget import subset
from urproto.robots import MODELS, load_model

ZERO = (0.0,) * 6
GOAL = (1.1, -1.2, 1.3, -1.3, -1.9, 0.7)  # the rig starts at (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)

every_model = pytest.mark.parametrize("name", subset(MODELS, now=("ur3", "ur5e", "ur30")))


@pytest.fixture
def start_rig(make_rig):
    """A rig by the name of its model, with the control period of its series."""
    return lambda name: make_rig(name, period_s=load_model(name).series.period_s)


def trapezoid(length, v, a):
    """Distance over time from rest to rest, and the duration."""
    peak = min(v, sqrt(length * a))
    ramp = peak / a
    cruise = (length - peak * ramp) / peak

    def way(t):
        rest = 2.0 * ramp + cruise - t
        if rest <= 0.0:
            return length
        if t < ramp:
            return 0.5 * a * t * t
        return length - 0.5 * a * rest * rest if rest < ramp else peak * (t - 0.5 * ramp)

    return way, 2.0 * ramp + cruise


def thirds(length, duration):
    """A timed move speeds up for a third of its time and slows down for a third."""
    peak = 1.5 * length / duration
    return trapezoid(length, peak, peak / (duration / 3.0))


def shifted(pose, x=0.0, y=0.0, z=0.0):
    return (pose[0] + x, pose[1] + y, pose[2] + z, *pose[3:])


def check(rig, move, expected, duration, measure, tolerance=1e-9):
    """``measure(q)`` is ``expected(t)`` in each period, and the program continues in time."""
    taken = rig.finish(move)
    period = rig.motion.period_s
    assert taken == pytest.approx(duration, abs=period)
    assert rig.fault is None
    for k, q in enumerate(rig.q):
        assert measure(q) == pytest.approx(expected(k * period), abs=tolerance), f"period {k}"


# joint moves


@every_model
@pytest.mark.parametrize(("v", "a"), [(0.5, 1.4), (3.0, 2.0), (1.0, 30.0)], ids=["trapezoid", "triangle", "steep"])
def test_movej(start_rig, name, v, a):
    rig = start_rig(name)
    start = rig.motion.q
    way, duration = trapezoid(0.8, v, a)
    share = [(b - s) / 0.8 for s, b in zip(start, GOAL, strict=True)]
    move = rig.commands.movej(GOAL, v=v, a=a)
    check(rig, move, lambda t: tuple(s + part * way(t) for s, part in zip(start, share, strict=True)), duration, tuple)


@every_model
@pytest.mark.parametrize("t", [0.6, 2.3])
def test_movej_with_time(start_rig, name, t):
    rig = start_rig(name)
    start = rig.motion.q
    way, duration = thirds(0.8, t)
    share = [(b - s) / 0.8 for s, b in zip(start, GOAL, strict=True)]
    move = rig.commands.movej(GOAL, t=t)
    assert duration == pytest.approx(t)
    check(rig, move, lambda t: tuple(s + part * way(t) for s, part in zip(start, share, strict=True)), t, tuple)


# tool moves


@every_model
@pytest.mark.parametrize(("v", "a"), [(0.1, 0.6), (0.5, 0.4)], ids=["trapezoid", "triangle"])
@pytest.mark.parametrize("command", ["movel", "movep"])
def test_line(start_rig, name, command, v, a):
    rig = start_rig(name)
    pose = rig.pose()
    way, duration = trapezoid(0.08, v, a)
    move = getattr(rig.commands, command)(shifted(pose, z=0.08), v=v, a=a)
    check(rig, move, lambda t: shifted(pose, z=way(t))[:3], duration, lambda q: rig.kinematics.forward(q)[:3], 2e-8)


@every_model
def test_movel_with_time(start_rig, name):
    rig = start_rig(name)
    pose = rig.pose()
    way, _ = thirds(0.08, 1.1)
    move = rig.commands.movel(shifted(pose, x=0.08), t=1.1)
    check(rig, move, lambda t: shifted(pose, x=way(t))[:3], 1.1, lambda q: rig.kinematics.forward(q)[:3], 2e-8)


@every_model
@pytest.mark.parametrize(("v", "a"), [(0.1, 0.8), (0.5, 0.4)], ids=["trapezoid", "triangle"])
def test_movec(start_rig, name, v, a):
    rig = start_rig(name)
    pose, radius = rig.pose(), 0.04
    way, duration = trapezoid(radius * pi, v, a)
    move = rig.commands.movec(shifted(pose, radius, radius), shifted(pose, 2.0 * radius), v=v, a=a)

    def expected(t):
        angle = way(t) / radius
        return shifted(pose, radius * (1.0 - cos(angle)), radius * sin(angle))[:3]

    check(rig, move, expected, duration, lambda q: rig.kinematics.forward(q)[:3], 2e-8)


# streams


@every_model
def test_servoj_is_critically_damped(start_rig, name):
    rig = start_rig(name)
    start, step = rig.motion.q, 0.002
    omega = 2.0 / (0.3 * 0.1 + 0.7 / sqrt(300.0))
    move = rig.commands.servoj((start[0] + step, *start[1:]), t=0.4)
    check(
        rig,
        move,
        lambda t: start[0] + step * (1.0 - (1.0 + omega * t) * exp(-omega * t)),
        0.4,
        lambda q: q[0],
        2e-7,  # closer than that, it jumps to the target
    )


@every_model
def test_speedj(start_rig, name):
    rig = start_rig(name)
    start, wanted, a = rig.motion.q, (0.4, 0.2, -0.1, 0.0, 0.3, -0.4), 1.5

    def expected(t):
        ramp = 0.4 / a
        time = 0.5 * t * t / ramp if t < ramp else t - 0.5 * ramp
        return tuple(s + speed * time for s, speed in zip(start, wanted, strict=True))

    check(rig, rig.commands.speedj(wanted, a=a, t=0.7), expected, 0.7, tuple, 0.5 * a * rig.motion.period_s**2)


@every_model
def test_speedl(start_rig, name):
    rig = start_rig(name)
    pose, v, a = rig.pose(), 0.1, 0.5

    def expected(t):
        ramp = v / a
        return shifted(pose, z=v * (0.5 * t * t / ramp if t < ramp else t - 0.5 * ramp))[:3]

    move = rig.commands.speedl((0.0, 0.0, v, 0.0, 0.0, 0.0), a=a, t=0.5)
    measure = lambda q: rig.kinematics.forward(q)[:3]  # noqa: E731
    check(rig, move, expected, 0.5, measure, 0.5 * a * rig.motion.period_s**2)


# stops


@every_model
@pytest.mark.parametrize("a", [0.7, 8.0])
def test_stopj(start_rig, name, a):
    rig = start_rig(name)
    rig.finish(rig.commands.speedj((0.6, -0.3, 0.2, 0.1, 0.0, 0.5), a=5.0))
    rig.steps(2)  # at full speed
    begin, qd = rig.motion.q, rig.motion.qd
    taken = rig.finish(rig.commands.stopj(a))
    duration = 0.6 / a
    assert taken == pytest.approx(duration, abs=rig.motion.period_s)
    assert rig.motion.q == pytest.approx([q + 0.5 * speed * duration for q, speed in zip(begin, qd, strict=True)])
    assert rig.motion.qd == ZERO


@every_model
@pytest.mark.parametrize("a", [0.3, 2.0])
def test_stopl(start_rig, name, a):
    rig = start_rig(name)
    v = 0.1
    rig.finish(rig.commands.speedl((0.0, v, 0.0, 0.0, 0.0, 0.0), a=1.0))
    rig.steps(2)  # at full speed
    begin = rig.pose()
    taken = rig.finish(rig.commands.stopl(a))
    assert taken == pytest.approx(v / a, abs=rig.motion.period_s)
    # its initial speed is the mean of the last period, so its direction is half a period old
    assert rig.pose()[:3] == pytest.approx(shifted(begin, y=0.5 * v * v / a)[:3], abs=1e-4)
    assert rig.motion.qd == ZERO


# the formulas themselves


def test_the_formulas_match_the_textbook():
    way, duration = trapezoid(2.0, 1.0, 2.0)
    assert duration == 2.5
    assert [way(t) for t in (0.0, 0.5, 1.25, 2.0, 2.5)] == [0.0, 0.25, 1.0, 1.75, 2.0]
    assert thirds(1.0, 3.0)[1] == pytest.approx(3.0)
