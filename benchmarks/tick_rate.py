"""Control periods per second in virtual time: as fast as the controller goes, without a clock."""

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from table import Table

from emulator.commands import ScriptUnit
from emulator.controller import Controller, ControllerConfig
from emulator.robot.body import STEP_S
from urproto.robots import load_model
from urproto.robots.dynamics import Dynamics

TICKS = 5_000
BLOCKS = 5
SWING = """def swing():
  while True:
    movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=1.4, v=1.05)
    movej([-0.5, -1.6, 1.3, -1.3, -1.57, 0.3], a=1.4, v=1.05)
  end
end
"""
STREAM = """def stream():
  q = get_actual_joint_positions()
  start = q[0]
  t = 0.0
  while True:
    t = t + get_steptime()
    q[0] = start + 0.2 * sin(t)
    servoj(q, t=get_steptime(), lookahead_time=0.1, gain=300)
  end
end
"""


def measure() -> Table:
    """Best block of each case."""
    cases = {"at rest": "", "movej to and fro": SWING, "servoj every period": STREAM}
    rows = []
    for model in ("ur3", "ur5e"):
        for kind in ("ideal", "dynamic"):
            for name, script in cases.items():
                rate = _rate(model, script, dynamic=kind == "dynamic")
                times = rate * load_model(model).series.period_s
                rows.append([model, kind, name, f"{rate:,.0f}", f"{1e6 / rate:.0f} us", f"{times:.0f}"])
    note = f"Best of {BLOCKS} blocks of {TICKS} control periods, no clients."
    return Table("Virtual time", note, ["model", "arm", "doing", "ticks/s", "a tick takes", "times real time"], rows)


def measure_dynamics() -> Table:
    """The dynamic arm beside what Pinocchio alone needs for its torques and accelerations."""
    rows = []
    for model in ("ur3", "ur5e"):
        steps = round(load_model(model).series.period_s / STEP_S)
        aba, rnea = _bare(model)
        ticks = {dynamic: _median(model, dynamic=dynamic) for dynamic in (False, True)}
        bound = steps * aba + 2 * rnea
        cells = [f"{1e6 * value:.1f} us" for value in (aba, rnea, bound, ticks[False], ticks[True])]
        rows.append([model, str(steps), *cells])
    note = (
        f"Medians of {TICKS} control periods of a movej to and fro. ABA and RNEA: bare calls; bound: an ABA for each "
        "step and two RNEA (targets, momentum)."
    )
    columns = ["model", "steps", "ABA", "RNEA", "bound", "tick, ideal", "tick, dynamic"]
    return Table("Dynamic arm", note, columns, rows)


def _bare(model: str) -> tuple[float, float]:
    """Seconds that one ABA and one RNEA take when nothing is converted."""
    dynamics = Dynamics(load_model(model))
    inner, data = dynamics._pin, dynamics._data
    q, v, x = np.array([0.1, -1.0, 1.0, 0.3, 0.5, 0.6]), np.full(6, 0.5), np.full(6, 0.2)
    return _fastest(lambda: pin.aba(inner, data, q, v, x)), _fastest(lambda: pin.rnea(inner, data, q, v, x))


def _fastest(call: Callable[[], object]) -> float:
    best = float("inf")
    for _ in range(BLOCKS):
        began = time.perf_counter()
        for _ in range(TICKS):
            call()
        best = min(best, (time.perf_counter() - began) / TICKS)
    return best


def _median(model: str, *, dynamic: bool) -> float:
    controller = Controller(ControllerConfig(model=load_model(model), running=True, dynamic=dynamic))
    controller.post(ScriptUnit(SWING, "block"))
    times = []
    for _ in range(TICKS):
        began = time.perf_counter()
        controller.tick()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def _rate(model: str, script: str, *, dynamic: bool) -> float:
    controller = Controller(ControllerConfig(model=load_model(model), running=True, dynamic=dynamic))
    if script:
        controller.post(ScriptUnit(script, "block"))
    best = 0.0
    for _ in range(BLOCKS):
        began = time.perf_counter()
        for _ in range(TICKS):
            controller.tick()
        best = max(best, TICKS / (time.perf_counter() - began))
    if script and not controller.snapshot.program_running:
        raise RuntimeError(f"the program does not run any more: {list(controller.messages.history)[-3:]}")
    return best


if __name__ == "__main__":
    sys.stdout.write(measure().markdown() + "\n" + measure_dynamics().markdown())
