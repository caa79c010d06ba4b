"""The same seed and the same inputs give the same run, whatever else has happened in the process."""

import pytest

from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from urproto.robots import load_model
from urscript import compiler

PROGRAM = "def draw():\n" + "".join(f"  global x{n} = random()\n" for n in range(200))
PROGRAM += "  while True:\n    sync()\n  end\nend\n"


def started_at(robot, text=PROGRAM):
    """Steps until a program plays, and the first of its numbers."""
    began = robot.controller.step_count
    robot.send_script(text)
    robot.run_until("runtime_state == PLAYING")
    took = robot.controller.step_count - began
    robot.step(100)
    drawn = robot.controller.programs.variables["x0"]
    robot.dashboard("stop")
    robot.run_until("runtime_state == STOPPED")
    return took, drawn


def robot(**config):
    made = VirtualRobot(ControllerConfig(model=load_model("ur5e"), running=True, **config))
    made.step(5)
    return made


def test_a_program_starts_in_the_same_period_and_draws_the_same_numbers_in_the_first_robot_of_a_process_and_later(
    monkeypatch,
):
    monkeypatch.setattr(compiler, "_cache", compiler.CompiledPrograms())
    first, second = started_at(robot()), started_at(robot())
    assert first == second
    assert first[0] > 2


def test_a_robot_compiles_a_text_once():
    same = robot()
    (first, number), (again, other) = started_at(same), started_at(same)
    assert again < first
    assert number != other


@pytest.mark.parametrize("seed", [1, 2])
def test_the_seed_decides(seed):
    assert started_at(robot())[1] != started_at(robot(seed=seed))[1] == started_at(robot(seed=seed))[1]
