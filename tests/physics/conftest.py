"""A robot in virtual time with a scene."""

from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="the extra physics")  # not packaged for Python 3.10

from emulator.commands.requests import ScriptUnit
from emulator.virtual import virtual_robot

HOME = (0.0, -1.5, 1.5, -pi / 2, -pi / 2, 0.0)  # rad: tool straight down, far from singularities


class Cell:
    """A robot, its controller and its world."""

    def __init__(self, scene: Path, model: str = "ur5", **options: Any) -> None:
        options.setdefault("initial_q", HOME)
        self.robot = virtual_robot(model, world=scene, physics=True, running=True, **options)
        self.controller = self.robot.controller
        self.world: Any = self.controller.world
        self.robot.step(2)

    def seconds(self, seconds: float) -> None:
        self.robot.step(round(seconds / self.controller.period_s))

    def until(self, condition: Callable[[], bool], within_s: float = 20.0) -> None:
        for _ in range(round(within_s / self.controller.period_s)):
            if condition():
                return
            self.robot.step(1)
        raise AssertionError(f"did not happen within {within_s} s")

    def program(self, *lines: str, within_s: float = 30.0) -> None:
        """Run a program to its end."""
        self.start(*lines)
        self.until(lambda: not self.controller.programs.busy and self.stopped, within_s)

    def start(self, *lines: str) -> None:
        body = "".join(f"  {line}\n" for line in lines)
        self.controller.post(ScriptUnit(f"def test():\n{body}end\n", "block"))
        self.robot.step(2)

    @property
    def stopped(self) -> bool:
        return self.controller.programs.state.name == "STOPPED"

    def input(self, number: int) -> bool:
        return bool(self.controller.signals.digital_inputs >> number & 1)

    def output(self, number: int, level: bool) -> None:
        word = self.controller.signals.digital_outputs & ~(1 << number)
        self.controller.signals.digital_outputs = word | level << number

    def position(self, name: str) -> tuple[float, ...]:
        return self.world.pose(name)[:3]


@pytest.fixture
def cell(tmp_path: Path) -> Callable[..., Cell]:
    """A cell from the text of a world file's objects and other sections."""

    def make(*objects: str, more: str = "", **options: Any) -> Cell:
        (scene := tmp_path / "cell.yaml").write_text("objects:\n" + "".join(f"  {o}\n" for o in objects) + more)
        return Cell(scene, **options)

    return make
