"""A running arm with something to touch, driven by ticks."""

from collections.abc import Callable, Sequence
from math import pi
from typing import Any

import pytest

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.snapshot import Snapshot
from emulator.world.shapes import Plane, WorldObject
from emulator.world.world import World
from urproto.primary.messages import KeyMessage
from urproto.robots import load_model

HOME = (0.0, -1.5, 1.5, -pi / 2, -pi / 2, 0.0)  # rad: tool straight down, far from singularities


class Rig:
    """A controller and its world."""

    def __init__(self, model: str = "ur3", **config: Any) -> None:
        config.setdefault("initial_q", HOME)
        self.controller = Controller(ControllerConfig(model=load_model(model), running=True, **config))
        self.messages: list[Any] = []
        if self.controller.world is None:
            self.controller.world = World()
        self.tick()

    @property
    def world(self) -> World:
        assert self.controller.world is not None
        return self.controller.world

    @property
    def motion(self) -> Any:
        return self.controller.motion

    @property
    def now(self) -> Snapshot:
        return self.controller.snapshot

    @property
    def pose(self) -> tuple[float, ...]:
        return self.controller.arm.tcp_pose

    @property
    def force(self) -> tuple[float, ...]:
        """On the tool at its TCP, base frame."""
        return self.controller.arm.tcp_force

    @property
    def complaints(self) -> list[Any]:
        """All messages except those for the start and end of a program."""
        return [message for message in self.messages if not isinstance(message, KeyMessage)]

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.controller.tick()
            self.messages += self.controller.new_messages

    def seconds(self, seconds: float) -> None:
        self.tick(round(seconds / self.controller.period_s))

    def until(self, condition: Callable[[], bool], within_s: float = 20.0) -> float:
        """Tick until the condition holds; the time that took [s]."""
        for count in range(round(within_s / self.controller.period_s)):
            if condition():
                return count * self.controller.period_s
            self.tick()
        raise AssertionError(f"did not happen within {within_s} s: {self.messages}")

    def post(self, command: Any) -> Any:
        """The controller's answer to a command."""
        answers: list[Any] = []
        self.controller.post(command, answers.append)
        self.tick()
        assert len(answers) == 1
        return answers[0]

    def program(self, *lines: str) -> None:
        body = "".join(f"  {line}\n" for line in lines)
        self.controller.post(ScriptUnit(f"def test():\n{body}end\n", "block"))

    def table(self, below_m: float = 0.005, name: str = "table", **material: float) -> WorldObject:
        """Add a level plane below the TCP."""
        x, y, z, *_ = self.pose
        table = WorldObject(Plane(), (x, y, z - below_m, 0.0, 0.0, 0.0), **material)
        self.world.add(name, table)
        return table

    def press(
        self,
        newton: float = 10.0,
        selection: Sequence[int] = (0, 0, 1, 0, 0, 0),
        limit: float = 0.2,
        damping: float = 0.005,
        gain: float = 1.0,
    ) -> None:
        """Force mode in the base frame, downwards."""
        self.motion.force_control.damping, self.motion.force_control.gain_scaling = damping, gain
        limits = (limit,) * 3 + (1.0,) * 3
        self.motion.force_control.force_mode((0.0,) * 6, selection, (0, 0, -newton, 0, 0, 0), 2, limits)


@pytest.fixture(scope="session")  # hypothesis' tests use it
def make() -> type[Rig]:
    return Rig


@pytest.fixture
def rig() -> Rig:
    """A UR3: control periods of 8 ms."""
    return Rig()
