"""Control periods per second in virtual time: as fast as the controller goes, without a clock."""

import sys
import time
from collections.abc import Callable
from math import sin
from statistics import median

import numpy as np
import pinocchio as pin
from table import Table

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.robot.body import STEP_S
from urproto.robots import load_model
from urproto.robots.dynamics import Dynamics

TICKS = 25_000
WARM_UP = 1_000
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
LINES = """def lines():
  movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
  here = get_target_tcp_pose()
  while True:
    movel(pose_add(here, p[0.1, 0.1, 0.1, 0.2, 0.1, 0.3]))
    movel(here)
  end
end
"""
ARCS = """def arcs():
  movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
  here = get_target_tcp_pose()
  while True:
    movec(pose_add(here, p[0.05, 0.05, 0, 0, 0, 0]), pose_add(here, p[0.1, 0, 0, 0, 0, 0]))
    movec(pose_add(here, p[0.05, -0.05, 0, 0, 0, 0]), here)
  end
end
"""
PROCESS = """def process():
  movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
  here = get_target_tcp_pose()
  while True:
    movep(pose_add(here, p[0.1, 0.1, 0.1, 0.2, 0.1, 0.3]), r=0.02)
    movep(pose_add(here, p[0.1, 0, 0, 0, 0, 0]), r=0.02)
    movep(here, r=0.02)
  end
end
"""
POLISH = """def polish():
  movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
  here = get_target_tcp_pose()
  force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [0.1, 0.1, 0.15, 0.3, 0.3, 0.3])
  while True:
    movel(pose_add(here, p[0.1, 0.05, 0, 0, 0, 0]))
    movel(here)
  end
end
"""
PUSH_N, PUSH_CHANGE_N, PUSH_PERIODS = 10.0, 8.0, 100.0  # against the tool of POLISH, and how it oscillates


def measure() -> Table:
    """The median tick of each case, and what the arm's inverse dynamics alone take in the same run."""
    cases = {
        "at rest": "",
        "movej back and forth": SWING,
        "movel back and forth": LINES,
        "movec back and forth": ARCS,
        "movep with blends": PROCESS,
        "servoj every period": STREAM,
        "movel in force mode": POLISH,
    }
    rows = []
    for model in ("ur3", "ur5e"):
        for name, script in cases.items():
            tick, rnea = _medians(model, script)
            read, _ = _medians(model, script, read=True)
            rate = 1.0 / tick
            times = rate * load_model(model).series.period_s
            took, watched, bound = (
                f"{1e6 * value:.{digits}f} us" for value, digits in ((tick, 0), (read, 0), (rnea, 1))
            )
            rows.append([model, name, f"{rate:,.0f}", took, watched, f"{times:.0f}", bound])
    note = (
        f"Median of {TICKS} control periods without clients, and of as many after each of which all values of the "
        "snapshot are read. RNEA: Pinocchio's inverse dynamics of the same arm, measured between the ticks; it is part "
        "of a period in which torques or currents are read. In force mode, an oscillating force pushes the tool along "
        "its compliant axis. Requirement: 60 us in motion, 90 us in force mode."
    )
    return Table("Virtual time", note, ["arm", "motion", "ticks/s", "tick", "read", "times real time", "RNEA"], rows)


def measure_dynamics() -> Table:
    """The dynamic arm compared with what Pinocchio alone needs for its torques and accelerations."""
    rows = []
    for model in ("ur3", "ur5e"):
        steps = round(load_model(model).series.period_s / STEP_S)
        aba, rnea = _bare(model)
        ticks = [_medians(model, SWING, dynamic=dynamic)[0] for dynamic in (False, True)]
        bound = steps * aba + 2 * rnea
        cells = [f"{1e6 * value:.1f} us" for value in (aba, rnea, bound, *ticks)]
        rows.append([model, str(steps), *cells])
    note = (
        f"Medians of {TICKS} control periods of a movej back and forth. ABA and RNEA: bare calls. Bound: one ABA per "
        "step and two RNEA (targets, momentum)."
    )
    columns = ["model", "steps", "ABA", "RNEA", "bound", "tick, ideal", "tick, dynamic"]
    return Table("Dynamic arm", note, columns, rows)


def _bare(model: str) -> tuple[float, float]:
    """Seconds that one ABA and one RNEA take when nothing is converted."""
    dynamics = Dynamics(load_model(model))
    inner, data = dynamics._pin, dynamics._data
    q, v, x = np.array([0.1, -1.0, 1.0, 0.3, 0.5, 0.6]), np.full(6, 0.5), np.full(6, 0.2)
    return _typical(lambda: pin.aba(inner, data, q, v, x)), _typical(lambda: pin.rnea(inner, data, q, v, x))


def _typical(call: Callable[[], object]) -> float:
    times = []
    for _ in range(TICKS):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return median(times)


def _medians(model: str, script: str, *, dynamic: bool = False, read: bool = False) -> tuple[float, float]:
    """Seconds of a tick and of one RNEA. read: the tick includes reading everything that it publishes."""
    controller = Controller(ControllerConfig(model=load_model(model), running=True, dynamic=dynamic))
    arm = controller.arm
    if script:
        controller.post(ScriptUnit(script, "block"))
    for _ in range(WARM_UP):
        controller.tick()
    ticks, calls = [], []
    for _ in range(TICKS):
        if script is POLISH:
            _push(controller)
        began = time.perf_counter()
        controller.tick()
        if read:
            controller.snapshot.values()
        between = time.perf_counter()
        arm.dynamics.inverse_dynamics(arm.q, arm.qd, arm.qdd)
        calls.append(time.perf_counter() - between)
        ticks.append(between - began)
    if script and not controller.snapshot.program_running:
        raise RuntimeError(f"the program does not run any more: {list(controller.messages.history)[-3:]}")
    return median(ticks), median(calls)


def _push(controller: Controller) -> None:
    force = PUSH_N + PUSH_CHANGE_N * sin(controller.step_count / PUSH_PERIODS)
    controller.external_wrench = (0.0, 0.0, force, 0.0, 0.0, 0.0)


if __name__ == "__main__":
    sys.stdout.write(measure().markdown() + "\n" + measure_dynamics().markdown())
