"""Control periods per second in virtual time: as fast as the controller goes, without a clock."""

import sys
import time

from table import Table

from emulator.commands import ScriptUnit
from emulator.controller import Controller, ControllerConfig
from urproto.robots import load_model

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
        for name, script in cases.items():
            rate = _rate(model, script)
            times = rate * load_model(model).series.period_s
            rows.append([model, name, f"{rate:,.0f}", f"{1e6 / rate:.0f} us", f"{times:.0f}"])
    note = f"Best of {BLOCKS} blocks of {TICKS} control periods, no clients."
    return Table("Virtual time", note, ["arm", "doing", "ticks/s", "a tick takes", "times real time"], rows)


def _rate(model: str, script: str) -> float:
    controller = Controller(ControllerConfig(model=load_model(model), running=True))
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
    sys.stdout.write(measure().markdown())
