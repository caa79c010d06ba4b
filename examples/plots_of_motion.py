"""Makes the figures of docs/arm.md in virtual time. Needs `pip install matplotlib`.

python examples/plots_of_motion.py [FOLDER]

Each figure is one function of `FIGURES`; a new one needs a script to run, and what to draw of it.
"""

import sys
from collections.abc import Callable
from math import pi, sin
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from emulator.commands import ScriptUnit
from emulator.controller import Controller, ControllerConfig
from emulator.snapshot import Snapshot
from urproto.robots import load_model

START = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)  # rad
Periods = list[Snapshot]
Change = Callable[[Controller, float], None]  # what happens from outside, at which robot time [s]


def run(script: str, seconds: float, meanwhile: Change = lambda controller, now: None) -> Periods:
    """The snapshots of a UR5e that executes the body of a program, while something happens from outside."""
    controller = Controller(ControllerConfig(model=load_model("ur5e"), initial_q=START, running=True))
    lines = "".join(f"  {line}\n" for line in script.strip().splitlines())
    controller.post(ScriptUnit(f"def figure():\n{lines}end\n", "block"))
    while not controller.snapshot.program_running:
        controller.tick()
    began, periods = controller.time_s, [controller.snapshot]
    while controller.time_s - began < seconds:
        meanwhile(controller, controller.time_s - began)
        periods.append(controller.tick())
    return periods


def slider(low: float, since: float, until: float) -> Change:
    """The speed slider at ``low`` between two times [s], else at 1."""
    return lambda controller, now: controller.speed.set_slider(low if since <= now < until else 1.0)


WAVE_RAD, WAVE_S, LOW, SINCE, UNTIL, LASTS = 0.5, 4.0, 0.25, 1.5, 3.5, 9.0


def wave(t: float) -> float:
    """The desired position of the base joint [rad], at a time of the trajectory [s]."""
    return WAVE_RAD * sin(2.0 * pi * min(t, 1.5 * WAVE_S) / WAVE_S)


def times(periods: Periods) -> list[float]:
    return [snapshot.timestamp - periods[0].timestamp for snapshot in periods]


def speed_scaling() -> Figure:
    """A trajectory streamed by a controller that knows of the speed slider, and by one that does not."""
    cases = {"time not scaled: the trajectory runs on": False, "time scaled: the trajectory waits for the arm": True}
    figure, axes = plt.subplots(2, 2, figsize=(9.0, 5.2), sharex=True, height_ratios=(2, 1))
    for column, (title, scaled) in enumerate(cases.items()):
        t, desired, actual, own = streamed(scaled)
        above, below = axes[0][column], axes[1][column]
        above.plot(t, desired, "--", color="tab:orange", label="desired")
        above.plot(t, actual, color="tab:blue", label="actual")
        below.plot(t, own, color="tab:green", label="controller's time [s]")
        for axis in (above, below):
            axis.axvspan(SINCE, UNTIL, color="0.9", label=f"slider at {LOW:.0%}" if axis is above else None)
            axis.grid(alpha=0.3)
            axis.legend(loc="lower right", fontsize=8)
        above.set_title(title, fontsize=10)
        below.set_xlabel("robot time [s]")
    axes[0][0].set_ylabel("base joint [rad]")
    return figure


def streamed(scaled: bool) -> tuple[list[float], ...]:
    """Robot time, desired and actual position, and the controller's own time, period by period.

    The controller samples its trajectory once a period and commands the joint by servoj, as a driver does.
    """
    model = load_model("ur5e")
    controller = Controller(ControllerConfig(model=model, initial_q=START, running=True))
    motion, period = controller.motion, controller.period_s
    own, rows = 0.0, []
    while len(rows) * period < LASTS:
        now = len(rows) * period
        controller.speed.set_slider(LOW if SINCE <= now < UNTIL else 1.0)
        own += period * (controller.speed.fraction if scaled else 1.0)
        motion.servoj((wave(own), *START[1:]), t=period, lookahead_time=0.03, gain=2000.0)
        controller.tick()
        rows.append((now, wave(own), controller.snapshot.actual_q[0], own))
    return tuple(list(column) for column in zip(*rows, strict=True))


def singular_wrist() -> Figure:
    """A straight line past a singular wrist: the tool slows down in time."""
    script = """movej([0, -1.2, 1.6, -1.9, -0.04, 0.4], a=10, v=3)
here = get_target_tcp_pose()
sleep(0.2)
movel(pose_add(here, p[0, 0.15, 0, 0, 0, 0]), a=1.2, v=0.25)
sleep(0.1)
movel(pose_add(here, p[0, -0.15, 0, 0, 0, 0]), a=1.2, v=0.25)"""
    periods = run(script, 3.6)
    t = times(periods)
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True)
    above.plot(t, [1000.0 * sum(v * v for v in snapshot.actual_TCP_speed[:3]) ** 0.5 for snapshot in periods])
    above.set_ylabel("tool speed [mm/s]")
    for joint in range(6):
        below.plot(t, [snapshot.actual_qd[joint] for snapshot in periods], label=f"joint {joint + 1}")
    below.set_ylabel("joint speeds [rad/s]")
    below.set_xlabel("robot time [s]")
    below.legend(fontsize=7, ncols=3)
    for axis in (above, below):
        axis.grid(alpha=0.3)
    return figure


FIGURES = {"speed_scaling": speed_scaling, "singular_wrist": singular_wrist}


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "images"
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in FIGURES.items():
        figure = draw()
        figure.tight_layout()
        figure.savefig(folder / f"{name}.png", dpi=80)
        plt.close(figure)
        print(f"wrote {folder / name}.png")


if __name__ == "__main__":
    main()
