"""From any pose: moves to the current position, to the upright pose and back, and impossible paths."""

from math import pi
from random import Random

import pytest

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.budget import subset
from tests.rows import each_row
from urproto.modes import SafetyMode
from urproto.robots import MODELS, START_Q, load_model

UPRIGHT = (0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0)  # everything is singular
POSES = 84  # of each of the twelve arms: a thousand
AT_ONCE = {"movel", "movep", "movec", "servoc"}


def stay(rig, command):
    """Move to the current pose: the arm stays there, except for effects of rounding on singular joints."""
    pose, before = rig.motion.target.reach.pose(rig.motion.q), rig.motion.q
    move = rig.commands.movec(pose, pose) if command == "movec" else getattr(rig.commands, command)(pose)
    assert rig.finish(move) <= 2 * rig.motion.period_s
    assert move.failed is rig.fault is None
    assert rig.motion.q == pytest.approx(before, abs=2e-6)


@pytest.mark.parametrize("name", subset(MODELS, now=["ur3", "ur5e", "ur30"]))
def test_moves_to_the_present_pose_to_upright_and_back(make_rig, name):
    model, random = load_model(name), Random(name)
    for _ in range(POSES):
        start = tuple(
            random.uniform(max(low, -3.0), min(high, 3.0)) for low, high in zip(model.q_min, model.q_max, strict=True)
        )
        rig = make_rig(name, period_s=0.008, q=start)
        for command in sorted(AT_ONCE):
            stay(rig, command)
        upright = random.choice((UPRIGHT, tuple(round(angle, 4) for angle in UPRIGHT)))
        for goal in (upright, start):
            move = rig.commands.movej(goal, a=20.0, v=3.0)
            rig.rest()
            assert move.failed is rig.fault is None
            assert rig.motion.q == goal
            if goal is upright:
                for command in sorted(AT_ONCE):
                    stay(rig, command)
                rig.motion.set_position(goal)


@each_row("length_m", [0.0, 1e-16, 1e-12, 1e-9, 1.1e-9, 1e-8, 1e-7])
@each_row("command", ["movel", "movep", "servoc"])
def test_arbitrarily_short_paths(make_rig, command, length_m):
    for q in (UPRIGHT, (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)):
        rig = make_rig(q=q)
        x, *rest = rig.pose()
        rig.finish(getattr(rig.commands, command)((x, rest[0], rest[1] - length_m, *rest[2:])))
        assert rig.fault is None


@pytest.mark.parametrize("model", ["ur3", "ur5e"])
def test_a_program_continues_at_the_upright_pose(model):
    controller = Controller(ControllerConfig(model=load_model(model), running=True))
    program = """def stand_up():
      movej([0, -1.5708, 0, -1.5708, 0, 0], a=10, v=3)
      movel(get_actual_tcp_pose())
      movej([-0.6912, -1.7813, -1.2674, -1.6883, 1.6675, 0.0947], a=10, v=3)
      movej([0, -1.5707963267948966, 0, -1.5707963267948966, 0, 0], a=10, v=3)
      movep(get_actual_tcp_pose())
      set_digital_out(1, True)
    end
    """
    controller.post(ScriptUnit(program, "stand up"))
    for _ in range(round(10.0 / controller.period_s)):
        controller.tick()
    assert controller.snapshot.safety_mode is SafetyMode.NORMAL
    assert controller.snapshot.actual_digital_output_bits == 2
    assert not controller.snapshot.program_running


def test_a_path_leaving_the_workspace_differs_from_a_goal_out_of_reach(make_rig):
    rig = make_rig("ur3", q=START_Q)
    x, y, *rest = rig.pose()
    move = rig.commands.movel((-x, -y, *rest))  # straight through the column of the robot
    rig.rest()
    assert move.failed is not None
    assert "leads through p[" in move.failed.text
    assert f"path to p[{-x:.4f}" in move.failed.text
    far = make_rig("ur3", q=START_Q).commands.movel((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert far.failed is not None
    assert "p[2.0000, 0.0000, 0.0000" in far.failed.text
    assert "is out of reach" in far.failed.text
