"""Worlds from world files (`urproto.worldfile`): planes, boxes and spheres that push back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from emulator.world.shapes import Box, Plane, Shape, Sphere, WorldObject
from emulator.world.world import POINT, World
from urproto.robots import RobotModel
from urproto.worldfile import MATERIAL, ObjectDescription, WorldFileError, read_description, read_world_file

_SHAPES: Final[Mapping[str, Callable[[tuple[float, ...]], Shape]]] = {
    "plane": lambda sizes: Plane(),
    "box": lambda sizes: Box((sizes[0], sizes[1], sizes[2])),
    "sphere": lambda sizes: Sphere(sizes[0]),
}


@dataclass(frozen=True)
class WorldPlan:
    """The plan of a world, from which one world per controller is built."""

    objects: Mapping[str, WorldObject] = field(default_factory=dict)
    tool: WorldObject = POINT
    links: bool = False

    def build(self, model: RobotModel, period_s: float) -> World:
        links = None
        if self.links:
            from emulator.world.links import Links  # with coal and numpy, for which --help should not wait

            links = Links(model)
        return self._fill(World(self.tool, links))

    def check(self, model: RobotModel, q: Sequence[float]) -> None:
        """Check the plan. The arm's position does not matter: no object moves, and an arm may start inside one."""
        self._fill(World(self.tool))

    def _fill(self, world: World) -> World:
        for name, obj in self.objects.items():
            world.add(name, obj)
        return world


def read_world(path: Path) -> WorldPlan:
    """Read a world from a YAML file. Raises OSError, or WorldFileError that names the file and the place."""
    world = read_world_file(path, _SHAPES)
    if unmoved := (
        *world.sections,
        *(f"{key} of {name}" for name, obj in world.objects.items() for key in obj.moving),
    ):
        raise WorldFileError(f"{path}: {unmoved[0]} requires physics: add --physics, or leave it out")
    try:
        tool = POINT if world.tool is None else _object("tool", world.tool)
        plan = WorldPlan({name: _object(name, obj) for name, obj in world.objects.items()}, tool, world.links)
        plan._fill(World(tool))
    except ValueError as error:
        raise WorldFileError(f"{path}: {error}") from error
    return plan


def read_object(name: str, description: Any, *, tool: bool = False) -> WorldObject:
    """Read one object in the format of a world file; a tool has no material of its own. Raises ValueError."""
    obj = read_description(name, description, _SHAPES, tool=tool)
    if obj.moving:
        raise ValueError(f"{name}: {next(iter(obj.moving))} is only for objects of a world file, with --physics")
    return _object(name, obj)


def _object(name: str, obj: ObjectDescription) -> WorldObject:
    try:
        return WorldObject(_SHAPES[obj.shape](obj.sizes), obj.pose, **obj.material)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def describe_object(obj: WorldObject, *, tool: bool = False) -> dict[str, Any]:
    """Describe an object in the format of ``read_object``."""
    match obj.shape:
        case Plane():
            shape: dict[str, Any] = {"plane": {}}
        case Box(size):
            shape = {"box": list(size)}
        case Sphere(radius):
            shape = {"sphere": radius}
    material = {} if tool else {name: getattr(obj, name) for name in MATERIAL}
    return {**shape, "pose": list(obj.pose), **material}
