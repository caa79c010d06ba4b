"""Options that commands share."""

from typing import Annotated, TypeAlias

import typer

__all__ = ["PortOffset", "RobotIP"]

RobotIP: TypeAlias = Annotated[str, typer.Option("--robot-ip", help="Address of the robot.")]
PortOffset: TypeAlias = Annotated[
    int, typer.Option("--port-offset", help="Added to each port, as given to the emulator.")
]
