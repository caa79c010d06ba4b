"""The scene and the last path as markers, which RViz and Foxglove draw without MoveIt's messages."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from client.planning.markers import Marker, path_marker, scene_markers
from client.ros2.host import LATCHED, interface
from client.ros2.move_group.arm import Arm
from client.ros2.move_group.requests import PlanResult
from client.ros2.move_group.scene import SceneState

_ARRAY: Final = "visualization_msgs/msg/MarkerArray"
_DELETE_ALL: Final = 3  # visualization_msgs/Marker


class MarkerPublisher:
    """Publishes ``~/scene_markers`` and ``~/path_markers``, latched."""

    def __init__(self, node: Any, arm: Arm) -> None:
        self._arm = arm
        self._scene = node.create_publisher(interface(_ARRAY), "~/scene_markers", LATCHED)
        self._path = node.create_publisher(interface(_ARRAY), "~/path_markers", LATCHED)

    def scene(self, state: SceneState) -> None:
        """Draw a scene instead of the last one."""
        markers = scene_markers(state.scene(), None, prefix=self._arm.prefix)
        self._scene.publish(_message([{"action": _DELETE_ALL}, *markers]))

    def path(self, state: SceneState, plan: PlanResult) -> None:
        """Draw the path of the flange."""
        self._path.publish(_message([path_marker(state.scene(), plan.trajectory.q, prefix=self._arm.prefix)]))


def _message(markers: Sequence[Marker]) -> Any:
    kind = interface("visualization_msgs/msg/Marker")
    return interface(_ARRAY)(markers=[_filled(kind(), marker) for marker in markers])


def _filled(message: Any, values: Mapping[str, Any]) -> Any:
    """A message with these fields; lists of mappings are lists of points."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            _filled(getattr(message, name), value)
        elif isinstance(value, list):
            point = interface("geometry_msgs/msg/Point")
            setattr(message, name, [_filled(point(), one) for one in value])
        else:
            setattr(message, name, value)
    return message
