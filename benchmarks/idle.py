"""What a robot costs that nobody moves, in real time: between two periods it sleeps, and wakes up cold.

Beside it, in turn, a clock of the same kind whose tick does nothing: what waking up costs any program in this language.
"""

import asyncio
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from statistics import median

from table import Table

from emulator.app import Emulator
from emulator.clock import RealClock
from emulator.config import EmulatorConfig
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.realtime import claim_real_time
from urproto.robots import load_model

SECONDS = 10.0
ROUNDS = 3
_SETTLE_S = 1.5  # the first periods pay for first-time costs
_BARE, _OFF, _RUNNING = "clock alone", "arm off", "brakes released"
_MODELS = ("ur3", "ur5e")


def measure(seconds: float = SECONDS) -> Table:
    """One row for each arm and state of it: the median of some rounds in turn."""
    rows = []
    for model in _MODELS:
        period_s = load_model(model).series.period_s
        rounds = [{what: _child(model, what, seconds) for what in (_BARE, _OFF, _RUNNING)} for _ in range(ROUNDS)]
        for what in rounds[0]:
            cost_s = median(costs[what]["period"] for costs in rounds)
            above_s = median(costs[what]["period"] - costs[_BARE]["period"] for costs in rounds)
            above = "" if what == _BARE else f"{1e6 * above_s:.0f} us"
            rows.append([model, f"{1 / period_s:.0f} Hz", what, f"{cost_s / period_s:.1%}", _us(cost_s), above])
    note = (
        f"CPU time of the process in real time, without clients: medians of {ROUNDS} alternating rounds of {seconds:g} "
        "s. Clock alone: the same clock with a tick that does nothing. Above the clock: median difference."
    )
    return Table("At rest", note, ["arm", "rate", "what", "share of a core", "per period", "above the clock"], rows)


def measure_stages(seconds: float = SECONDS) -> Table:
    """Where a period at rest goes, stage by stage."""
    results = {model: _child(model, "stages", seconds) for model in _MODELS}
    rows = [[name, *(_us(results[model][name]) for model in _MODELS)] for name in results[_MODELS[0]]]
    note = (
        "Median duration of each stage of a tick, as named in `Controller`, with the brakes released, in real time and "
        "therefore with cold caches. Each includes 0.2 us for measuring. The rest of a period is event loop and timer."
    )
    return Table("Stages of a period at rest", note, ["stage", *_MODELS], rows)


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.1f} us"


def _child(model: str, what: str, seconds: float) -> dict[str, float]:
    command = [sys.executable, __file__, model, what, str(seconds)]
    run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    costs: dict[str, float] = json.loads(run.stdout.splitlines()[-1])
    return costs


async def _serve(model: str, what: str, seconds: float) -> Mapping[str, float]:
    """CPU time of a period, or of each stage [s]."""
    controller = ControllerConfig(model=load_model(model), running=what != _OFF)
    emulator = Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True))
    claim_real_time()
    if what == _BARE:
        clock = RealClock(emulator.controller.period_s)
        clock.start(lambda: None)
        try:
            return await _cost(clock, seconds)
        finally:
            clock.close()
    async with emulator:
        assert isinstance(emulator.clock, RealClock)
        if what == "stages":
            return await _stages(emulator.controller, seconds)
        return await _cost(emulator.clock, seconds)


async def _cost(clock: RealClock, seconds: float) -> Mapping[str, float]:
    await asyncio.sleep(_SETTLE_S)
    ticks, used_s = clock.statistics.ticks, _used_s()
    await asyncio.sleep(seconds)
    return {"period": (_used_s() - used_s) / (clock.statistics.ticks - ticks)}


async def _stages(controller: Controller, seconds: float) -> Mapping[str, float]:
    times: dict[str, list[float]] = {}
    await asyncio.sleep(_SETTLE_S)
    controller._stages = tuple((name, _timed(stage, times.setdefault(name, []))) for name, stage in controller._stages)
    controller._publish = _timed(controller._publish, times.setdefault("publishing", []))  # type: ignore[method-assign]
    controller.tick = _timed(controller.tick, times.setdefault("all of the tick", []))  # type: ignore[assignment]
    await asyncio.sleep(seconds)
    return {name: median(taken) for name, taken in times.items()}


def _timed(step: Callable[[], object], taken: list[float]) -> Callable[[], None]:
    def run() -> None:
        began = time.perf_counter()
        step()
        taken.append(time.perf_counter() - began)

    return run


def _used_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """A child with arguments, else all of it."""
    if len(sys.argv) > 1:
        model, what, seconds = sys.argv[1:]
        sys.stdout.write(json.dumps(asyncio.run(_serve(model, what, float(seconds)))) + "\n")
    else:
        sys.stdout.write(measure().markdown() + "\n" + measure_stages().markdown())


if __name__ == "__main__":
    main()
