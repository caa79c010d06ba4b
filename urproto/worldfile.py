"""World files: what stands around an arm, in YAML, for the emulator that touches it and the planner that avoids it.

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
      post: {cylinder: [0.03, 0.5], pose: [0.3, 0.3, 0.25]}    # radius and length along z; of the planner
      hull: {mesh: hull.stl, pose: [0.5, 0, 0]}                # beside this file; of the planner

``links: true`` lets the arm's own links touch too.

What only a world that moves can make use of (``MOVING`` of a thing, ``SECTIONS`` of the file) is handed on as it
stands: `emulator.physics` reads it, and who plans a way takes the thing for one that stays.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from urproto.text import quoted
from urproto.yamltext import NotYaml, load_yaml

MATERIAL: Final = ("stiffness", "damping", "friction")
MOVING: Final = ("mass", "slide", "hinge", "conveyor", "lamp", "colour", "coupling")
SECTIONS: Final = ("scene", "mounted", "barriers", "cameras")


class WorldFileError(ValueError):
    """The file does not say what a world is."""


@dataclass(frozen=True, slots=True)
class Thing:
    """shape: as in the file. sizes: its numbers [m]; mesh: its file. pose (6,): [m, rotation vector]. material: what of
    `MATERIAL` is given; moving: what of `MOVING`, unread."""

    shape: str
    sizes: tuple[float, ...]
    pose: tuple[float, float, float, float, float, float]
    material: Mapping[str, float] = field(default_factory=dict)
    mesh: str = ""
    moving: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WorldDescription:
    """things: by name. tool: None without one. links: whether those of the arm touch. sections: what of `SECTIONS` is
    given, unread."""

    things: Mapping[str, Thing]
    tool: Thing | None = None
    links: bool = False
    sections: Mapping[str, Any] = field(default_factory=dict)


def read_world_file(path: Path, shapes: Collection[str]) -> WorldDescription:
    """What a file says of things with these shapes. Raises WorldFileError, naming file and place, and OSError."""
    try:
        return _world(load_yaml(path.read_bytes()), shapes)
    except NotYaml as error:
        raise WorldFileError(f"{path} is not YAML: {error}") from error
    except ValueError as error:
        raise WorldFileError(f"{path}: {error}") from error


def _world(content: Any, shapes: Collection[str]) -> WorldDescription:
    top = _fields("the file", {} if content is None else content, ("tool", "links", "objects", *SECTIONS))
    links = top.get("links", False)
    if not isinstance(links, bool):
        raise ValueError(f"links must be true or false, not {quoted(links)}")
    tool = read_description("tool", top["tool"], shapes, tool=True) if "tool" in top else None
    things = top.get("objects") or {}
    if not isinstance(things, dict):
        raise ValueError(f"objects must be a mapping of names, not {quoted(things)}")
    described = {str(name): read_description(str(name), given, shapes) for name, given in things.items()}
    return WorldDescription(described, tool, links, {key: top[key] for key in SECTIONS if key in top})


def read_description(name: str, given: Any, shapes: Collection[str], *, tool: bool = False) -> Thing:
    """One thing as a world file describes it; a tool has no material of its own. Raises ValueError."""
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
    return Thing(shape, numbers, (x, y, z, rx, ry, rz), material, mesh, moving)


def _fields(name: str, given: Any, known: Collection[str]) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ValueError(f"{name} must be a mapping of {', '.join(known)}, not {quoted(given)}")
    strange = [key for key in given if key not in known]
    if strange:
        raise ValueError(f"{name} has {quoted(strange[0])}; known are {', '.join(known)}")
    return dict(given)


def _plane(given: Any) -> tuple[float, ...]:
    if given not in (None, {}):
        raise ValueError(f"a plane takes nothing but a pose: write plane: {{}}, not {quoted(given)}")
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
