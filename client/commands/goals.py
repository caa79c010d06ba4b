"""``ur-client goal``, ``publish-goals`` and ``forward``: move the arm through a controller of a controller manager."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from math import pi, radians
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from client.commands.control import (
    ArmAccess,
    ControllersOption,
    MakeReady,
    RecordOption,
    SpeedSlider,
    Target,
    follow,
    print_result,
    run,
    until,
    wait_until_at_rest,
)
from client.commands.following import PortOffset, RobotIP
from client.commands.record import Overwrite, check_free
from client.controllers import JOINT_NAMES, JointTrajectory, JointTrajectoryPoint
from client.controllers.goal_files import GOAL_TIME_S, FileGoal, GoalFile, read_goals
from client.errors import MotionError
from urproto.commandline import application, with_options_of

_ARRIVED_RAD: Final = 0.005  # guess: the lag of an arm that has all but arrived
_STANDSTILL_S: Final = 2.0  # guess: longer than an arm takes to start moving
_POLL_S: Final = 0.05
_WIDEST_RAD: Final = 4 * pi  # guess: two turns, twice the range of most joints


class ForwardKind(Enum):
    """What a forward controller commands."""

    POSITION = "position"
    VELOCITY = "velocity"


def _target(
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    record: RecordOption = None,
    overwrite: Overwrite = False,
    speed_slider: SpeedSlider = None,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> Target:
    if record is not None:
        check_free(record, overwrite)
    return Target(robot_ip, port_offset, controllers, make_ready, record, speed_slider)


@with_options_of(_target, last=True)
def goal_command(
    target_options: Mapping[str, Any],
    positions: Annotated[str, typer.Option(help='Joint angles, base to wrist 3: "0,-1.57,0,-1.57,0,0" [rad].')],
    time: Annotated[float, typer.Option(help="How long the motion takes at full speed [s].")] = 6.0,
    degrees: Annotated[bool, typer.Option("--degrees", help="The angles are in degrees.")] = False,
    controller: Annotated[
        str | None, typer.Option(help="Trajectory controller to use, instead of the one in the controllers file.")
    ] = None,
) -> None:
    """Move the arm to joint angles; Ctrl-C brings it to rest."""
    q = _angles(positions)
    if degrees:
        q = tuple(map(radians, q))
    elif (widest := max(q, key=abs)) and abs(widest) > _WIDEST_RAD:
        raise typer.BadParameter(f"--positions takes radians, but {widest:g} looks like degrees: add --degrees")
    _check_time(time)
    target = _target(**target_options)
    point = JointTrajectoryPoint(q, (0.0,) * len(q), time_from_start_s=time)
    run(go(target, controller, JointTrajectory(JOINT_NAMES, (point,))))


@with_options_of(_target, last=True)
def publish_goals_command(
    target_options: Mapping[str, Any],
    file: Annotated[Path, typer.Argument(help="Goals in the format of publisher_joint_trajectory_controller (YAML).")],
    node: Annotated[str | None, typer.Option(help="Section of the file to use, if it has several.")] = None,
    time: Annotated[float, typer.Option(help="How long each motion takes at full speed [s].")] = GOAL_TIME_S,
    rounds: Annotated[int, typer.Option(min=0, help="How many times to send all goals; 0 repeats until Ctrl-C.")] = 1,
    controller: Annotated[
        str | None, typer.Option(help="Controller to use instead of the one named in the file.")
    ] = None,
) -> None:
    """Send the goals of a file, each once the previous one is reached; Ctrl-C brings the arm to rest."""
    _check_time(time)
    try:
        goals = read_goals(file, node)
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"cannot read {file}: {error}") from error
    for note in goals.notes:
        typer.echo(f"note: {note}", err=True)
    if controller is not None:
        goals = replace(goals, controller=controller)
    target = _target(**target_options)
    run(publish(target, goals, time, rounds))


def _check_time(time_s: float) -> None:
    if not time_s > 0.0:
        raise typer.BadParameter(f"--time must be above 0 s, not {time_s}")


def _angles(text: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(part) for part in text.replace(",", " ").replace("[", " ").replace("]", " ").split())
    except ValueError:
        raise typer.BadParameter(f"--positions takes numbers separated by commas, not {text!r}") from None
    if len(angles) != len(JOINT_NAMES):
        raise typer.BadParameter(f"--positions takes {len(JOINT_NAMES)} joint angles, not {len(angles)}")
    return angles


async def go(target: Target, controller: str | None, trajectory: JointTrajectory) -> None:
    """Execute one trajectory with one controller of the target; None selects its trajectory controller."""
    async with target.open() as arm:
        name = controller or await target.trajectory_controller(arm)
        await target.activate(arm, name)
        result = await follow(arm, name, trajectory, "goal")
    print_result("goal", result)


async def publish(target: Target, goals: GoalFile, time_s: float, rounds: int) -> None:
    """Send all goals of a file ``rounds`` times; 0 repeats them without end. Raises ControllerError."""
    async with target.open() as arm:
        goals.check_start((await arm.request("robot_state"))["positions"])
        await target.activate(arm, goals.controller)
        done = 0
        while rounds == 0 or done < rounds:
            for number, goal in enumerate(goals.goals):
                last = number == len(goals.goals) - 1 and done == rounds - 1
                title = f"{goal.name} ({number + 1}/{len(goals.goals)})"
                await _execute_goal(arm, goals, goal, title, time_s, last)
            done += 1


async def _execute_goal(arm: ArmAccess, goals: GoalFile, goal: FileGoal, title: str, time_s: float, last: bool) -> None:
    began_s = (await arm.request("robot_state"))["time_s"]
    if goals.commands:
        typer.echo(f"{goal.name}: {_format(goal.point.positions)}")
        await arm.request("forward_command", controller=goals.controller, values=goal.point.positions, hold=True)
    else:
        point = replace(goal.point, time_from_start_s=time_s)
        trajectory = JointTrajectory(goals.joints or JOINT_NAMES, (point,))
        print_result(goal.name, await follow(arm, goals.controller, trajectory, title))
    if goals.commands or not last:
        await until(arm, began_s + goals.wait_s)


forward_app = application(completion=False)


@forward_app.command(context_settings={"ignore_unknown_options": True})  # negative numbers look like options
@with_options_of(_target, last=True)
def forward_command(
    target_options: Mapping[str, Any],
    kind: Annotated[ForwardKind, typer.Argument(help="Whether to command positions or speeds.")],
    values: Annotated[list[float], typer.Argument(help="One value for each joint, base to wrist 3 [rad or rad/s].")],
    time: Annotated[
        float,
        typer.Option(help="Duration of the motion to the positions at full speed, or of the speeds [s]."),
    ] = 4.0,
    at_once: Annotated[
        bool, typer.Option("--at-once", help="Command the positions as a step, as a publisher would: the arm jerks.")
    ] = False,
    degrees: Annotated[bool, typer.Option("--degrees", help="The values are in degrees.")] = False,
    controller: Annotated[str | None, typer.Option(help="Forward controller to use.")] = None,
) -> None:
    """Command positions or speeds through a forward controller; Ctrl-C brings the arm to rest."""
    _check_time(time)
    given = tuple(map(radians, values)) if degrees else tuple(values)
    run(
        forward(_target(**target_options), controller or f"forward_{kind.value}_controller", kind, given, time, at_once)
    )


async def forward(
    target: Target, name: str, kind: ForwardKind, values: Sequence[float], time_s: float, at_once: bool
) -> None:
    """Command positions until the arm has reached them, or speeds for time_s. Raises ControllerError."""
    position = kind is ForwardKind.POSITION
    async with target.open() as arm:
        await target.activate(arm, name)
        begin_s = (await arm.request("robot_state"))["time_s"]
        ramp_s = time_s if position and not at_once else 0.0
        await arm.request("forward_command", controller=name, values=values, time_s=ramp_s, hold=True)
        try:
            if position:
                await _wait_for_arrival(arm, values)
            else:
                await until(arm, begin_s + time_s)
        finally:
            if not position:
                await arm.request("forward_command", controller=name, values=[0.0] * len(values))
            await wait_until_at_rest(arm)
        reached = (await arm.request("robot_state"))["positions"]
    typer.echo(f"{name}: the arm is at {', '.join(f'{q:.3f}' for q in reached.values())} rad")


async def _wait_for_arrival(arm: ArmAccess, values: Sequence[float]) -> None:
    """Wait until the joints have reached the values. Raises MotionError if they stop elsewhere."""
    standstill_since_s: float | None = None
    while True:
        state = await arm.request("robot_state")
        away = max(abs(q - value) for q, value in zip(state["positions"].values(), values, strict=True))
        if away < _ARRIVED_RAD:
            return
        waits = state["safety_mode"] not in ("NORMAL", "REDUCED") or not state["at_rest"]
        standstill_since_s = None if waits else standstill_since_s or state["time_s"]
        if standstill_since_s is not None and state["time_s"] > standstill_since_s + _STANDSTILL_S:
            raise MotionError("forward position", f"the arm stopped {away:.3f} rad away: check the robot's log")
        await until(arm, state["time_s"] + _POLL_S)


def _format(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
