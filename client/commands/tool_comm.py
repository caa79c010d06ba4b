"""``ur-client tool-comm``: the serial line at the robot's tool as a device of this machine."""

import asyncio
import signal
from pathlib import Path
from typing import Annotated

import typer

from client.commands.options import PortOffset, RobotIP
from client.tool_communication import PORT, ToolCommunication

__all__ = ["tool_comm_command"]


def tool_comm_command(
    device: Annotated[Path, typer.Option(help="Path of the serial device to make.")] = Path("/tmp/ttyUR"),
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Offer the serial line at the robot's tool (e-Series) as a device of this machine, until Ctrl-C."""
    asyncio.run(_offer(ToolCommunication(robot_ip, PORT + port_offset, device, typer.echo)))


async def _offer(line: ToolCommunication) -> None:
    loop = asyncio.get_running_loop()
    async with line:
        running = loop.create_task(line.run())
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, running.cancel)
        typer.echo(f"{line.device} is the tool of {line.host}:{line.port}. Ctrl-C ends it.")
        await asyncio.wait([running])
    if not running.cancelled():
        running.result()
