"""``ur-client replay``: the arm along a recorded path."""

import ipaddress
import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from client.commands.options import PortOffset, RobotIP
from client.commands.progress import MotionProgress
from client.commands.record import read_telling
from client.driver.config import ROBOT_PORTS
from client.errors import ClientError
from client.recording.motion import JointPath, joint_path
from client.robot import Robot
from urproto.errors import RobotRefused

__all__ = ["replay_command"]

_APPROACH_RAD_S: Final = 0.3  # slow enough to press a button; guess
_APPROACH_RAD_S2: Final = 0.5
_LOOK_S: Final = 0.1
_INTERRUPTED: Final = 130  # exit status of a program that Ctrl-C ended


def replay_command(
    file: Annotated[Path, typer.Argument(help="A recording: .mcap, .csv or .npz.", exists=True, dir_okay=False)],
    speed: Annotated[float, typer.Option("--speed", help="Times the recorded speed.")] = 1.0,
    yes: Annotated[bool, typer.Option("--yes", help="Move a real arm without asking.")] = False,
    make_ready: Annotated[
        bool, typer.Option("--make-ready", help="Power the arm on and release its brakes first, if need be.")
    ] = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Move the arm along the recorded path: slowly to its start, then as recorded; Ctrl-C stops it softly."""
    if not 0.0 < speed <= 10.0:
        raise typer.BadParameter(f"--speed is above 0 and at most 10, not {speed:g}")
    path = joint_path(read_telling(file), speed)
    ports = {name: port + port_offset for name, port in ROBOT_PORTS.items()}
    try:
        with Robot(robot_ip, robot_ports=ports) as robot:
            _check(robot, path)
            if not yes and not _on_this_machine(robot_ip):
                _ask(robot_ip, robot, path)
            if make_ready:
                robot.make_ready()
            _move(robot, path)
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(_INTERRUPTED) from None
    typer.echo(f"{file}: {path.duration_s:.2f} s replayed")


def _check(robot: Robot, path: JointPath) -> None:
    arm = robot.inner.driver.robot.configuration
    if arm is None:
        raise RobotRefused("replay", "it does not report its limits", "look whether its primary port (30001) answers")
    path.check(arm)


def _on_this_machine(address: str) -> bool:
    """Where only emulators are."""
    try:
        return address == "localhost" or ipaddress.ip_address(address).is_loopback
    except ValueError:  # a name
        return False


def _ask(address: str, robot: Robot, path: JointPath) -> None:
    away = max(abs(a - b) for a, b in zip(robot.q, path.start_rad, strict=True))
    question = (
        f"The arm at {address} will move by up to {away:.2f} rad to the start of the path, and then for "
        f"{path.duration_s:.1f} s along it. Nothing looks for obstacles. Is the way free?"
    )
    if not sys.stdin.isatty():
        raise ClientError(f"{question} Nobody can answer here: say --yes if it is")
    if not typer.confirm(question):
        raise typer.Exit(1)


def _move(robot: Robot, path: JointPath) -> None:
    robot.move_j(path.start_rad, speed_rad_s=_APPROACH_RAD_S, acceleration_rad_s2=_APPROACH_RAD_S2)
    robot.sequence(path.points(), wait=False)
    with MotionProgress("replay") as progress:
        done_s, last_s = 0.0, robot.state.timestamp_s
        while robot.moving:
            try:
                robot.wait_done(_LOOK_S)
            except TimeoutError:
                now_s = robot.state.timestamp_s
                done_s += (now_s - last_s) * robot.state.speed_fraction
                last_s = now_s
                progress.update(min(1.0, done_s / path.duration_s))
        progress.update(1.0)
    robot.wait_done()  # a failure between two looks
