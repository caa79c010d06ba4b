"""The planning scene of a pendant's robot: the arm, with the obstacles of a world file or of an emulator's world.

The planning libraries are loaded when a scene is first requested, in a thread: a pendant that is not used for planning
does without them.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from client.calibration import require_model
from client.errors import MissingExtraError, SceneError
from urproto.errors import URError
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo
from urproto.robots.pose import pose_trans
from urproto.vectors import ZERO6

if TYPE_CHECKING:
    from client.planning import CollisionChecker, PlanningScene, SceneObject, Shape

_TOOL: Final = "tool"  # its name in world files


@dataclass(frozen=True, slots=True)
class SceneSources:
    """The data a scene is built from, as far as it is known. world: the verb of that name, None without an emulator."""

    arm: ConfigurationData | None = None
    kinematics: KinematicsInfo | None = None
    tcp_offset: tuple[float, ...] | None = None
    world: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class MonitoredScene:
    """A scene and its collision checker. tcp_offset: flange to TCP (6,). objects: as in world files, for 3D views."""

    scene: "PlanningScene"
    checker: "CollisionChecker"
    tcp_offset: tuple[float, ...]
    objects: list[dict[str, Any]] = field(default_factory=list)


class SceneMonitor:
    """Keeps the planning scene of a robot up to date; each call of `update` triggers that.

    file: a world file that is used instead of the emulator's world. problem: why there is no scene, "" while one is
    being built. on_change: called when a new scene is available.
    """

    def __init__(self, file: Path | None, on_change: Callable[[], object]) -> None:
        self.file = file
        self.problem = ""
        self._on_change = on_change
        self._scene: MonitoredScene | None = None
        self._sources = SceneSources()
        self._building: asyncio.Task[None] | None = None

    def update(self, sources: SceneSources) -> MonitoredScene | None:
        """The scene built from these sources, or the previous one while it is being built."""
        if self.file is not None:
            sources = SceneSources(sources.arm, sources.kinematics, sources.tcp_offset)
        if sources != self._sources and self._building is None:
            self._sources = sources
            self._building = asyncio.get_running_loop().create_task(self._build(sources))
        return self._scene

    async def close(self) -> None:
        if self._building is not None:
            self._building.cancel()
            await asyncio.gather(self._building, return_exceptions=True)

    async def _build(self, sources: SceneSources) -> None:
        self.problem = ""
        try:
            self._scene = await asyncio.to_thread(build_scene, sources, self.file)
        except (URError, OSError, ValueError) as error:  # CalibrationError is one
            self._scene, self.problem = None, str(error)
        finally:
            self._building = None
        self._on_change()


def missing_extra() -> str:
    """What planning lacks on this machine and how to install it; "" if nothing."""
    if find_spec("ompl") is not None:
        return ""
    return str(MissingExtraError("motion planning around obstacles", "plan"))


def build_scene(sources: SceneSources, file: Path | None) -> MonitoredScene | None:
    """Build a scene; None while the arm is unknown. Raises SceneError, PlanningError, CalibrationError, OSError."""
    if sources.arm is None or sources.kinematics is None or sources.tcp_offset is None:
        return None
    model = require_model(sources.arm, sources.kinematics)
    from client.planning import CollisionChecker, PlanningScene

    scene = PlanningScene(model)
    if file is not None:
        scene.update(file, sources.tcp_offset)
    elif sources.world is not None:
        _add_world(scene, sources.world, sources.tcp_offset)
    objects = [_object_data(name, obj) for name, obj in scene.objects.items()]
    return MonitoredScene(scene, CollisionChecker(scene), sources.tcp_offset, objects)


def _add_world(scene: "PlanningScene", world: Mapping[str, Any], tcp_offset: Sequence[float]) -> None:
    for name, obj in world["objects"].items():
        scene.add(name, _shape(name, obj), obj.get("pose", ZERO6))
    if world["tool"].get("sphere"):  # a point has no extent to keep clear
        pose = pose_trans(tcp_offset, world["tool"].get("pose", ZERO6))  # the world gives it relative to the TCP
        scene.attach(_TOOL, _shape(_TOOL, world["tool"]), pose)


def _shape(name: str, description: Mapping[str, Any]) -> "Shape":
    from client.planning import Box, Plane, Sphere

    match description:
        case {"box": [x, y, z]}:
            return Box((x, y, z))
        case {"sphere": radius}:
            return Sphere(radius)
        case {"plane": _}:
            return Plane()
    raise SceneError(f"the emulator's object {name} has an unknown shape")


def _object_data(name: str, obj: "SceneObject") -> dict[str, Any]:
    return {"name": name, **_shape_data(obj.shape), "pose": list(obj.pose), "attached": obj.attached}


def _shape_data(shape: "Shape") -> dict[str, Any]:
    from client.planning import Box, Cylinder, Mesh, Sphere
    from client.planning.collision_model import hull_of

    match shape:
        case Box(size):
            return {"box": list(size)}
        case Sphere(radius):
            return {"sphere": radius}
        case Cylinder(radius, length):
            return {"cylinder": [radius, length]}
        case Mesh():
            points, triangles = hull_of(shape)
            return {"mesh": {"points": points, "triangles": triangles}}
    return {"plane": {}}


def links_in(pairs: Sequence[Any]) -> list[int]:
    """The numbers of the links, counted from the base, that are in one of these pairs."""
    from client.planning.scene import LINKS

    return sorted({LINKS.index(name) for pair in pairs for name in (pair.one, pair.other) if name in LINKS})
