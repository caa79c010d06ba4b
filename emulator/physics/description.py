"""Moving objects of a world file, and what is wired to them: the keys that `urproto.worldfile` passes on.

Lengths in m, angles in rad, forces in N, masses in kg. Digital signals are numbered as in RTDE's words: 0 to 7
standard, 8 to 15 configurable, 16 and 17 the tool's.
"""

from collections.abc import Mapping
from math import isfinite, sqrt
from typing import Annotated, Any, Final, TypeVar

import msgspec

from urproto.robots.pose import matrix_to_rotvec
from urproto.structures import converted
from urproto.vectors import Vector3, Vector6, cross, sub3, unit
from urproto.worldfile import ObjectDescription

Signal = Annotated[int, msgspec.Meta(ge=0, le=17)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Colour = tuple[
    Annotated[float, msgspec.Meta(ge=0.0, le=1.0)],
    Annotated[float, msgspec.Meta(ge=0.0, le=1.0)],
    Annotated[float, msgspec.Meta(ge=0.0, le=1.0)],
]
Pose = Annotated[tuple[float, ...], msgspec.Meta(min_length=3, max_length=6)]  # x, y, z, and a rotation vector
_MAX_PIXELS: Final = 1920
_UP: Final[Vector3] = (0.0, 0.0, 1.0)
_RIGHT: Final[Vector3] = (1.0, 0.0, 0.0)  # of a camera that looks straight up or down
_AHEAD: Final = _UP

_T = TypeVar("_T")


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class: rejects unknown keys."""


class Joint(_Part, frozen=True):
    """A joint by which an object slides or turns: axis and ``at`` in the object's frame at position 0.

    range: [m or rad]. stiffness: of a spring towards 0 [N/m, Nm/rad]. input: high beyond half of the range, like a
    button. output: of a cylinder or a drive, which moves to the far end while it is high and back while it is low,
    with at most ``force`` [N, Nm].
    """

    axis: Vector3
    range: tuple[float, float]
    at: Vector3 = (0.0, 0.0, 0.0)
    stiffness: NotNegative = 0.0
    damping: NotNegative = 1.0
    input: Signal | None = None
    output: Signal | None = None
    force: Positive = 100.0

    def __post_init__(self) -> None:
        if sqrt(sum(part * part for part in self.axis)) < 1e-6:
            raise ValueError("axis must not be zero")
        low, high = self.range
        if not (low < high and isfinite(low) and isfinite(high)):
            raise ValueError("range must be two numbers, the smaller one first")
        if not low <= 0.0 <= high:
            raise ValueError("range must contain 0, the initial position")

    @property
    def far(self) -> float:
        """The end of the range that is farther from 0."""
        return max(self.range, key=abs)


class Conveyor(_Part, frozen=True):
    """A belt: its surface moves along the x axis of the object [m/s]; with an ``output``, only while it is high.

    encoder: the robot's encoder (0 or 1) that counts ``ticks_per_m``.
    """

    speed: float
    encoder: Annotated[int, msgspec.Meta(ge=0, le=1)] | None = None
    ticks_per_m: Positive = 10_000.0
    output: Signal | None = None


class Moving(_Part, frozen=True):
    """The keys of one object. mass: of an object that is free to move or moved by a joint; without it, the object is
    fixed. lamp: lit while that output is high. coupling: where a tool changer takes it, in its own frame."""

    mass: Positive | None = None
    slide: Joint | None = None
    hinge: Joint | None = None
    conveyor: Conveyor | None = None
    lamp: Signal | None = None
    colour: Colour | None = None
    coupling: Pose | None = None

    def __post_init__(self) -> None:
        if self.slide is not None and self.hinge is not None:
            raise ValueError("an object cannot both slide and turn: give slide or hinge")
        if self.joint is not None and self.mass is None:
            raise ValueError("an object with a joint needs a mass")
        if self.conveyor is not None and self.mass is not None:
            raise ValueError("a conveyor is fixed: leave its mass out")
        if self.coupling is not None and (self.mass is None or self.joint is not None):
            raise ValueError("an object with a coupling must be free to move: give it a mass, and no joint")

    @property
    def joint(self) -> Joint | None:
        return self.slide or self.hinge


class Barrier(_Part, frozen=True, rename={"start": "from", "end": "to"}):
    """A light barrier between two points of the base frame: its input is high while an object is between them."""

    start: Vector3
    end: Vector3
    input: Signal

    def __post_init__(self) -> None:
        if self.start == self.end:
            raise ValueError("from and to are the same point")


class Camera(_Part, frozen=True):
    """A camera: looks along its z axis, with x to the right and y down, like a camera's optical frame in ROS.

    pose: in the base frame, or in the flange's with ``frame: flange``. at: a point to look at, instead of the pose's
    direction, with the picture upright if z is up. size: width and height in pixels. fov: vertical field of view [rad].
    """

    pose: Pose
    at: Vector3 | None = None
    frame: Annotated[str, msgspec.Meta(pattern="^(base|flange)$")] = "base"
    size: tuple[
        Annotated[int, msgspec.Meta(ge=1, le=_MAX_PIXELS)], Annotated[int, msgspec.Meta(ge=1, le=_MAX_PIXELS)]
    ] = (320, 240)
    fov: Annotated[float, msgspec.Meta(gt=0.01, lt=3.1)] = 0.8

    def __post_init__(self) -> None:
        if self.at is not None and self.at == self.pose[:3]:
            raise ValueError("at is the camera's own position: give a point for it to look at")

    @property
    def placed(self) -> Vector6:
        """Pose of the optical frame."""
        x, y, z, rx, ry, rz = (*self.pose, 0.0, 0.0, 0.0)[:6]
        if self.at is not None:
            ahead = unit(sub3(self.at, (x, y, z)), _AHEAD)
            right = unit(cross(ahead, _UP), _RIGHT)
            down = cross(ahead, right)
            rx, ry, rz = matrix_to_rotvec([part for row in zip(right, down, ahead, strict=True) for part in row])
        return (x, y, z, rx, ry, rz)


class Parallel(_Part, frozen=True):
    """A gripper with two jaws along the y axis of its pose: closed while ``output`` is high.

    stroke: between the open jaws [m]. holding: an input that is high while an object stops the jaws. closed: one that
    is high while the jaws are closed with nothing between them. speed: of each jaw [m/s].
    """

    output: Signal
    stroke: Positive = 0.05
    force: Positive = 60.0
    speed: Positive = 0.05
    holding: Signal | None = None
    closed: Signal | None = None


class Suction(_Part, frozen=True):
    """A suction cup at its pose, active along z while ``output`` is high. vacuum: an input, high while it holds.

    force: the pull that detaches the object [N]; radius: of the cup [m].
    """

    output: Signal
    vacuum: Signal | None = None
    force: Positive = 40.0
    radius: Positive = 0.015


class Changer(_Part, frozen=True):
    """The half of a tool changer that is on the flange, its face at its pose.

    When ``output`` goes high, it takes the tool whose coupling is at its face; when it goes low, it releases the tool.
    locked: an input, high while it has one.
    """

    output: Signal
    locked: Signal | None = None


class Mounted(_Part, frozen=True):
    """A gripper or a tool changer on the flange; pose of its centre, its cup's lip or its face, in the flange's frame.

    tool: an object with a coupling on which the gripper is instead; the pose is in that object's frame.
    """

    parallel: Parallel | None = None
    suction: Suction | None = None
    changer: Changer | None = None
    pose: Pose = (0.0, 0.0, 0.0)
    tool: str = ""

    def __post_init__(self) -> None:
        if sum(kind is not None for kind in (self.parallel, self.suction, self.changer)) != 1:
            raise ValueError("give parallel, suction or changer, or one shape")
        if self.changer is not None and self.tool:
            raise ValueError("a tool changer must be on the flange: leave tool out")


def moving_of(name: str, thing: ObjectDescription) -> Moving:
    """The keys of a moving object. Raises ValueError."""
    return converted(dict(thing.moving), Moving, name)


def section(sections: Mapping[str, Any], key: str, kind: type[_T]) -> dict[str, _T]:
    """Read a section of the file: entries of one kind by name. Raises ValueError."""
    given = sections.get(key) or {}
    if not isinstance(given, dict):
        raise ValueError(f"{key} must be a mapping from names")
    return {str(name): converted(value, kind, name) for name, value in given.items()}
