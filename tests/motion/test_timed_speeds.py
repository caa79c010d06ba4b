"""Commands with a time cover the commanded distance at any position of the speed slider."""

from math import dist, pi, sin
from random import Random

import pytest

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.robots import load_model

START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # initial position of the rig
SLIDERS = (0.01, 0.03, 0.33, 0.47, 0.51, 0.66, 0.75, 0.99, 1.0)
PERIODS = [0.002, 0.008]


def one_joint(speed):
    return (speed, 0.0, 0.0, 0.0, 0.0, 0.0)


@each_row("period_s", PERIODS)
@each_row("fraction", SLIDERS)
def test_a_speed_commanded_each_period_covers_speed_times_time(make_rig, period_s, fraction):
    rig = make_rig(period_s=period_s)
    rig.finish(rig.commands.speedj(one_joint(0.5), a=40.0), fraction)
    count, before, begun = 50, rig.motion.q[0], len(rig.q)
    for _ in range(count):
        rig.finish(rig.commands.speedj(one_joint(0.5), a=40.0, t=period_s), fraction)
    # the last command ends in the nearest period
    assert rig.motion.q[0] - before == pytest.approx(0.5 * count * period_s, abs=0.51 * 0.5 * period_s * fraction)
    assert len(rig.q) - begun == pytest.approx(count / fraction, abs=1.0)
    assert all(qd[0] == pytest.approx(0.5 * fraction) for qd in rig.qd[begun:])  # evenly


@each_row("period_s", PERIODS)
@each_row("fraction", SLIDERS[2:])
@each_row("tool", [False, True])
def test_a_spline_of_speeds_ends_at_its_target(make_rig, period_s, fraction, tool):
    """Drivers' control programs run trajectories like this: a new speed each period, timed by the program."""
    rig = make_rig(period_s=period_s)
    begin, way, duration, t, speed = rig.pose(), 0.1 if tool else 0.8, 0.8, 0.0, 0.0
    while t < duration - 1e-9:
        t += period_s
        share = t / duration
        wanted = way * (6 * share - 6 * share**2) / duration
        how = {"a": max(abs(wanted - speed) / period_s, 1e-3), "t": period_s}
        command = rig.commands.speedl if tool else rig.commands.speedj
        rig.finish(command(one_joint(wanted), **how), fraction)
        speed = wanted
    rig.steps(2, fraction)  # the rest of the last command
    # the program adds up its own periods: with 8 ms the polygon of speeds is a little less than the spline
    polygon = way * (1.0 - (period_s / duration) ** 2)
    covered = dist(rig.pose()[:3], begin[:3]) if tool else rig.motion.q[0] - START[0]
    assert covered == pytest.approx(polygon, abs=1e-4)
    assert rig.largest_acceleration() < 8.0 + 1e-6 if not tool else rig.fault is None


@each_row("seed", range(3))
@each_row("period_s", PERIODS)
def test_moving_the_slider_on_the_way_keeps_the_distance(make_rig, period_s, seed):
    rig, random = make_rig(period_s=period_s), Random(seed)
    t, speed, fraction, duration, way = 0.0, 0.0, 1.0, 0.8, 0.8
    while t < duration - 1e-9:
        t += period_s
        wanted = way * (1.0 - 2.0 * abs(t / duration - 0.5)) * 2.0 / duration
        move = rig.commands.speedj(one_joint(wanted), a=abs(wanted - speed) / period_s, t=period_s)
        speed = wanted
        while not move.ready:
            if random.random() < 0.02:
                fraction = random.choice((0.05, 0.3, 0.9, 1.0, random.random()))
            rig.step(fraction)
    rig.steps(2, fraction)  # the rest of the last command
    assert rig.motion.q[0] - START[0] == pytest.approx(way, abs=1e-4)


