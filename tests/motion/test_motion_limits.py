"""Any command keeps positions and speeds within the joints' limits (the rig checks every period), and ends at rest."""

from math import pi

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.motion import MotionFault
from emulator.motion.position_limits import PositionLimits
from tests.budget import examples
from urproto.robots import load_model

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig

angle = st.floats(-6.3, 6.3)
small = st.floats(-0.3, 0.3)
six = st.tuples(*[small] * 6)
rate = st.floats(0.05, 60.0)
radius = st.sampled_from([0.0, 0.0, 0.02, 0.1])

command = st.one_of(
    st.tuples(st.just("movej"), st.tuples(*[angle] * 6), rate, rate, radius),
    st.tuples(st.just("movel"), six, rate, rate, radius),
    st.tuples(st.just("movep"), six, rate, rate, radius),
    st.tuples(st.just("movec"), six, rate, rate, radius),
    st.tuples(st.just("servoj"), st.tuples(*[angle] * 6), rate, rate, radius),
    st.tuples(st.just("servoc"), six, rate, rate, radius),
    st.tuples(st.just("speedj"), st.tuples(*[angle] * 6), rate, rate, radius),
    st.tuples(st.just("speedl"), six, rate, rate, radius),
    st.tuples(st.just("stopj"), six, rate, rate, radius),
    st.tuples(st.just("stopl"), six, rate, rate, radius),
    st.tuples(st.just("pause"), six, rate, rate, radius),
    st.tuples(st.just("protective_stop"), six, rate, rate, radius),
    st.tuples(st.just("resume"), six, rate, rate, radius),
    st.tuples(st.just("stop"), six, rate, rate, radius),
)


def give(rig, name, values, a, v, r):
    motion = rig.motion
    near = tuple(p + d for p, d in zip(rig.pose(), values, strict=True))
    via = tuple(p + d for p, d in zip(rig.pose(), (0.05, 0.02, 0, 0, 0, 0), strict=True))
    calls = {
        "movej": lambda: motion.commands.movej(values, a=a, v=v, r=r),
        "movel": lambda: motion.commands.movel(near, a=a, v=v, r=r),
        "movep": lambda: motion.commands.movep(near, a=a, v=v, r=r),
        "movec": lambda: motion.commands.movec(via, near, a=a, v=v, r=r, mode=int(a) % 2),
        "servoj": lambda: motion.commands.servoj(values, t=0.008),
        "servoc": lambda: motion.commands.servoc(near, a=a, v=v, r=r),
        "speedj": lambda: motion.commands.speedj(values, a=a),
        "speedl": lambda: motion.commands.speedl(values, a=a),
        "stopj": lambda: motion.commands.stopj(a),
        "stopl": lambda: motion.commands.stopl(a),
        "pause": motion.pause,
        "protective_stop": motion.protective_stop,
        "resume": motion.resume,
        "stop": motion.commands.stop,
    }
    calls[name]()


@pytest.mark.parametrize("name", ["ur3", "ur5e", "ur10"])
@settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    program=st.lists(st.tuples(command, st.integers(1, 60), st.sampled_from([1.0, 1.0, 0.3, 0.0])), max_size=8),
)
def test_random_programs_keep_limits_and_end_at_rest(make_rig, name, program):
    rig = make_rig(name, period_s=0.008)
    for what, periods, fraction in program:
        give(rig, *what)
        rig.steps(periods, fraction)
    rig.motion.resume()
    rig.motion.program_stopped()
    rig.rest()
    assert rig.motion.qd == ZERO
    stood = rig.motion.q
    rig.steps(3)
    assert rig.motion.q == stood


def test_a_tool_path_past_a_singular_wrist_slows_down_and_arrives(make_rig):
    """2 mm from the wrist singularity: at full tool speed, wrist 1 would have to turn ten times too fast."""
    rig = make_rig(q=(0.3, -1.6, 1.7, -1.5, -0.2, 0.2))
    start = rig.motion.q
    beyond = rig.kinematics.forward((0.3, -1.6, 1.7, -1.5, 0.2, 0.2))
    before = rig.pose()
    goal = (*(a + 2 * (b - a) / 2 for a, b in zip(before[:3], beyond[:3], strict=True)), *beyond[3:])
    goal = (goal[0], goal[1], goal[2] + 0.004, goal[3], goal[4] + 0.02, goal[5])
    move = rig.commands.movel(goal, v=1.0, a=5.0)
    taken = rig.finish(move)
    assert move.failed is None
    assert rig.pose() == pytest.approx(goal, abs=1e-8)
    assert taken > 0.1
    assert rig.motion.q != start


def test_tool_path_from_the_stretched_arm(make_rig):
    """The arm's first position is singular twice; a sideways line down from it is still possible."""
    rig = make_rig(q=(0.0, -1.57, 0.0, -1.57, 0.0, 0.0))
    pose = rig.pose()
    goal = (pose[0] + 0.1, pose[1], pose[2] - 0.2, *pose[3:])
    move = rig.commands.movel(goal)
    rig.finish(move)
    if move.failed is None:
        assert rig.pose() == pytest.approx(goal, abs=1e-8)
    rig.rest()
    assert rig.motion.qd == ZERO


def test_joint_move_exactly_to_the_limit(rig):
    limit = rig.model.q_max[0]
    rig.finish(rig.commands.movej((limit, *START[1:]), a=40.0, v=pi))
    assert rig.fault is None
    assert rig.motion.q[0] == limit


def test_servo_exactly_to_the_limit(rig):
    limit = rig.model.q_max[5]
    rig.commands.servoj((*START[:5], limit), t=0.0, lookahead_time=0.03, gain=2000)
    rig.step()
    rig.rest()
    assert rig.fault is None
    assert rig.motion.q[5] == limit


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_must_be_able_to_stop_before_either_of_its_limits(way):
    model, period_s, speed = load_model("ur5e"), 0.002, 2.0
    limits = PositionLimits(model, period_s)
    needed = speed * speed / (2.0 * model.qdd_max[0])
    edge = limits.high[0] if way > 0.0 else limits.low[0]

    def look(room):
        at = edge - way * room
        limits.check((at, *START[1:]), (at - way * speed * period_s, *START[1:]))

    look(needed + 0.001)
    with pytest.raises(MotionFault):
        look(needed - 0.01)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_first_step_too_far_is_detected_even_when_coming_from_afar(way):
    """Far from its limits the arm is checked less closely, but no step on the way back may be missed."""
    model, step = load_model("ur5e"), 0.003
    limits = PositionLimits(model, 0.002)
    edge = limits.high[3] if way > 0.0 else limits.low[3]
    braking = (step / 0.002) ** 2 / (2.0 * model.qdd_max[3])

    def pass_by(at):
        there = at + way * step
        limits.check((*START[:3], there, *START[4:]), (*START[:3], at, *START[4:]))
        return there

    at = edge - way * 1.0
    while abs(edge - at) > braking + 2.0 * step:
        at = pass_by(at)
    with pytest.raises(MotionFault):
        pass_by(pass_by(pass_by(at)))


def test_narrower_limits_apply_from_the_next_step():
    limits = PositionLimits(load_model("ur5e"), 0.002)
    near = (START[0] + 0.001, *START[1:])
    limits.check(near, START)
    limits.check(START, near)
    limits.use((-1.0,) * 6, (0.25, *limits.high[1:]))
    with pytest.raises(MotionFault):
        limits.check(near, START)
