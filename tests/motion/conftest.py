"""An arm with its motion generator, stepped manually and checked in every control period."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from emulator.motion import Motion, MotionFault, Move
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import RobotModel, load_model

sys.path.insert(0, str(Path(__file__).parent))  # random_programs; importlib mode does not add the folder

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # rad: elbow up, far from singularities


class Rig:
    """Steps a Motion and keeps what it did, which is checked after the test."""

    def __init__(self, model: RobotModel, period_s: float = 0.002, q: tuple[float, ...] = START) -> None:
        self.model = model
        self.motion = Motion(model, period_s, q)
        self.commands = self.motion.commands
        self.kinematics = Kinematics(model.dh)
        self.q = [self.motion.q]
        self.qd = [self.motion.qd]
        self._before: list[tuple[float, ...]] = []  # each period's beginning: a test may put the arm elsewhere
        self.fault: MotionFault | None = None

    def pose(self) -> tuple[float, ...]:
        return self.kinematics.forward(self.motion.q, self.motion.tcp_offset)

    def step(self, fraction: float = 1.0) -> None:
        self._before.append(self.motion.q)
        self.fault = self.motion.advance(fraction) or self.fault
        self.q.append(self.motion.q)
        self.qd.append(self.motion.qd)

    def check(self) -> None:
        """Fail if a period since the beginning violated a joint limit or the consistency of q and qd."""
        q, qd = np.array(self.q)[1:], np.array(self.qd)[1:]
        moved = (q - np.array(self._before).reshape(q.shape)) / self.motion.period_s
        in_motion = qd.any(axis=1, keepdims=True)
        inside = (np.array(self.model.q_min) - 1e-9 <= q) & (q <= np.array(self.model.q_max) + 1e-9)
        slow = np.abs(moved) <= np.array(self.model.qd_max) * (1 + 1e-5)
        consistent = ~in_motion | (np.abs(qd - moved) < 1e-6 * np.abs(moved) + 1e-9)
        for what, kept in (("position", inside), ("speed", slow), ("speed that is not its motion", consistent)):
            assert kept.all(), f"{what} of [period, joint] {np.argwhere(~kept)[0]}"

    def steps(self, count: int, fraction: float = 1.0) -> None:
        for _ in range(count):
            self.step(fraction)

    def finish(self, move: Move, fraction: float = 1.0, at_most: int = 20_000) -> float:
        """Step until the program may continue; the time that took [s]."""
        for count in range(at_most):
            if move.ready or move.failed:
                return count * self.motion.period_s
            self.step(fraction)
        raise AssertionError("the move never became ready")

    def rest(self, fraction: float = 1.0, at_most: int = 20_000) -> float:
        """Step until the arm is idle; the time that took [s]."""
        for count in range(at_most):
            if self.motion.idle:
                return count * self.motion.period_s
            self.step(fraction)
        raise AssertionError("the arm never came to rest")

    def largest_acceleration(self) -> float:
        """Largest change of joint speed between two periods [rad/s2]."""
        changes = (
            abs(b - a)
            for before, after in zip(self.qd, self.qd[1:], strict=False)
            for a, b in zip(before, after, strict=True)
        )
        return max(changes) / self.motion.period_s


@pytest.fixture
def make_rig() -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []

    def make(name: str = "ur5e", **arguments: object) -> Rig:
        made.append(Rig(load_model(name), **arguments))
        return made[-1]

    yield make
    for rig in made:
        rig.check()


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()
