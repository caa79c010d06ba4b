"""What is around a robot, drawn into recordings and live streams of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from client import primary
from client.calibration import calibration_of, described
from client.commands.following import Sink
from client.errors import FileError, RecordingError
from client.recording.files import Recorder
from client.recording.live import FoxgloveServer
from urproto.errors import RobotRefused
from urproto.robots import MODELS, RobotModel

if TYPE_CHECKING:
    from client.planning.markers import SceneDrawing


def model_of_robot(host: str, port_offset: int = 0) -> RobotModel:
    """A robot's arm with its calibration. Raises RobotRefused when it is not known here."""
    with primary.BlockingPrimaryClient(host, primary.PORT + port_offset) as robot:
        return _model(robot)


def _model(robot: primary.BlockingPrimaryClient) -> RobotModel:
    calibration = calibration_of(robot.run(robot.core.kinematics_info()))
    arm = robot.run(robot.core.configuration_data())
    model = described(arm, calibration)
    if model is None:
        known = ", ".join(MODELS)
        what = f"robot type {arm.robot_type}, sub type {arm.sub_type}"
        raise RobotRefused("its model", f"it is not known here ({what})", f"known are {known}")
    return model


def scene_drawing(path: Path | None, names: Sequence[str], robot_ip: str, port_offset: int) -> "SceneDrawing | None":
    """Of a world file around a robot's arm; None for no file.

    names: the variables that its states have. Raises RecordingError without those of the joints, URError, FileError.
    """
    if path is None:
        return None
    if "actual_q" not in names:
        raise RecordingError("--scene needs actual_q: add it to --fields")
    from client.planning import PlanningScene
    from client.planning.markers import SceneDrawing

    with primary.BlockingPrimaryClient(robot_ip, primary.PORT + port_offset) as robot:
        scene, state = PlanningScene(_model(robot)), robot.run(robot.core.robot_state())
    try:
        if state.cartesian is None:
            scene.update(path)
        else:
            scene.update(path, state.cartesian.tcp_offset)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
    return SceneDrawing(scene)


def drawn_into(recorder: Recorder, drawing: "SceneDrawing") -> Sink:
    """What draws each state of the robot into a recording."""

    def draw(state: Any) -> None:
        drawing.draw(state, lambda topic, markers: recorder.write_markers(topic, markers, state["timestamp"]))

    return draw


class DrawnServer:
    """A server of states that shows the scene, too."""

    def __init__(self, server: FoxgloveServer, drawing: "SceneDrawing") -> None:
        self._server = server
        self._drawing = drawing

    def write(self, values: Mapping[str, Any], time_ns: int) -> None:
        """Offer a state, and the scene around it."""
        self._server.write(values, time_ns)
        self._drawing.draw(values, lambda topic, markers: self._server.write_markers(topic, markers, time_ns))

    def close(self) -> None:
        """Disconnect everybody."""
        self._server.close()
