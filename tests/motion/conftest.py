"""An arm with its motion generator, stepped manually and checked in every control period."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from emulator.motion import Motion, MotionFault, Move
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import RobotModel, load_model

sys.path.insert(0, str(Path(__file__).parent))  # random_programs; importlib mode does not add the folder

ZERO = (0.0,) * 6
START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)  # rad: elbow up, far from singularities


class Rig:
    """Steps a Motion and fails the test if a joint limit or the consistency of q and qd is violated."""

    def __init__(self, model: RobotModel, period_s: float = 0.002, q: tuple[float, ...] = START) -> None:
        self.model = model
        self.motion = Motion(model, period_s, q)
        self.commands = self.motion.commands
        self.kinematics = Kinematics(model.dh)
        self.q = [self.motion.q]
        self.qd = [self.motion.qd]
        self.fault: MotionFault | None = None

    def pose(self) -> tuple[float, ...]:
        return self.kinematics.forward(self.motion.q, self.motion.tcp_offset)

    def step(self, fraction: float = 1.0) -> None:
        before = self.motion.q
        self.fault = self.motion.advance(fraction) or self.fault
        self.q.append(self.motion.q)
        self.qd.append(self.motion.qd)
        for i in range(6):
            moved = (self.motion.q[i] - before[i]) / self.motion.period_s
            assert self.model.q_min[i] - 1e-9 <= self.motion.q[i] <= self.model.q_max[i] + 1e-9, f"joint {i} position"
            assert abs(moved) <= self.model.qd_max[i] * (1 + 1e-5), f"joint {i} speed {moved}"
            if any(self.motion.qd):
                assert abs(self.motion.qd[i] - moved) < 1e-6 * abs(moved) + 1e-9

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
def make_rig() -> Callable[..., Rig]:
    def make(name: str = "ur5e", **arguments: object) -> Rig:
        return Rig(load_model(name), **arguments)

    return make


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()
