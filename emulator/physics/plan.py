"""Plans of scenes: the checked contents of files, before a MuJoCo model is built; and the shapes of grippers.

Grippers have two fingers: those of ``--gripper``, and those wired to outputs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from emulator.physics.description import Barrier, Camera, Changer, Colour, Moving, Parallel, Suction
from urproto.robotiq import GripperModel
from urproto.vectors import Vector3
from urproto.worldfile import ObjectDescription

GRIPPER: Final = "gripper"
"""Name of the gripper of ``--gripper``."""

# Source of masses: the maker's specifications. Outer dimensions are close to its drawings. That the fingers move along
# the flange's y axis is a guess; that they stay parallel and at one height is a simplification.
_ROBOTIQ: Final = {
    "Robotiq 2F-85": ((0.0375, 0.115), (0.008, 0.022, 0.048), 0.925),
    "Robotiq 2F-140": ((0.0375, 0.145), (0.010, 0.025, 0.085), 1.025),
    "Robotiq Hand-E": ((0.0375, 0.115), (0.008, 0.022, 0.042), 1.07),
}
_JAW_KG: Final = 0.5  # of a gripper on outputs (guess)
STEP_S: Final = 0.002
"""The longest step of a scene whose file names none."""


@dataclass(frozen=True, kw_only=True)
class GripperShape:
    """Two fingers that move towards each other along y.

    pose: of the palm in the flange's frame, fingers along z. stroke: between the open pads [m]. palm: radius and
    length; pad: thickness, width and length along z [m]. mass: of all parts [kg]. force: minimum and maximum of one
    finger [N]. parallel: its wiring, None for a gripper with its own port. tool: the object on which it is mounted and
    in whose frame its pose is given, "" for the flange.
    """

    name: str
    pose: tuple[float, ...]
    stroke: float
    palm: tuple[float, float]
    pad: Vector3
    mass: float
    force: tuple[float, float]
    parallel: Parallel | None = None
    tool: str = ""

    @property
    def tip(self) -> float:
        """From the palm's origin to the ends of the fingers [m]."""
        return self.palm[1] + self.pad[2]


def robotiq_gripper(model: GripperModel) -> GripperShape:
    """The shape of a gripper of ``--gripper``."""
    palm, pad, mass = _ROBOTIQ[model.title]
    return GripperShape(
        name=GRIPPER,
        pose=(0.0,) * 6,
        stroke=model.stroke_mm / 1000.0,
        palm=palm,
        pad=pad,
        mass=mass,
        force=(model.weakest, model.strongest),
    )


def parallel_gripper(name: str, parallel: Parallel, pose: Sequence[float], tool: str = "") -> GripperShape:
    """The shape of a gripper on an output."""
    return GripperShape(
        name=name,
        pose=(*pose, 0.0, 0.0, 0.0)[:6],
        stroke=parallel.stroke,
        palm=(0.03, 0.07),
        pad=(0.008, 0.02, 0.04),
        mass=_JAW_KG,
        force=(parallel.force, parallel.force),
        parallel=parallel,
        tool=tool,
    )


@dataclass(frozen=True)
class MountedShape:
    """A shape mounted on the flange: its mass [kg] and the friction of its surface."""

    mass: float
    friction: float = 0.5
    colour: Colour | None = None


@dataclass(frozen=True)
class Cup:
    """A suction gripper and its pose in the flange's frame, or in that of the ``tool`` on which it is mounted."""

    suction: Suction
    pose: tuple[float, ...]
    tool: str = ""


@dataclass(frozen=True)
class Plate:
    """A tool changer and the pose of its face in the flange's frame."""

    changer: Changer
    pose: tuple[float, ...]


@dataclass(frozen=True)
class PhysicsPlan:
    """The plan of a scene, from which one scene per controller is built.

    scene: a MuJoCo or URDF file, None for none. step_s: the longest step of the physics. output_grippers: those on
    digital outputs. gripper: the one of ``--gripper``.
    """

    source: Path
    scene: Path | None = None
    step_s: float = STEP_S
    objects: Mapping[str, ObjectDescription] = field(default_factory=dict)
    moving: Mapping[str, Moving] = field(default_factory=dict)
    tool: ObjectDescription | None = None
    mounted_shapes: Mapping[str, tuple[ObjectDescription, MountedShape]] = field(default_factory=dict)
    cups: Mapping[str, Cup] = field(default_factory=dict)
    output_grippers: Mapping[str, GripperShape] = field(default_factory=dict)
    changers: Mapping[str, Plate] = field(default_factory=dict)
    gripper: GripperShape | None = None
    barriers: Mapping[str, Barrier] = field(default_factory=dict)
    cameras: Mapping[str, Camera] = field(default_factory=dict)

    links: bool = True  # contacts of the arm's links are found by MuJoCo itself

    @property
    def couplings(self) -> dict[str, tuple[float, ...]]:
        """Coupling poses of the objects that tool changers can take, in their frames."""
        return {name: moving.coupling for name, moving in self.moving.items() if moving.coupling is not None}
