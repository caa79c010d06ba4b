"""A state that is on its way for long is not taken for the present one."""

from collections.abc import AsyncIterator
from contextlib import suppress

import pytest
from driver_rig import HOME, PATIENCE_S, Lab, moved

from client import LateSetpointError, MotionError, StaleStateError, dashboard, points
from client.driver.scheduling import Standstill
from client.rtde import RTDECore
from emulator.app import Emulator
from emulator.faults.line import Delay
from emulator.faults.rtde import StaleData
from urproto.compat_asyncio import timeout
from urproto.rtde import codec
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.versions import PolyscopeVersion

LATE_S = 0.3  # of robot time
FAST = {"speed_rad_s": 3.0, "acceleration_rad_s2": 20.0}
PACK = Recipe.of(["timestamp"], OUTPUT_FIELDS).pack


@pytest.fixture
async def late(robot: Emulator) -> AsyncIterator[Lab]:
    """A robot whose states arrive late, and a caller that accepts any age."""
    lab = Lab(robot, max_age_s=60.0, silence_s=60.0)
    async with lab.arm as arm:
        await arm.make_ready()
        robot.faults.inject(Delay(port="rtde", delay_s=LATE_S))
        await arm.driver.link.state_from_now()  # at first no state arrives for that long
        yield lab


async def _move_j(lab: Lab) -> None:
    await lab.arm.move_j(moved(0.3, 0, 0, 0, 0, 0), **FAST)


async def _execute(lab: Lab) -> None:
    await lab.driver.execute([points.movej(moved(0.3, 0, 0, 0, 0, 0), v=3.0, a=20.0)])


async def _speed_j(lab: Lab) -> None:
    await lab.arm.speed_j([1.0, 0, 0, 0, 0, 0], 0.1)


async def _stop(lab: Lab) -> None:
    await lab.arm.move_j(moved(2.0, 0, 0, 0, 0, 0), **FAST, wait=False)
    await lab.until(lambda: lab.distance() > 0.1)
    await lab.arm.stop()


@pytest.mark.parametrize("motion", [_move_j, _execute, _speed_j, _stop])
async def test_arrived_means_that_the_state_is_from_after_the_arrival(late, motion):
    await motion(late)
    assert late.distance() > 0.05
    assert late.at_rest
    assert late.driver.state["actual_q"] == pytest.approx(late.q, abs=1e-3)
    assert late.arm.q == late.driver.state["actual_q"]


async def test_a_state_older_than_permitted_is_an_error_that_says_how_old(robot):
    lab = Lab(robot, max_age_s=0.05)
    async with lab.arm as arm:
        assert arm.state.age_s < 60.0
        robot.faults.inject(StaleData(timestamp="stands"))
        state = arm.driver.link.feed
        while state.state.age_s <= state.max_age_s:
            await arm.driver.next_state()
        for read in (lambda: arm.q, lambda: arm.tcp_pose, lambda: arm.digital_in(0), lambda: arm.io.analog_in(0)):
            with pytest.raises(StaleStateError, match=r"may be \d+\.\d\d s old, and max_age_s is 0\.05 s"):
                read()
        assert arm.state.q_rad == pytest.approx(HOME)
        assert arm.state.age_s > 0.05


def test_states_are_younger_than_the_last_mark_that_was_answered_before_them():
    core = RTDECore(["timestamp"])
    answer = codec.VersionReply(PolyscopeVersion(5, 12)).encode(1)
    first = core.first_mark(10.0)
    next(first)
    assert next(first, None) is None  # what it receives now
    with suppress(StopIteration):
        first.send(answer)

    def state(time_s: float) -> bytes:
        return codec.OutputData(PACK([time_s])).encode(1)

    for sent_s in (11.0, 12.0):
        assert core.mark(sent_s) == codec.GetVersion().encode(1)
    received = [*core.take(state(1.0) + answer + state(1.5) + state(1.5), 20.0)]
    received += core.take(answer + state(1.5) + state(2.0), 21.0)  # 1.5: the same state once more
    ages = [(one["timestamp"], one.taken_after_s) for one in received]
    assert ages == [(1.0, 10.0), (1.5, 11.0), (1.5, 11.0), (1.5, 11.0), (2.0, 12.0)]


def test_a_robot_that_answers_no_mark_is_believed_on_arrival():
    core = RTDECore(["timestamp"])
    assert core.mark(11.0) == b""
    assert [one.taken_after_s for one in core.take(codec.OutputData(PACK([1.0])).encode(1), 20.0)] == [20.0]


@pytest.mark.parametrize(
    ("hold", "why"),
    [
        (lambda lab: lab.driver.link.write_inputs(speed_slider_mask=1, speed_slider_fraction=0.0), "slider is at 0 %"),
        (lambda lab: lab.driver.link.dashboard.request(dashboard.PAUSE), "program is paused"),
    ],
)
async def test_a_motion_that_cannot_proceed_says_why(robot, caplog, monkeypatch, hold, why):
    monkeypatch.setattr("client.robot.motion._STUCK_S", 0.02)
    lab = Lab(robot)
    async with lab.arm as arm:
        await arm.move_j(moved(2.0, 0, 0, 0, 0, 0), wait=False)
        await lab.until(lambda: lab.distance() > 0.01)
        await hold(lab)
        async with timeout(PATIENCE_S):
            while f"move_j waits: the {why}" not in caplog.text.replace("robot's ", "").replace("speed ", ""):
                await arm.driver.next_state()
        for _ in range(50):
            await arm.driver.next_state()
        assert caplog.text.count("move_j waits") == 1


def test_a_standstill_is_reported_for_a_while(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("client.driver.scheduling._now_s", lambda: now[0])
    standstill = Standstill()

    def after(seconds: float, *, beat: bool = True) -> str:
        now[0] += seconds
        if beat:
            standstill.beat()
        return standstill.describe()

    assert not after(5.0, beat=False)  # no thread beats yet
    assert not after(0.02)
    assert not after(0.19)
    assert "stood still for 2.5 s" in after(2.5, beat=False)
    for _ in range(99):
        assert "stood still for 2.5 s" in after(0.1)
    assert not after(0.15)


async def test_states_that_come_late_are_not_blamed_on_this_machine(robot):
    lab = Lab(robot, max_age_s=60.0, silence_s=60.0)
    async with lab.arm as arm:
        await arm.make_ready()
        await arm.speed_j([0.1, 0, 0, 0, 0, 0], 60.0, wait=False)
        await lab.until(lambda: lab.distance() > 0.01)
        robot.faults.inject(Delay(port="rtde", delay_s=1.5))  # at first no state arrives for that long
        with pytest.raises(MotionError, match="the robot's next state came after") as stopped:
            await arm.wait_done()
        assert not isinstance(stopped.value, LateSetpointError)
