"""Options that commands share."""

from typing import Annotated, Final, TypeAlias

import typer

__all__ = ["ROBOT_IP_VARIABLE", "PortOffset", "RobotIP"]

ROBOT_IP_VARIABLE: Final = "UR_ROBOT_IP"  # for a shell in which one works with one robot

RobotIP: TypeAlias = Annotated[str, typer.Option("--robot-ip", envvar=ROBOT_IP_VARIABLE, help="Address of the robot.")]
PortOffset: TypeAlias = Annotated[
    int, typer.Option("--port-offset", help="Added to each port, as given to the emulator.")
]
