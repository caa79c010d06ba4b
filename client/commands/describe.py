"""``ur-client describe``: the URDF of a model, or of the arm that a robot has."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from client import primary
from client.calibration import calibration_of, described, read_calibration
from client.commands.options import PortOffset
from client.errors import FileError
from urproto.errors import RobotRefused
from urproto.robots import MODELS, RobotModel, UnknownModel, load_model
from urproto.robots.description import MeshesMissing, urdf

__all__ = ["describe_command", "model_of_robot"]


def describe_command(
    model: Annotated[str | None, typer.Argument(help="The arm, for example ur3 or ur5e.")] = None,
    robot_ip: Annotated[
        str | None, typer.Option("--robot-ip", help="Ask this robot for its model and calibration instead.")
    ] = None,
    port_offset: PortOffset = 0,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write.")] = Path("robot.urdf"),
    calibration: Annotated[Path | None, typer.Option(help="Calibration file of the arm.")] = None,
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of meshes, as ur_description's meshes/ur5e; without, simple shapes.")
    ] = None,
    prefix: Annotated[str, typer.Option(help="Put before the name of every link and joint.")] = "",
) -> None:
    """Write the URDF of an arm: joints, limits, inertias, geometry and, if there is one, calibration."""
    if (model is None) == (robot_ip is None):
        raise typer.BadParameter("give either a model or --robot-ip")
    try:
        arm = load_model(model.lower()) if model else model_of_robot(robot_ip or "", port_offset)
        if calibration is not None:
            measured = read_calibration(calibration)
            measured.check_model(arm)
            arm = replace(arm, calibration=measured.dh)
        text = urdf(arm, meshes=meshes, prefix=prefix)
    except (UnknownModel, MeshesMissing) as error:
        raise typer.BadParameter(str(error)) from error
    try:
        output.write_text(text, "utf-8")
    except OSError as error:
        raise FileError(output, error.strerror or str(error)) from error
    typer.echo(f"{output}: {arm.title}, " + ("nominal" if arm.calibration is None else "calibrated"))


def model_of_robot(host: str, port_offset: int = 0) -> RobotModel:
    """A robot's arm with its calibration. Raises RobotRefused when it is not known here."""
    with primary.BlockingPrimaryClient(host, primary.PORT + port_offset) as robot:
        calibration = calibration_of(robot.run(robot.core.kinematics_info()))
        arm = robot.run(robot.core.configuration_data())
    model = described(arm, calibration)
    if model is None:
        known = ", ".join(MODELS)
        what = f"robot type {arm.robot_type}, sub type {arm.sub_type}"
        raise RobotRefused("its model", f"it is not known here ({what})", f"known are {known}")
    return model
