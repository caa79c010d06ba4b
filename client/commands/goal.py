"""``ur-client goal`` and ``ur-client publish-goals``: the arm to joint angles, by a trajectory controller."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from client.commands.control import (
    ControllersOption,
    MakeReady,
    RecordOption,
    SpeedSlider,
    Target,
    follow,
    run,
    say_result,
)
from client.commands.options import PortOffset, RobotIP
from client.commands.record import Overwrite, check_free
from client.controllers import JOINTS, ControlledRobot, ControlLoop, JointTrajectory, JointTrajectoryPoint
from client.controllers.goal_files import GOAL_TIME_S, GoalFile, NamedGoal, read_goals

__all__ = ["go", "goal_command", "publish", "publish_goals_command"]

_CONTROLLER = "scaled_joint_trajectory_controller"


def goal_command(
    positions: Annotated[str, typer.Option(help='Joint angles, base to wrist 3: "0,-1.57,0,-1.57,0,0" [rad].')],
    time: Annotated[float, typer.Option(help="How long the motion takes at full speed [s].")] = 6.0,
    degrees: Annotated[bool, typer.Option("--degrees", help="The angles are in degrees.")] = False,
    controller: Annotated[str, typer.Option(help="Which trajectory controller.")] = _CONTROLLER,
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    record: RecordOption = None,
    overwrite: Overwrite = False,
    speed_slider: SpeedSlider = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Move the arm to joint angles, smoothly and at rest there; Ctrl-C stops it softly."""
    q = tuple(radians(angle) for angle in _angles(positions)) if degrees else _angles(positions)
    _check_time(time)
    target = _target(robot_ip, port_offset, controllers, make_ready, record, overwrite, speed_slider)
    point = JointTrajectoryPoint(q, (0.0,) * len(q), time_from_start_s=time)
    run(go(target, controller, JointTrajectory(JOINTS, (point,))))


def publish_goals_command(
    file: Annotated[Path, typer.Argument(help="Goals as publisher_joint_trajectory_controller reads them.")],
    node: Annotated[str | None, typer.Option(help="Which of the file's sections, when it has several.")] = None,
    time: Annotated[float, typer.Option(help="How long each motion takes at full speed [s].")] = GOAL_TIME_S,
    rounds: Annotated[int, typer.Option(min=0, help="How often all goals; 0 goes on until Ctrl-C.")] = 1,
    controller: Annotated[str | None, typer.Option(help="Another controller than the file says.")] = None,
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    record: RecordOption = None,
    overwrite: Overwrite = False,
    speed_slider: SpeedSlider = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Send the goals of a file one after the other, each when the one before is reached; Ctrl-C stops softly."""
    _check_time(time)
    try:
        goals = read_goals(file, node)
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"cannot read {file}: {error}") from error
    for note in goals.notes:
        typer.echo(f"note: {note}", err=True)
    if controller is not None:
        goals = replace(goals, controller=controller)
    target = _target(robot_ip, port_offset, controllers, make_ready, record, overwrite, speed_slider)
    run(publish(target, goals, time, rounds))


def _check_time(time_s: float) -> None:
    if not time_s > 0.0:
        raise typer.BadParameter(f"--time has to be above 0 s, not {time_s}")


def _target(
    robot_ip: str,
    port_offset: int,
    controllers: Path | None,
    make_ready: bool,
    record: Path | None,
    overwrite: bool,
    speed_slider: float | None,
) -> Target:
    if record is not None:
        check_free(record, overwrite)
    return Target(robot_ip, port_offset, controllers, make_ready, record, speed_slider)


def _angles(text: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(part) for part in text.replace(",", " ").replace("[", " ").replace("]", " ").split())
    except ValueError:
        raise typer.BadParameter(f"--positions takes numbers with commas between them, not {text!r}") from None
    if len(angles) != len(JOINTS):
        raise typer.BadParameter(f"--positions takes {len(JOINTS)} joint angles, not {len(angles)}")
    return angles


async def go(target: Target, name: str, trajectory: JointTrajectory) -> None:
    """Let one controller of the target follow one trajectory."""
    async with target.open() as loop:
        loop.manager.activate(name)
        result = await follow(loop, name, trajectory, "goal")
    say_result("goal", result)


async def publish(target: Target, goals: GoalFile, time_s: float, rounds: int) -> None:
    """Send all goals of a file, as often as ``rounds`` says; 0 is without end. Raises ControllerError."""
    async with target.open() as loop:
        goals.check_start(_standing(loop))
        loop.manager.activate(goals.controller)
        done = 0
        while rounds == 0 or done < rounds:
            for number, goal in enumerate(goals.goals):
                last = number == len(goals.goals) - 1 and done == rounds - 1
                title = f"{goal.name} ({number + 1}/{len(goals.goals)})"
                await _one(loop, goals, goal, title, time_s, last)
            done += 1


async def _one(loop: ControlledRobot, goals: GoalFile, goal: NamedGoal, title: str, time_s: float, last: bool) -> None:
    began_s = loop.manager.time_s
    if goals.commands:
        typer.echo(f"{goal.name}: {_listed(goal.point.positions)}")
        loop.manager.controller(goals.controller).command(goal.point.positions)
    else:
        point = replace(goal.point, time_from_start_s=time_s)
        trajectory = JointTrajectory(goals.joints or JOINTS, (point,))
        say_result(goal.name, await follow(loop, goals.controller, trajectory, title))
    while (goals.commands or not last) and loop.manager.time_s < began_s + goals.wait_s:
        await loop.cycles()


def _standing(loop: ControlLoop) -> Mapping[str, float]:
    states = loop.manager.hardware.states
    return {joint: states[f"{joint}/position"] for joint in JOINTS}


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
