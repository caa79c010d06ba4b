"""``ur-client calibration``: the factory calibration of an arm, as a file for ROS and for the emulator."""

from pathlib import Path
from typing import Annotated

import typer

from client import primary
from client.calibration import calibration_of, is_nominal, write_calibration
from client.commands.options import PortOffset, RobotIP

__all__ = ["calibration_command"]


def calibration_command(
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    output: Annotated[Path, typer.Option("--output", "-o", help="The YAML file to write.")] = Path(
        "my_robot_calibration.yaml"
    ),
) -> None:
    """Write the robot's calibration in the format of ur_description."""
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as robot:
        calibration = calibration_of(robot.run(robot.core.kinematics_info()))
        nominal = is_nominal(calibration, robot.run(robot.core.configuration_data()))
    write_calibration(output, calibration)
    typer.echo(f"{output}: {calibration.hash}" + (", nominal: this arm has no deviations" if nominal else ""))
