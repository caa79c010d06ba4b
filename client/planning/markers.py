"""A planning scene and a planned path as markers: mappings with the fields of visualization_msgs/Marker, in the base
frame.

RViz and Foxglove draw them. A hull is drawn by its points, a mesh by its file, a plane by a rectangle about its origin.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from client.errors import FileError
from client.planning.parameterisation import Array
from client.planning.scene import Box, Cylinder, Hull, Mesh, Plane, PlanningScene, Shape, Sphere
from urproto.robots.pose import Pose, pose_trans, rotvec_to_quaternion

SCENE_TOPIC: Final = "/planning_scene"
PATH_TOPIC: Final = "/planned_path"

_FRAME: Final = "base"
_TOOL: Final = "tool0"
_CUBE, _SPHERE, _CYLINDER, _LINE_STRIP, _POINTS, _MESH = 1, 2, 3, 4, 8, 10  # visualization_msgs/Marker
_OBJECT_COLOR: Final = (0.6, 0.6, 0.65, 0.8)
_ATTACHED_COLOR: Final = (0.9, 0.6, 0.1, 0.9)
_PATH_COLOR: Final = (0.1, 0.6, 0.2, 1.0)
_PIECE_M: Final = (4.0, 4.0, 0.002)  # of the drawn piece of a plane
_DOT_M: Final = 0.005
_REPEAT_S: Final = 1.0

Marker = Mapping[str, Any]


def scene_markers(
    scene: PlanningScene, q_rad: Sequence[float] | None, *, attached_only: bool = False, prefix: str = ""
) -> list[Marker]:
    """Markers of all objects in a scene, with the arm in this configuration (6,) [rad]; or only of attached objects.

    Without a configuration, attached objects are in the frame ``tool0``, for viewers that know the arm's frames.
    prefix: of frame names.
    """
    flange = None if q_rad is None else scene.kinematics.forward(q_rad)
    found: list[Marker] = []
    for number, (name, obj) in enumerate(scene.objects.items()):
        if obj.attached or not attached_only:
            pose = pose_trans(flange, obj.pose) if obj.attached and flange else obj.pose
            color = _ATTACHED_COLOR if obj.attached else _OBJECT_COLOR
            frame = prefix + (_TOOL if obj.attached and not flange else _FRAME)
            found.append({**_marker(name, number, pose, color, frame), **_drawn(obj.shape)})
    return found


class MarkerSink(Protocol):
    """Receives markers: a `client.recording.Recorder`, or one that writes in the background."""

    def write_markers(self, topic: str, markers: Sequence[Marker], time_s: float) -> None:
        """Add a visualization_msgs/MarkerArray at the robot's time [s]."""


class SceneDrawing:
    """Draws a scene around a moving arm, and a planned path, into recordings and live streams.

    The topics are ``/planning_scene`` and ``/planned_path``. Everything is drawn once a second, for viewers that join
    late or open the middle of a file; attached objects are drawn with each state. path_rad: configurations (n, 6)
    [rad], such as `Plan.trajectory.q`.

        drawing = SceneDrawing(scene, plan.trajectory.q)
        robot.inner.driver.link.on_state.append(drawing.onto(recorder))
    """

    def __init__(self, scene: PlanningScene, path_rad: Array | None = None) -> None:
        self._scene = scene
        self._path = [] if path_rad is None else [path_marker(scene, path_rad)]
        self._drawn_s: float | None = None

    def at(self, time_s: float, q_rad: Sequence[float]) -> Iterator[tuple[str, list[Marker]]]:
        """The topics and markers due at the robot's time [s], with the arm in this configuration (6,) [rad]."""
        attached_only = self._drawn_s is not None and 0.0 <= time_s - self._drawn_s < _REPEAT_S
        if markers := scene_markers(self._scene, q_rad, attached_only=attached_only):
            yield SCENE_TOPIC, markers
        if not attached_only:
            self._drawn_s = time_s
            if self._path:
                yield PATH_TOPIC, self._path

    def onto(self, sink: MarkerSink) -> Callable[[Mapping[str, Any]], None]:
        """A callback that draws each RTDE state it is given, by its ``timestamp`` and ``actual_q``."""

        def draw(state: Mapping[str, Any]) -> None:
            for topic, markers in self.at(state["timestamp"], state["actual_q"]):
                sink.write_markers(topic, markers, state["timestamp"])

        return draw


def path_marker(scene: PlanningScene, q_rad: Array, *, prefix: str = "") -> Marker:
    """The path of the flange through configurations (n, 6) [rad], as a line."""
    places = [scene.kinematics.forward(tuple(map(float, q)))[:3] for q in q_rad]
    line = {"type": _LINE_STRIP, "scale": _xyz((_DOT_M, 0.0, 0.0)), "points": [_xyz(place) for place in places]}
    return {**_marker("path", 0, (0.0,) * 6, _PATH_COLOR, prefix + _FRAME), **line}


def read_plan(path: Path) -> Array:
    """The configurations (n, 6) [rad] of a plan that ``ur-client plan --json`` printed. Raises FileError."""
    try:
        with FileError.accessing(path):
            path_rad = np.array(json.loads(path.read_text("utf-8"))["positions"], dtype=float)
    except (ValueError, TypeError, KeyError, RecursionError):
        path_rad = np.empty(0)
    if path_rad.shape[1:] != (6,) or not np.isfinite(path_rad).all():
        raise FileError(path, "this is not a plan: create one with `ur-client plan GOAL --json`")
    return path_rad


def _marker(name: str, number: int, pose: Pose, color: Sequence[float], frame: str) -> Marker:
    turn = rotvec_to_quaternion(*pose[3:])
    return {
        "header": {"frame_id": frame},
        "frame_locked": True,
        "ns": name,
        "id": number,
        "pose": {"position": _xyz(pose[:3]), "orientation": dict(zip("xyzw", turn, strict=True))},
        "color": dict(zip("rgba", color, strict=True)),
    }


def _drawn(shape: Shape) -> Marker:
    match shape:
        case Box(size):
            return {"type": _CUBE, "scale": _xyz(size)}
        case Sphere(radius):
            return {"type": _SPHERE, "scale": _xyz((2.0 * radius,) * 3)}
        case Cylinder(radius, length):
            return {"type": _CYLINDER, "scale": _xyz((2.0 * radius, 2.0 * radius, length))}
        case Mesh(path, scale):
            return {"type": _MESH, "scale": _xyz((scale,) * 3), "mesh_resource": path.resolve().as_uri()}
        case Hull(points):
            dots = [_xyz(point) for point in points]
            return {"type": _POINTS, "scale": _xyz((_DOT_M, _DOT_M, 0.0)), "points": dots}
        case Plane():
            return {"type": _CUBE, "scale": _xyz(_PIECE_M)}


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))
