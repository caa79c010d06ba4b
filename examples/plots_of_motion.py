"""Makes the figures of docs/arm.md in virtual time. Needs `pip install matplotlib`.

python examples/plots_of_motion.py [FOLDER]

Each figure is one function of `FIGURES`; a new one needs a script to run, and what to draw of it.
"""

import sys
from math import hypot, pi, sin
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from emulator.snapshot import Snapshot
from emulator.world.file import WorldPlan
from emulator.world.shapes import Plane, WorldObject
from urproto.robots import load_model

START = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)  # rad
Periods = list[Snapshot]


def robot(*, dynamic: bool = False, world: WorldPlan | None = None) -> Controller:
    """A UR5e that is ready to move."""
    model = load_model("ur5e")
    return Controller(ControllerConfig(model=model, initial_q=START, running=True, dynamic=dynamic, world=world))


def run(script: str, seconds: float, controller: Controller | None = None) -> Periods:
    """The snapshots of a robot that executes the body of a program."""
    controller = controller or robot()
    lines = "".join(f"  {line}\n" for line in script.strip().splitlines())
    controller.post(ScriptUnit(f"def figure():\n{lines}end\n", "block"))
    while not controller.snapshot.program_running:
        controller.tick()
    began, periods = controller.time_s, [controller.snapshot]
    while controller.time_s - began < seconds:
        controller.tick()
        periods.append(controller.snapshot)
    return periods


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
    controller = robot()
    motion, period = controller.motion, controller.period_s
    own, rows = 0.0, []
    while len(rows) * period < LASTS:
        now = len(rows) * period
        controller.speed.set_slider(LOW if SINCE <= now < UNTIL else 1.0)
        own += period * (controller.speed.fraction if scaled else 1.0)
        motion.commands.servoj((wave(own), *START[1:]), t=period, lookahead_time=0.03, gain=2000.0)
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


PRESS_N, GAP_M = 10.0, 0.005


def force_press() -> Figure:
    """Force mode comes down on tables of different stiffness, and presses."""
    script = f"""down = [0, 0, -{PRESS_N}, 0, 0, 0]
force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], down, 2, [0.3, 0.3, 0.1, 1, 1, 1])
sleep(10)"""
    height = robot().arm.tcp_pose[2] - GAP_M
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True)
    for axis, damping in zip(axes, (0.005, 0.1), strict=True):
        for stiffness in (1e3, 1e4, 1e5):
            table = WorldObject(Plane(), (0.0, 0.0, height, 0.0, 0.0, 0.0), stiffness=stiffness, damping=200.0)
            controller = robot(world=WorldPlan({"table": table}))
            periods = run(f"force_mode_set_damping({damping})\n{script}", 1.5, controller)
            force = [snapshot.actual_TCP_force[2] for snapshot in periods]
            axis.plot(times(periods), force, label=f"{stiffness:,.0f} N/m")
        axis.axhline(PRESS_N, color="0.6", linewidth=0.8)
        axis.set_title(f"force_mode_set_damping({damping})", fontsize=10)
        axis.set_xlabel("robot time [s]")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    axes[0].set_ylabel("force on the tool [N]")
    return figure


STOPS = {
    "0, brakes (fault)": SafetyEvent.FAULT,
    "1 (emergency stop)": SafetyEvent.ROBOT_EMERGENCY_STOP,
    "2 (protective stop)": SafetyEvent.PROTECTIVE_STOP,
}


def stopping_distance() -> Figure:
    """How far the tool goes on when the arm is stopped while only its base joint turns."""
    figure, axis = plt.subplots(figsize=(7.0, 3.6))
    for (name, event), line in zip(STOPS.items(), ("o-", "s-", "x--"), strict=True):
        stops = [stopped(event, 0.25 * speed) for speed in range(1, 12)]
        axis.plot(*zip(*stops, strict=True), line, markersize=4, label=f"stop category {name}")
    axis.set_xlabel("tool speed [m/s]")
    axis.set_ylabel("stopping distance [mm]")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    return figure


def stopped(event: SafetyEvent, speed_rad_s: float) -> tuple[float, float]:
    """Tool speed [m/s] when the event comes, and the way to rest [mm]."""
    controller = robot()
    run(f"speedj([{speed_rad_s}, 0, 0, 0, 0, 0], 10, 5)", 0.6, controller)
    speed = hypot(*controller.snapshot.actual_TCP_speed[:3])
    controller.safety_event(event)
    stop = controller.safety_board.last_stop
    while stop is not None and not stop.done:
        controller.tick()
    return speed, 1000.0 * stop.distance_m if stop is not None else 0.0


def following_error() -> Figure:
    """The same movej on an arm that is where it is told to be, and on one that torques move."""
    script = "sleep(0.1)\nmovej([0.8, -1.2, 1.2, -1.4, -1.57, 0.3])"
    arms = {"ideal": run(script, 1.8), "dynamic": run(script, 1.8, robot(dynamic=True))}
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True)
    t = times(arms["ideal"])
    above.plot(t, [snapshot.target_qd[0] for snapshot in arms["ideal"]], "--", color="tab:orange", label="target")
    above.plot(t, [snapshot.actual_qd[0] for snapshot in arms["dynamic"]], color="tab:blue", label="actual, dynamic")
    above.set_ylabel("base speed [rad/s]")
    for name, periods in arms.items():
        for joint in range(3) if name == "dynamic" else (0,):
            error = [1000.0 * (snapshot.target_q[joint] - snapshot.actual_q[joint]) for snapshot in periods]
            below.plot(times(periods), error, label=f"{name}, joint {joint + 1}" if name == "dynamic" else name)
    below.set_ylabel("target - actual [mrad]")
    below.set_xlabel("robot time [s]")
    for axis in (above, below):
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    return figure


FIGURES = {
    "speed_scaling": speed_scaling,
    "singular_wrist": singular_wrist,
    "force_press": force_press,
    "stopping_distance": stopping_distance,
    "following_error": following_error,
}


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
