"""The arm and what stands around it, as motions are planned there: of a scene file, or of an emulator's world.

Planning's libraries are loaded by the first look at an arena, in a thread: a pendant that nobody plans with does
without them.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from client.calibration import shaped
from client.errors import MissingExtraError, SceneError
from urproto.errors import URError
from urproto.primary.state import ConfigurationData, KinematicsInfo
from urproto.robots.pose import pose_trans, rotvec_to_matrix
from urproto.vectors import ZERO6

if TYPE_CHECKING:
    from client.planning import CollisionChecker, PlanningScene, SceneObject, Shape

_TOOL: Final = "tool"  # its name in world files


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What an arena is made of, as far as it is known. world: the verb of that name, None without an emulator."""

    arm: ConfigurationData | None = None
    kinematics: KinematicsInfo | None = None
    tcp_offset: tuple[float, ...] | None = None
    world: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class Arena:
    """tcp_offset: flange to TCP (6,). things: as static/screen_arm.js draws them."""

    scene: "PlanningScene"
    checker: "CollisionChecker"
    tcp_offset: tuple[float, ...]
    things: list[dict[str, Any]] = field(default_factory=list)


class Arenas:
    """The newest arena of a robot. Looking at it is what keeps it new.

    file: a world file, which is taken instead of the emulator's world. problem: why there is no arena, "" while one is
    made. tell: called when there is another one.
    """

    def __init__(self, file: Path | None, tell: Callable[[], object]) -> None:
        self.file = file
        self.problem = ""
        self._tell = tell
        self._arena: Arena | None = None
        self._known = Surroundings()
        self._making: asyncio.Task[None] | None = None

    def look(self, known: Surroundings) -> Arena | None:
        """The arena of these surroundings, or of the last ones while it is being made."""
        if self.file is not None:
            known = Surroundings(known.arm, known.kinematics, known.tcp_offset)
        if known != self._known and self._making is None:
            self._known = known
            self._making = asyncio.get_running_loop().create_task(self._make(known))
        return self._arena

    async def close(self) -> None:
        """Make no more."""
        if self._making is not None:
            self._making.cancel()
            await asyncio.gather(self._making, return_exceptions=True)

    async def _make(self, known: Surroundings) -> None:
        self.problem = ""
        try:
            self._arena = await asyncio.to_thread(make_arena, known, self.file)
        except (URError, OSError, ValueError) as error:  # CalibrationError is one
            self._arena, self.problem = None, str(error)
        finally:
            self._making = None
        self._tell()


def lacking() -> str:
    """What planning lacks on this machine and how to get it; "" for nothing."""
    if find_spec("ompl") is not None:
        return ""
    return str(MissingExtraError("planning around what is in the way", "plan"))


def make_arena(known: Surroundings, file: Path | None) -> Arena | None:
    """None while the arm is not known. Raises SceneError, PlanningError, CalibrationError, OSError."""
    if known.arm is None or known.kinematics is None or known.tcp_offset is None:
        return None
    model = shaped(known.arm, known.kinematics)
    from client.planning import CollisionChecker, PlanningScene

    scene = PlanningScene(model)
    if file is not None:
        scene.update(file, known.tcp_offset)
    elif known.world is not None:
        _take(scene, known.world, known.tcp_offset)
    things = [_drawn(name, thing) for name, thing in scene.objects.items()]
    return Arena(scene, CollisionChecker(scene), known.tcp_offset, things)


def _take(scene: "PlanningScene", world: Mapping[str, Any], tcp_offset: Sequence[float]) -> None:
    for name, thing in world["objects"].items():
        scene.add(name, _shape(name, thing), thing.get("pose", ZERO6))
    if world["tool"].get("sphere"):  # a point is no shape to keep clear
        pose = pose_trans(tcp_offset, world["tool"].get("pose", ZERO6))  # the world has it from the TCP
        scene.attach(_TOOL, _shape(_TOOL, world["tool"]), pose)


def _shape(name: str, described: Mapping[str, Any]) -> "Shape":
    from client.planning import Box, Plane, Sphere

    match described:
        case {"box": [x, y, z]}:
            return Box((x, y, z))
        case {"sphere": radius}:
            return Sphere(radius)
        case {"plane": _}:
            return Plane()
    raise SceneError(f"the emulator's {name} has a shape that is not known here")


def _drawn(name: str, thing: "SceneObject") -> dict[str, Any]:
    rotation = list(rotvec_to_matrix(*thing.pose[3:]))
    return {
        "name": name,
        **_form(thing.shape),
        "pose": list(thing.pose),
        "rotation": rotation,
        "attached": thing.attached,
    }


def _form(shape: "Shape") -> dict[str, Any]:
    from client.planning import Box, Cylinder, Mesh, Sphere
    from client.planning.solids import hull_of

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


def red_links(pairs: Sequence[Any]) -> list[int]:
    """Numbers of the links, from the base on, that are in one of these pairs."""
    from client.planning.scene import LINKS

    return sorted({LINKS.index(name) for pair in pairs for name in (pair.one, pair.other) if name in LINKS})
