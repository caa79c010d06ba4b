"""Jogging: ramps, joint limits and singularities, on an arm with a delay."""

import asyncio
import math
from collections import deque
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from client.pendant.jogging import Bounds, Ramp
from client.pendant.mover import STALE_S
from client.pendant.screens.move_jog import JogPanels
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.robots import MODELS, RobotModel, kinematics_of, load_model
from urproto.robots.pose import pose_add, rotvec_to_matrix

PERIOD_S = 0.02
DELAY = 3  # periods between a speed and the angles that show it
BENT = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
MAX_DISTANCE_RAD = 0.05


class SimulatedArm:
    """Follows speeds immediately, and reports its position some periods later."""

    def __init__(self, model: RobotModel, q_rad: Sequence[float], space: str) -> None:
        low, high = model.position_limits
        self.kinematics = kinematics_of(model)
        self.ramp = Ramp(space, Bounds(low, high, model.qd_max, self.kinematics))  # type: ignore[arg-type]
        self.space = space
        self.q = list(q_rad)
        self.reported = deque([tuple(q_rad)] * DELAY)
        self.speeds = list[tuple[float, ...]]()
        self.joint_speeds = list[list[float]]()
        self.slowed = set[str]()

    def run(self, target: Sequence[float] | None, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            q = self.reported.popleft()
            speeds = self.ramp.next(target, q, self.kinematics.forward(q), PERIOD_S)
            self.speeds.append(speeds)
            self.slowed.add(self.ramp.slowed)
            before = list(self.q)
            if self.space == "joints":
                self.q = [angle + PERIOD_S * speed for angle, speed in zip(self.q, speeds, strict=True)]
            else:
                goal = pose_add([PERIOD_S * speed for speed in speeds], self.kinematics.forward(self.q))
                solution = self.kinematics.inverse_near(goal, self.q, (-math.inf,) * 6, (math.inf,) * 6)
                assert solution is not None, "the target is out of reach"
                self.q = list(solution)
            self.joint_speeds.append([(b - a) / PERIOD_S for a, b in zip(before, self.q, strict=True)])
            self.reported.append(tuple(self.q))


def single_axis(axis: int, speed: float) -> tuple[float, ...]:
    return tuple(speed if i == axis else 0.0 for i in range(6))


def accelerations(speeds: Sequence[Sequence[float]]) -> list[float]:
    """The largest acceleration of each period [1/s2]."""
    pairs = zip([(0.0,) * 6, *speeds], speeds, strict=False)
    return [max(abs(b - a) for a, b in zip(one, other, strict=True)) / PERIOD_S for one, other in pairs]


def test_joint_speed_ramps_up_and_down() -> None:
    arm = SimulatedArm(load_model("ur5e"), BENT, "joints")
    arm.run(single_axis(0, 1.0), 2.0)
    assert arm.speeds[-1] == single_axis(0, 1.0)
    assert max(accelerations(arm.speeds)) == pytest.approx(1.4)
    up = len(arm.speeds)
    arm.run(None, 0.3)
    assert arm.ramp.at_rest
    assert max(accelerations(arm.speeds)[up:]) == pytest.approx(4.0)
    assert arm.slowed == {""}


def test_reversal_passes_through_rest() -> None:
    arm = SimulatedArm(load_model("ur5e"), BENT, "joints")
    arm.run(single_axis(3, 1.0), 1.0)
    arm.run(single_axis(3, -1.0), 2.0)
    assert arm.speeds[-1] == single_axis(3, -1.0)
    assert 0.0 in [speeds[3] for speeds in arm.speeds[50:]]
    assert max(accelerations(arm.speeds)) <= 4.0 + 1e-9


@each_row("name", MODELS)
@each_row("sign", [-1.0, 1.0])
def test_every_joint_stops_just_before_its_limit(name: str, sign: float) -> None:
    model = load_model(name)
    for joint in range(6):
        limits = model.position_limits[1 if sign > 0 else 0]
        if math.isinf(limits[joint]):
            continue
        start = single_axis(joint, limits[joint] - sign * 1.0)
        arm = SimulatedArm(model, start, "joints")
        arm.run(single_axis(joint, sign * model.qd_max[joint]), 8.0)
        remaining = sign * (limits[joint] - arm.q[joint])
        assert 0.0 < remaining < MAX_DISTANCE_RAD
        assert max(accelerations(arm.speeds)) <= 4.0 + 1e-9
        assert any("limit" in why for why in arm.slowed)
        arm.run(None, 0.5)
        arm.run(single_axis(joint, -sign), 1.0)
        assert arm.speeds[-1] == single_axis(joint, -sign), "it cannot leave the limit"


def test_tool_motion_stops_before_joint_limit() -> None:
    model = load_model("ur5e")
    high = model.position_limits[1][5]
    arm = SimulatedArm(model, (*BENT[:5], high - 0.8), "tool")
    axis = rotvec_to_matrix(*arm.kinematics.forward(arm.q)[3:])[2::3]  # of the last joint
    arm.run((0.0, 0.0, 0.0, *axis), 4.0)
    assert 0.0 < high - arm.q[5] < MAX_DISTANCE_RAD
    assert "Wrist 3 nears its limit" in arm.slowed
    arm.run((0.0, 0.0, 0.0, *(-part for part in axis)), 2.0)
    assert arm.q[5] < high - 0.5


@each_row("name", ["ur3", "ur5e", "ur20"])
@each_row("axis", [0, 1, 2])
@each_row("sign", [-1.0, 1.0])
def test_tool_stops_smoothly_at_end_of_reach(name: str, axis: int, sign: float) -> None:
    model = load_model(name)
    arm = SimulatedArm(model, BENT, "tool")
    arm.run(single_axis(axis, sign * 0.25), 11.0)
    assert max(abs(speed) for speeds in arm.joint_speeds for speed in speeds) < 0.7 * max(model.qd_max)
    assert max(accelerations([speeds[:3] + (0.0,) * 3 for speeds in arm.speeds])) <= 2.5 + 1e-9
    assert any(arm.slowed), "every path ends at the reach"
    assert math.hypot(*arm.speeds[-1]) < 0.001


def test_unobstructed_tool_moves_straight_at_full_speed() -> None:
    arm = SimulatedArm(load_model("ur5e"), BENT, "tool")
    before = arm.kinematics.forward(arm.q)
    arm.run(single_axis(2, 0.1), 1.0)
    arm.run(None, 0.3)
    after = arm.kinematics.forward(arm.q)
    assert arm.slowed == {""}
    assert after[2] - before[2] == pytest.approx(0.1, abs=0.015)
    assert math.dist(before[:2], after[:2]) < 1e-9


def test_singularity_is_left_by_joint_motion_only() -> None:
    upright = (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0)
    arm = SimulatedArm(load_model("ur5e"), upright, "tool")
    arm.run(single_axis(2, -0.1), 1.0)
    assert arm.q == pytest.approx(upright)
    assert set(arm.speeds) == {(0.0,) * 6}
    assert "singularity" in arm.ramp.slowed
    arm = SimulatedArm(load_model("ur5e"), upright, "joints")
    arm.run(single_axis(2, 0.5), 1.0)
    assert arm.q[2] > 0.2


def test_arm_of_unknown_geometry_can_be_jogged() -> None:
    endless = ((-math.inf,) * 6, (math.inf,) * 6)
    ramp = Ramp("tool", Bounds(*endless, (math.inf,) * 6))
    for _ in range(50):
        speeds = ramp.next(single_axis(0, 0.1), BENT, (0.0,) * 6, PERIOD_S)
    assert speeds == single_axis(0, 0.1)


class FakeMover:
    """A mover that only supports freedrive."""

    def __init__(self) -> None:
        self.freedrive = False
        self.changed = asyncio.Event()

    async def start_freedrive(self) -> None:
        self.freedrive = True
        self.changed.clear()
        await self.changed.wait()

    def end_freedrive(self) -> None:
        self.freedrive = False
        self.changed.set()


async def test_freedrive_ends_without_messages_and_resumes_with_them() -> None:
    mover, errors = FakeMover(), list[str]()

    async def attempt(action: Any) -> None:
        await action()

    station = SimpleNamespace(mover=mover, situation=SimpleNamespace(require=lambda action: None))
    live = SimpleNamespace(on_held=[], screen="move")
    page: Any = SimpleNamespace(
        station=station, live=live, move_confirmed=True, attempt=attempt, show_error=errors.append
    )
    JogPanels(page, SimpleNamespace())  # type: ignore[arg-type]
    (report_held,) = live.on_held

    async def until(freedrive: bool, *, report: bool) -> None:
        async with timeout(20.0):
            while mover.freedrive != freedrive:
                if report:
                    report_held({"freedrive": True})
                await asyncio.sleep(STALE_S / 20)

    await until(True, report=True)
    await until(False, report=False)
    await until(True, report=True)
    report_held(None)
    assert not mover.freedrive
    await asyncio.sleep(0)
    assert not errors
