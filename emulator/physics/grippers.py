"""Grippers with two fingers, as shapes and forces: those of ``--gripper``, and those on outputs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from emulator.devices.robotiq import GripperModel
from emulator.physics.description import Parallel
from urproto.vectors import Vector3

GRIPPER: Final = "gripper"
"""The name of the one of ``--gripper``."""


@dataclass(frozen=True, kw_only=True)
class HandShape:
    """Two fingers that move against each other along y.

    pose: of the palm in the flange's frame, fingers along z. stroke: between the open pads [m]. palm: radius and
    length; pad: its thickness, width and length along z [m]. mass [kg] with all its parts. force: least and greatest of
    one finger [N]. parallel: what it is wired to, None for one with a port of its own. tool: the thing that it is on
    and in whose frame its pose is, "" for the flange.
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


# Masses, forces: the maker's specifications. Outer dimensions are near its drawings; that the fingers move along the
# flange's y axis is a guess, and fingers that stay parallel and at one height a simplification.
_ROBOTIQ: Final = {
    "Robotiq 2F-85": ((0.0375, 0.115), (0.008, 0.022, 0.048), 0.925, (20.0, 235.0)),
    "Robotiq 2F-140": ((0.0375, 0.145), (0.010, 0.025, 0.085), 1.025, (10.0, 125.0)),
    "Robotiq Hand-E": ((0.0375, 0.115), (0.008, 0.022, 0.042), 1.07, (20.0, 130.0)),
}
_JAW_KG: Final = 0.5  # of a gripper on outputs (guess)


def robotiq_hand(model: GripperModel) -> HandShape:
    """The shape of a gripper of ``--gripper``."""
    palm, pad, mass, force = _ROBOTIQ[model.title]
    return HandShape(
        name=GRIPPER,
        pose=(0.0,) * 6,
        stroke=model.stroke_mm / 1000.0,
        palm=palm,
        pad=pad,
        mass=mass,
        force=force,
    )


def parallel_hand(name: str, parallel: Parallel, pose: Sequence[float], tool: str = "") -> HandShape:
    """The shape of a gripper on an output."""
    return HandShape(
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
