"""``ur-client replay-traffic``: a recording as a robot that clients can connect to."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import PortOffset
from client.commands.proxy import until_interrupted
from client.traffic.recording import Recording
from client.traffic.replay import ReplayRobot

__all__ = ["replay_traffic_command"]


def replay_traffic_command(
    file: Annotated[Path, typer.Argument(help="A recording: pcapng of `ur-client proxy`, or any pcap.")],
    listen: Annotated[str, typer.Option("--listen", help="Address of this machine for the clients.")] = "127.0.0.1",
    speed: Annotated[float, typer.Option("--speed", help="Recorded seconds a second.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin states again at their end; else close.")] = False,
    recorded_offset: Annotated[
        int, typer.Option("--recorded-offset", help="What the robot had added to each port when it was recorded.")
    ] = 0,
    port_offset: PortOffset = 0,
) -> None:
    """Be the robot of a recording, until Ctrl-C: states by their times, answers by their requests."""
    recording = Recording.read(file, recorded_offset)
    for trouble in recording.troubles:
        typer.echo(f"! {trouble}", err=True)
    try:
        asyncio.run(_play(recording, listen, speed, loop, port_offset))
    except OSError as error:
        raise typer.BadParameter(str(error)) from error


async def _play(recording: Recording, listen: str, speed: float, loop: bool, port_offset: int) -> None:
    robot = ReplayRobot(recording, listen, speed=speed, loop=loop, port_offset=port_offset, say=typer.echo)
    async with robot:
        for name, port in robot.ports.items():
            typer.echo(f"{name}: {listen}:{port}")
        typer.echo(f"Replaying {recording.path}. Ctrl-C ends it.")
        await until_interrupted()
