"""Plans of scenes: the checked contents of files, before a MuJoCo model is built."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from emulator.physics.description import Barrier, Camera, Changer, Colour, Moving, Suction
from emulator.physics.grippers import GripperShape
from urproto.worldfile import ObjectDescription

STEP_S: Final = 0.002
"""The longest step of a scene whose file names none."""


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
