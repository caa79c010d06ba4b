"""What is around a robot, drawn into recordings and live streams of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from client import primary
from client.calibration import calibrated_model, calibration_of
from client.errors import FileError, RecordingError
from client.recording.live import FoxgloveServer
from urproto.errors import RobotRefused
from urproto.robots import MODELS, RobotModel, UnknownModelError, load_model
from urproto.vectors import ZERO6

if TYPE_CHECKING:
    from client.planning.markers import SceneDrawing


def model_named(name: str) -> RobotModel:
    """Raises BadParameter, which lists the known ones."""
    try:
        return load_model(name.lower())
    except UnknownModelError as error:
        raise typer.BadParameter(str(error)) from error


def model_of_robot(host: str, port_offset: int = 0) -> RobotModel:
    """A robot's arm with its calibration. Raises RobotRefused when it is not known here."""
    with primary.BlockingPrimaryClient(host, primary.PORT + port_offset) as client:
        return _model(client)


def _model(client: primary.BlockingPrimaryClient) -> RobotModel:
    calibration = calibration_of(client.run(client.core.kinematics_info()))
    arm = client.run(client.core.configuration_data())
    model = calibrated_model(arm, calibration)
    if model is None:
        known = ", ".join(MODELS)
        arm_text = f"robot type {arm.robot_type}, sub type {arm.sub_type}"
        raise RobotRefused("its model", f"it is not known here ({arm_text})", f"known are {known}")
    return model


def scene_drawing(
    path: Path | None, plan: Path | None, names: Sequence[str], robot_ip: str, port_offset: int
) -> "SceneDrawing | None":
    """Of a world file around a robot's arm, and of the path in a file of ``ur-client plan --json``; None for no file.

    names: the variables that its states have. Raises RecordingError without those of the joints, URError, FileError.
    """
    if path is None and plan is None:
        return None
    if "actual_q" not in names:
        raise RecordingError("--scene and --plan need actual_q: add it to --fields")
    from client.planning import PlanningScene
    from client.planning.markers import SceneDrawing, read_plan

    path_rad = None if plan is None else read_plan(plan)
    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as robot:
        scene, state = PlanningScene(_model(robot)), robot.run(robot.core.robot_state())
    if path is not None:
        with FileError.accessing(path):
            scene.update(path, ZERO6 if state.cartesian is None else state.cartesian.tcp_offset)
    return SceneDrawing(scene, path_rad)


class DrawnServer:
    """A server of states that shows the scene, too."""

    def __init__(self, server: FoxgloveServer, drawing: "SceneDrawing") -> None:
        self._server = server
        self._drawing = drawing

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Offer a state, and the scene around it."""
        self._server.write(values, time_ns)
        for topic, markers in self._drawing.at(values["timestamp"], values["actual_q"]):
            self._server.write_markers(topic, markers, time_ns)

    def close(self) -> None:
        self._server.close()