@each_row("fraction", SLIDERS)
@each_row("t", [0.1, 0.123, 1.0])
@each_row("period_s", PERIODS)
def test_a_single_command_covers_its_integral_to_the_period(make_rig, period_s, t, fraction):
    rig = make_rig(period_s=period_s)
    move = rig.commands.speedj(one_joint(0.4), a=8.0, t=t)
    took = rig.finish(move, fraction, at_most=100_000)
    assert took == pytest.approx(t / fraction, abs=0.51 * period_s)
    promised = 0.4 * (t - 0.5 * 0.4 / 8.0)
    assert rig.motion.q[0] - START[0] == pytest.approx(promised, abs=0.51 * 0.4 * period_s * fraction)


@each_row("fraction", SLIDERS)
@each_row("period_s", PERIODS)
def test_servoj_commands_take_their_time_on_average(make_rig, period_s, fraction):
    rig = make_rig(period_s=period_s)
    begun, count = len(rig.q), 40
    for k in range(count):
        target = (START[0] + 0.05 * sin(2 * pi * k / count), *START[1:])
        rig.finish(rig.commands.servoj(target, t=period_s, lookahead_time=0.03, gain=2000.0), fraction)
    assert len(rig.q) - begun == pytest.approx(count / fraction, abs=1.0)


def test_a_late_command_starts_afresh(rig):
    """A command that was not followed by another in time has ended; the next one starts from there."""
    rig.finish(rig.commands.speedj(one_joint(0.5), a=40.0, t=0.1))
    rig.steps(50)
    before = rig.motion.q[0]
    rig.finish(rig.commands.speedj(one_joint(0.5), a=40.0, t=0.1))
    assert rig.motion.q[0] - before == pytest.approx(0.05)


def test_another_command_of_the_same_kind_takes_over_immediately(rig):
    rig.commands.speedj(one_joint(0.5), a=40.0, t=10.0)
    rig.steps(10)
    rig.finish(rig.commands.speedj(one_joint(-0.5), a=40.0))
    rig.step()
    assert rig.motion.qd[0] == pytest.approx(-0.5)


SPLINES = """def trajectory():
  qd = [0, 0, 0, 0, 0, 0]
  def segment(goal, goal_qd, duration):
    q = get_joint_positions()  # each segment starts where the arm is then
    c2 = (3 * (goal - q) - 2 * duration * qd - duration * goal_qd) / pow(duration, 2)
    c3 = (2 * (q - goal) + duration * (qd + goal_qd)) / pow(duration, 3)
    first = qd
    t = 0.0
    while t < duration:
      step = get_steptime()
      if duration - t < step:
        step = duration - t
      end
      t = t + step
      wanted = first + 2 * t * c2 + 3 * pow(t, 2) * c3
      change = (wanted - qd) / step
      qd = wanted
      most = 0.001 + norm(change[0])
      if norm(change[1]) > most:
        most = norm(change[1])
      end
      speedj(qd, most, step)
    end
  end
  start = get_joint_positions()
  segment(start + [0.3, 0.1, 0, 0, 0, 0], [0.5, 0.1, 0, 0, 0, 0], 0.701)
  segment(start + [0.6, 0.1, 0, 0, 0, 0], [0.6, -0.2, 0, 0, 0, 0], 0.603)
  segment(start + [0.9, -0.1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], 0.8)
  stopj(4)
  set_digital_out(0, True)
end
"""


@each_row("fraction", [0.1, 0.47, 0.66, 0.9, 0.99, 1.0])
@each_row("model", ["ur3", "ur5e"])
def test_a_program_of_splines_ends_at_its_target(model, fraction):
    controller = Controller(ControllerConfig(model=load_model(model), running=True))
    controller.speed.set_slider(fraction)
    q = controller.motion.q
    controller.post(ScriptUnit(SPLINES, "splines"))
    for _ in range(round(2.5 / fraction / controller.period_s)):
        controller.tick()
    assert controller.snapshot.actual_digital_output_bits == 1
    assert controller.motion.q == pytest.approx((q[0] + 0.9, q[1] - 0.1, *q[2:]), abs=1e-4)
