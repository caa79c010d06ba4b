import asyncio
from collections.abc import Callable
from itertools import pairwise

import pytest

from emulator import clock as clock_module
from emulator.clock import ClockStatistics, RealClock
from tests.rows import each_row
from tests.ticking import StepClock

MS = 1_000_000


class SimulatedTime:
    """A wall clock and its timer, moved by the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = 1_000 * MS
        self.armed_ns = 0
        self.period_ns = 0
        self.arms = 0
        self._expired: Callable[[], None] = lambda: None
        self.ticks_ns: list[int] = []
        self.tick_takes_ns = 0
        monkeypatch.setattr(clock_module.time, "monotonic_ns", lambda: self.now_ns)
        monkeypatch.setattr(clock_module, "_timer", self._timer)
        monkeypatch.setattr(clock_module.asyncio, "get_running_loop", lambda: None)

    def _timer(self, loop: object, expired: Callable[[], None]) -> "SimulatedTime":
        self._expired = expired
        return self

    def arm(self, deadline_ns: int, period_ns: int) -> None:
        self.armed_ns, self.period_ns = deadline_ns, period_ns
        self.arms += 1

    def disarm(self) -> None:
        self.armed_ns = self.period_ns = 0

    def close(self) -> None:
        pass

    def tick(self) -> None:
        self.ticks_ns.append(self.now_ns)
        self.now_ns += self.tick_takes_ns

    def run(self, ticks: int, late_ns: int = 0) -> None:
        """Let the timer expire, each time with this delay."""
        for _ in range(ticks):
            self.now_ns = max(self.now_ns, self.armed_ns) + late_ns
            self.armed_ns += self.period_ns
            self._expired()


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> SimulatedTime:
    return SimulatedTime(monkeypatch)


def test_deadlines_are_absolute(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    start = simulated.armed_ns
    simulated.run(1000, late_ns=300_000)
    assert simulated.armed_ns == start + 1000 * 2 * MS
    assert clock.statistics.missed == 0
    assert clock.statistics.latest_ns == 300_000
    assert simulated.arms == 1


def test_the_timer_is_rearmed_only_off_the_grid(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    simulated.run(2)
    simulated.run(1, late_ns=MS)  # the next one is 1 ms away, less than the minimum between two ticks
    simulated.run(20)
    assert simulated.arms == 3  # at the start, later than the grid, and back on it


def test_a_speed_set_within_a_tick_applies_from_the_next_tick(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(lambda: clock.set_speed(2.0) if clock.statistics.ticks == 2 else None)
    simulated.run(2)
    assert simulated.armed_ns - simulated.now_ns == 2 * MS  # restarted, and the period of this tick
    simulated.run(1)
    assert simulated.armed_ns - simulated.now_ns == MS
    assert clock.statistics.latest_ns == 0


def test_speed_shortens_the_period(simulated: SimulatedTime) -> None:
    clock = RealClock(0.008, speed=10.0)
    clock.start(simulated.tick)
    simulated.run(3)
    assert simulated.ticks_ns[2] - simulated.ticks_ns[0] == 16 * MS // 10


def test_a_late_tick_is_made_up_for_without_a_burst(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    start = simulated.armed_ns
    simulated.run(1)
    simulated.run(1, late_ns=21 * MS)
    simulated.run(40)
    gaps = [after - before for before, after in pairwise(simulated.ticks_ns)]
    assert min(gaps) == 1_200_000
    assert simulated.ticks_ns[-1] == start + 41 * 2 * MS  # back on the grid, no period lost
    assert clock.statistics.missed > 10


def test_a_long_interruption_is_not_made_up_for(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    simulated.run(1)
    simulated.run(1, late_ns=5_000 * MS)
    assert 0 < simulated.armed_ns - simulated.now_ns <= 2 * MS
    assert clock.statistics.missed == pytest.approx(2500, abs=2)


def test_a_machine_that_is_too_slow_builds_up_no_backlog(
    simulated: SimulatedTime, caplog: pytest.LogCaptureFixture
) -> None:
    clock = RealClock(0.002)
    simulated.tick_takes_ns = 3 * MS
    clock.start(simulated.tick)
    simulated.run(5_000)
    assert simulated.now_ns - clock._deadline_ns < 300 * MS
    assert "too slow or too busy" in caplog.text
    assert len(caplog.records) <= 3


@each_row("speed", [0.0, -1.0, float("nan")])
def test_impossible_speeds_are_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        RealClock(0.002, speed)


def test_statistics_report_fractions() -> None:
    statistics = ClockStatistics()
    for lateness_us in range(1, 101):
        statistics.record(lateness_us * 10_000 - 1, 2 * MS)
    assert statistics.lateness_s(0.5) == pytest.approx(0.0005)
    assert statistics.lateness_s(1.0) == pytest.approx(0.001)
    assert statistics.ticks == 100
    assert ClockStatistics().lateness_s(0.5) == 0.0


@pytest.mark.parametrize("kind", ["timerfd", "loop"])
async def test_the_clock_runs_in_real_time(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "loop":
        monkeypatch.setattr(clock_module, "_timer", clock_module._LoopTimer)
    done = asyncio.Event()
    clock = RealClock(0.002)

    def tick() -> None:
        if clock.statistics.ticks >= 25:
            done.set()

    loop = asyncio.get_running_loop()
    began = loop.time()
    clock.start(tick)
    await asyncio.wait_for(done.wait(), 5.0)
    clock.close()
    ticks = clock.statistics.ticks
    await asyncio.sleep(0.01)
    assert clock.statistics.ticks == ticks
    assert loop.time() - began >= 0.05


async def test_a_failing_tick_does_not_stop_the_clock() -> None:
    seen: list[str] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: seen.append(str(context["exception"])))
    done = asyncio.Event()
    clock = RealClock(0.001)

    def tick() -> None:
        if clock.statistics.ticks == 1:
            raise RuntimeError("once")
        done.set()

    clock.start(tick)
    await asyncio.wait_for(done.wait(), 5.0)
    clock.close()
    assert seen == ["once"]


def test_steps() -> None:
    clock = StepClock()
    with pytest.raises(RuntimeError, match="context"):
        clock.step()
    ticks: list[int] = []
    clock.start(lambda: ticks.append(1))
    clock.step(3)
    clock.close()
    assert len(ticks) == 3


def test_paused_time_is_not_made_up_for(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    simulated.run(3)
    clock.pause()
    simulated.run(1)
    assert len(simulated.ticks_ns) == 3
    assert not simulated.armed_ns
    simulated.now_ns += 1_000 * MS
    clock.resume()
    simulated.run(3)
    assert [later - earlier for earlier, later in pairwise(simulated.ticks_ns[3:])] == [2 * MS, 2 * MS]
    assert clock.statistics.missed == 0


def test_the_speed_can_change_while_running(simulated: SimulatedTime) -> None:
    clock = RealClock(0.002)
    clock.start(simulated.tick)
    simulated.run(2)
    clock.set_speed(2.0)
    simulated.run(3)
    clock.set_speed(float("inf"))
    simulated.tick_takes_ns = 100_000
    simulated.run(4)
    gaps = [later - earlier for earlier, later in pairwise(simulated.ticks_ns)]
    assert gaps == [2 * MS, MS, MS, MS, 0, 100_000, 100_000, 100_000]
