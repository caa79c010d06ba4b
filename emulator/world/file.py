"""World files: what stands around the arm, in YAML.

    tool: {sphere: 0.005}              # what touches; without it, the TCP alone does
    objects:
      table:
        plane: {}                      # solid below the x-y plane of its pose
        pose: [0, 0, -0.02]            # in the base frame, m; with a rotation vector (rad) where it is turned
        stiffness: 20000               # N/m
        damping: 200                   # N s/m
        friction: 0.3
      block: {box: [0.1, 0.1, 0.05], pose: [0.3, 0.1, 0.0]}
      ball: {sphere: 0.04, pose: [0.3, -0.1, 0.02]}

``links: true`` lets the arm's own links touch too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from emulator.world.shapes import Box, Plane, Shape, Sphere, WorldObject
from emulator.world.world import POINT, World
from urproto.robots import RobotModel
from urproto.text import quoted
from urproto.yamltext import NotYaml, load_yaml

if TYPE_CHECKING:
    from emulator.world.links import Links


_MATERIAL: Final = ("stiffness", "damping", "friction")


class WorldFileError(ValueError):
    """The file does not say what a world is."""


@dataclass(frozen=True)
class WorldPlan:
    """A world to be made: as often as there are controllers to stand in it."""

    things: Mapping[str, WorldObject] = field(default_factory=dict)
    tool: WorldObject = POINT
    links: bool = False

    def build(self, model: RobotModel) -> World:
        """A world of its own for one arm. Raises WorldError."""
        return self._fill(World(self.tool, _links(model) if self.links else None))

    def check(self) -> None:
        """Raise WorldError when it cannot be built."""
        self._fill(World(self.tool))

    def _fill(self, world: World) -> World:
        for name, thing in self.things.items():
            world.add(name, thing)
        return world


def _links(model: RobotModel) -> "Links":
    from emulator.world.links import Links  # coal and numpy, for which a look at options does not wait

    return Links(model)


def read_world(path: Path) -> WorldPlan:
    """What a YAML file says. Raises WorldFileError naming the file and the place, and OSError."""
    try:
        content = load_yaml(path.read_bytes())
    except NotYaml as error:
        raise WorldFileError(f"{path} is not YAML: {error}") from error
    try:
        return _plan(content)
    except ValueError as error:
        raise WorldFileError(f"{path}: {error}") from error


def read_thing(name: str, description: Any, *, tool: bool = False) -> WorldObject:
    """One thing as a world file describes it; a tool has no material of its own. Raises ValueError."""
    return _thing(name, description, () if tool else _MATERIAL)


def describe_thing(thing: WorldObject, *, tool: bool = False) -> dict[str, Any]:
    """What ``read_thing`` makes the thing of."""
    match thing.shape:
        case Plane():
            shape: dict[str, Any] = {"plane": {}}
        case Box(size):
            shape = {"box": list(size)}
        case Sphere(radius):
            shape = {"sphere": radius}
    material = {} if tool else {name: getattr(thing, name) for name in _MATERIAL}
    return {**shape, "pose": list(thing.pose), **material}


def _plan(content: Any) -> WorldPlan:
    top = _fields("the file", {} if content is None else content, ("tool", "links", "objects"))
    links = top.get("links", False)
    if not isinstance(links, bool):
        raise ValueError(f"links must be true or false, not {quoted(links)}")
    tool = _thing("tool", top["tool"], ()) if "tool" in top else POINT
    things = top.get("objects") or {}
    if not isinstance(things, dict):
        raise ValueError(f"objects must be a mapping of names, not {quoted(things)}")
    plan = WorldPlan({str(name): _thing(str(name), given, _MATERIAL) for name, given in things.items()}, tool, links)
    plan.check()
    return plan


def _thing(name: str, given: Any, material: tuple[str, ...]) -> WorldObject:
    fields = _fields(name, given, (*_SHAPES, "pose", *material))
    shapes = [key for key in fields if key in _SHAPES]
    if len(shapes) != 1:
        raise ValueError(f"{name} must have exactly one of {', '.join(_SHAPES)}")
    try:
        shape = _SHAPES[shapes[0]](fields.pop(shapes[0]))
        pose = _numbers("pose", fields.pop("pose", [0, 0, 0]))
        if len(pose) not in (3, 6):
            raise ValueError(f"pose must be x, y, z or x, y, z, rx, ry, rz, not {quoted(list(pose))}")
        x, y, z, rx, ry, rz = (*pose, 0.0, 0.0, 0.0)[:6]
        return WorldObject(shape, (x, y, z, rx, ry, rz), **{key: _number(key, value) for key, value in fields.items()})
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _fields(name: str, given: Any, known: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ValueError(f"{name} must be a mapping of {', '.join(known)}, not {quoted(given)}")
    strange = [key for key in given if key not in known]
    if strange:
        raise ValueError(f"{name} has {quoted(strange[0])}; known are {', '.join(known)}")
    return dict(given)


def _plane(given: Any) -> Plane:
    if given not in (None, {}):
        raise ValueError(f"a plane takes nothing but a pose: write plane: {{}}, not {quoted(given)}")
    return Plane()


def _sphere(given: Any) -> Sphere:
    return Sphere(_number("sphere", given))


def _box(given: Any) -> Box:
    size = _numbers("box", given)
    if len(size) != 3:
        raise ValueError(f"box must be three lengths [m], not {quoted(list(size))}")
    return Box((size[0], size[1], size[2]))


_SHAPES: Final[Mapping[str, Callable[[Any], Shape]]] = {"plane": _plane, "box": _box, "sphere": _sphere}


def _numbers(name: str, given: Any) -> tuple[float, ...]:
    if not isinstance(given, list):
        raise ValueError(f"{name} must be a list of numbers, not {quoted(given)}")
    return tuple(_number(name, value) for value in given)


def _number(name: str, given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise ValueError(f"{name} must be a number, not {quoted(given)}")
    return float(given)
