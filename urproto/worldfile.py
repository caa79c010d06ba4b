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

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta, Struct

from urproto.structures import InvalidYamlError, converted, load_yaml
from urproto.text import quoted
from urproto.vectors import Vector3

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


class _File(Struct, forbid_unknown_fields=True):
    tool: Any = None
    links: bool = False
    objects: dict[str | int, Any] | None = None
    scene: Any = None
    step: Any = None
    mounted: Any = None
    barriers: Any = None
    cameras: Any = None


class _Object(Struct):
    plane: Annotated[dict[str, Any], Meta(max_length=0)] | None = None
    box: Vector3 = (0.0, 0.0, 0.0)
    sphere: float = 0.0
    cylinder: tuple[float, float] = (0.0, 0.0)
    mesh: Annotated[str, Meta(min_length=1)] = ""
    pose: tuple[float, ...] = (0.0, 0.0, 0.0)
    stiffness: float = 0.0
    damping: float = 0.0
    friction: float = 0.0


def _world(content: Any, shapes: Collection[str]) -> WorldDescription:
    top = converted({} if content is None else content, _File, "")
    tool = None if top.tool is None else read_description("tool", top.tool, shapes, tool=True)
    objects = {str(name): read_description(str(name), given, shapes) for name, given in (top.objects or {}).items()}
    return WorldDescription(objects, tool, top.links, {key: content[key] for key in SECTIONS if key in (content or ())})


def read_description(name: str, given: Any, shapes: Collection[str], *, tool: bool = False) -> ObjectDescription:
    """Parse the description of one object; a tool has no material. Raises ValueError."""
    known = (*shapes, "pose", *(() if tool else (*MATERIAL, *MOVING)))
    if not isinstance(given, dict):
        raise ValueError(f"{name} must be a mapping of {', '.join(known)}, not {quoted(given)}")
    if wrong := [key for key in given if key not in known]:
        raise ValueError(f"{name} has {quoted(wrong[0])}; allowed are {', '.join(known)}")
    chosen = [key for key in given if key in shapes]
    if len(chosen) != 1:
        raise ValueError(f"{name} must have exactly one of {', '.join(shapes)}")
    moving = {key: given[key] for key in MOVING if key in given}
    found = converted({key: value for key, value in given.items() if key not in MOVING}, _Object, name)
    if len(found.pose) not in (3, 6):
        raise ValueError(f"{name}: pose must be x, y, z or x, y, z, rx, ry, rz, not {quoted(list(found.pose))}")
    x, y, z, rx, ry, rz = (*found.pose, 0.0, 0.0, 0.0)[:6]
    size = getattr(found, chosen[0])
    sizes = size if isinstance(size, tuple) else (size,) if isinstance(size, float) else ()
    material = {key: getattr(found, key) for key in MATERIAL if key in given}
    return ObjectDescription(chosen[0], sizes, (x, y, z, rx, ry, rz), material, found.mesh, moving)
