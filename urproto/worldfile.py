"""World files: the surroundings of an arm in YAML, for contacts in the emulator and collision avoidance in the planner.

    tool: {sphere: 0.005}              # the part that makes contact; by default only the TCP
    objects:
      table:
        plane: {}                      # solid below the x-y plane of its pose
        pose: [0, 0, -0.02]            # in the base frame, m; optionally with a rotation vector (rad)
        stiffness: 20000               # N/m
        damping: 200                   # N s/m
        friction: 0.3
      block: {box: [0.1, 0.1, 0.05], pose: [0.3, 0.1, 0.0]}
      ball: {sphere: 0.04, pose: [0.3, -0.1, 0.02]}
      post: {cylinder: [0.03, 0.5], pose: [0.3, 0.3, 0.25]}    # radius and length along z; planner only
      hull: {mesh: hull.stl, pose: [0.5, 0, 0]}                # next to this file; planner only

With ``links: true``, the links of the arm make contact, too.

Settings for moving objects (``MOVING`` of an object, ``SECTIONS`` of the file) are passed on unparsed:
`emulator.physics` reads them, and the planner treats such an object as static.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from urproto.text import quoted
from urproto.yamltext import InvalidYamlError, load_yaml

MATERIAL: Final = ("stiffness", "damping", "friction")
MOVING: Final = ("mass", "slide", "hinge", "conveyor", "lamp", "colour", "coupling")
SECTIONS: Final = ("scene", "step", "mounted", "barriers", "cameras")


class WorldFileError(ValueError):
    """The file is not a valid world file."""


@dataclass(frozen=True, slots=True)
class ObjectDescription:
    """An object. shape: as in the file. sizes: its numbers [m]. mesh: its file. pose (6,): [m, rotation vector].

    material: the given entries of `MATERIAL`. moving: the given entries of `MOVING`, unparsed.
    """

    shape: str
    sizes: tuple[float, ...]
    pose: tuple[float, float, float, float, float, float]
    material: Mapping[str, float] = field(default_factory=dict)
    mesh: str = ""
    moving: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WorldDescription:
    """The contents of a world file. objects: objects by name. tool: None without one. links: whether the arm's links
    make contact. sections: the given sections of `SECTIONS`, unparsed."""

    objects: Mapping[str, ObjectDescription]
    tool: ObjectDescription | None = None
    links: bool = False
    sections: Mapping[str, Any] = field(default_factory=dict)


def read_world_file(path: Path, shapes: Collection[str]) -> WorldDescription:
    """Read a file with objects of these shapes. Raises WorldFileError, which names file and position, or OSError."""
    try:
        return _world(load_yaml(path.read_bytes()), shapes)
    except InvalidYamlError as error:
        raise WorldFileError(f"{path} is not YAML: {error}") from error
    except ValueError as error:
        raise WorldFileError(f"{path}: {error}") from error


def _world(content: Any, shapes: Collection[str]) -> WorldDescription:
    top = _fields("the file", {} if content is None else content, ("tool", "links", "objects", *SECTIONS))
    links = top.get("links", False)
    if not isinstance(links, bool):
        raise ValueError(f"links must be true or false, not {quoted(links)}")
    tool = read_description("tool", top["tool"], shapes, tool=True) if "tool" in top else None
    objects = top.get("objects") or {}
    if not isinstance(objects, dict):
        raise ValueError(f"objects must be a mapping of names, not {quoted(objects)}")
    described = {str(name): read_description(str(name), given, shapes) for name, given in objects.items()}
    return WorldDescription(described, tool, links, {key: top[key] for key in SECTIONS if key in top})


def read_description(name: str, given: Any, shapes: Collection[str], *, tool: bool = False) -> ObjectDescription:
    """Parse the description of one object; a tool has no material. Raises ValueError."""
    fields = _fields(name, given, (*shapes, "pose", *(() if tool else (*MATERIAL, *MOVING))))
    moving: dict[str, Any] = {key: fields.pop(key) for key in MOVING if key in fields}
    chosen = [key for key in fields if key in shapes]
    if len(chosen) != 1:
        raise ValueError(f"{name} must have exactly one of {', '.join(shapes)}")
    try:
        shape = chosen[0]
        sizes = _SIZES[shape](fields.pop(shape))
        pose = _numbers("pose", fields.pop("pose", [0, 0, 0]))
        if len(pose) not in (3, 6):
            raise ValueError(f"pose must be x, y, z or x, y, z, rx, ry, rz, not {quoted(list(pose))}")
        x, y, z, rx, ry, rz = (*pose, 0.0, 0.0, 0.0)[:6]
        material = {key: _number(key, value) for key, value in fields.items()}
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    mesh, numbers = (sizes, ()) if isinstance(sizes, str) else ("", sizes)
    return ObjectDescription(shape, numbers, (x, y, z, rx, ry, rz), material, mesh, moving)


def _fields(name: str, given: Any, known: Collection[str]) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ValueError(f"{name} must be a mapping of {', '.join(known)}, not {quoted(given)}")
    unknown = [key for key in given if key not in known]
    if unknown:
        raise ValueError(f"{name} has {quoted(unknown[0])}; allowed are {', '.join(known)}")
    return dict(given)


def _plane(given: Any) -> tuple[float, ...]:
    if given not in (None, {}):
        raise ValueError(f"a plane only has a pose: write plane: {{}}, not {quoted(given)}")
    return ()


def _box(given: Any) -> tuple[float, ...]:
    size = _numbers("box", given)
    if len(size) != 3:
        raise ValueError(f"box must be three lengths [m], not {quoted(list(size))}")
    return size


def _cylinder(given: Any) -> tuple[float, ...]:
    sizes = _numbers("cylinder", given)
    if len(sizes) != 2:
        raise ValueError(f"cylinder must be a radius and a length [m], not {quoted(list(sizes))}")
    return sizes


def _mesh(given: Any) -> str:
    if not isinstance(given, str) or not given:
        raise ValueError(f"mesh must be the name of a file, not {quoted(given)}")
    return given


_SIZES: Final[Mapping[str, Callable[[Any], tuple[float, ...] | str]]] = {
    "plane": _plane,
    "box": _box,
    "sphere": lambda given: (_number("sphere", given),),
    "cylinder": _cylinder,
    "mesh": _mesh,
}


def _numbers(name: str, given: Any) -> tuple[float, ...]:
    if not isinstance(given, list):
        raise ValueError(f"{name} must be a list of numbers, not {quoted(given)}")
    return tuple(_number(name, value) for value in given)


def _number(name: str, given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise ValueError(f"{name} must be a number, not {quoted(given)}")
    return float(given)
