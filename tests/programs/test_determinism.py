"""The same seed and the same inputs give the same run, whatever else has happened in the process."""

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

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


THREADS = """def threads():
  thread measure():
    while True:
      write_output_float_register(1, norm(get_tcp_force()) + random())
      sync()
    end
  end
  run measure()
  force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [0.1, 0.1, 0.1, 1, 1, 1])
  sleep(0.5)
  end_force_mode()
  movej([random(), -1.4, 1.5, -1.7, -1.5, 0])
  textmsg("at ", get_actual_tcp_pose())
end
"""
PROGRAMS = {
    "pick and place": (Path(__file__).parents[2] / "examples" / "pick_and_place.script").read_text(),
    "threads": THREADS,
}
RUN = """
from emulator.journal.recorder import Checksums
from emulator.virtual import virtual_robot

def run(text, arm):
    robot = virtual_robot("ur5e", running=True, arm=arm)
    seen, sums = [], Checksums()
    robot.controller.subscribe(lambda _: seen.append(sums.of(robot.controller)))
    robot.send_script(text)
    for period in range(800):
        robot.set_digital_input(0, period % 300 > 150)
        robot.step(1)
    return seen, robot.log(50), robot.state()
"""


@pytest.mark.parametrize(("name", "arm"), [("pick and place", "dynamic"), ("threads", "ideal")])
def test_a_program_runs_the_same_twice_in_a_process_and_alone(name, arm):
    here: dict[str, Any] = {}
    exec(RUN, here)
    text = PROGRAMS[name]
    first, second = (here["run"](text, arm) for _ in range(2))
    alone = subprocess.run(
        [sys.executable, "-c", f"{RUN}\nprint(repr(run({text!r}, {arm!r})))"],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert first == second == ast.literal_eval(alone.stdout)
    assert first[1]
