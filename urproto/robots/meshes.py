"""Where the meshes of ur_description belong on an arm, and where its tubes are.

Names of the files, the turn of each in its link, and how far along z it is: the offsets of ur_description
(config/*/physical_parameters.yaml and visual_parameters.yaml of Universal_Robots_ROS2_Description 2.4.5).
"""

from collections.abc import Sequence
from math import pi
from pathlib import Path
from typing import Final, NamedTuple

from urproto.robots.model import RobotModel
from urproto.vectors import ZERO3, Vector3

_MESHES: Final = ("base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3")
_MESH_RPY: Final[Sequence[Vector3]] = (
    *((0.0, 0.0, pi), (0.0, 0.0, pi), (pi / 2, 0.0, -pi / 2), (pi / 2, 0.0, -pi / 2)),
    *((pi / 2, 0.0, 0.0), ZERO3, (pi / 2, 0.0, 0.0)),
)
_UR5E: Final = (0.138, 0.007, -0.127, -0.0997, -0.0989)
_UR10E: Final = (0.1762, 0.0393, -0.135, -0.12, -0.1168)
_UR20: Final = (0.26, 0.043, -0.0775, -0.0749, -0.07)
_OFFSETS: Final = {  # of upper arm, forearm, wrist 1, 2, 3 [m]
    "ur3": (0.1198, 0.0275, -0.085, -0.085, -0.082),
    "ur5": (0.13585, 0.0165, -0.093, -0.095, -0.0818),
    "ur10": (0.220941, 0.049042, -0.1149, -0.1158, -0.0922),
    "ur3e": (0.12, 0.027, -0.104, -0.08535, -0.0921),
    "ur5e": _UR5E,
    "ur7e": _UR5E,
    "ur10e": _UR10E,
    "ur12e": _UR10E,
    "ur16e": (0.176, 0.04, -0.135, -0.12, -0.1168),
    "ur20": _UR20,
    "ur30": _UR20,
}
_OUT_OF_CENTRES: Final = (1.2, 0.75)  # guess: of the other arms, offsets are so much of their centres of mass


class MeshesMissing(ValueError):  # noqa: N818 - named for what happened, as UnknownModel is
    """The folder does not have the meshes of this arm, or nobody knows where they belong."""


class PlacedMesh(NamedTuple):
    """name: of its files, without ending. position [m] and rpy [rad, about fixed axes]: in the link's frame."""

    name: str
    position: Vector3
    rpy: Vector3


def placed_meshes(model: RobotModel) -> tuple[PlacedMesh, ...]:
    """Of base, shoulder, upper arm, forearm, wrist 1, 2 and 3. Raises MeshesMissing."""
    if model.name not in _OFFSETS:
        known = ", ".join(_OFFSETS)
        raise MeshesMissing(
            f"where the meshes of {model.title} belong is not known here, only of {known}: leave them out"
        )
    offsets = (0.0, 0.0, *_OFFSETS[model.name])
    return tuple(PlacedMesh(name, (0.0, 0.0, z), rpy) for name, rpy, z in zip(_MESHES, _MESH_RPY, offsets, strict=True))


def mesh_file(folder: Path, kind: str, name: str, endings: Sequence[str]) -> Path:
    """``visual/base.dae``, or ``base.dae`` where all files are in one folder. Raises MeshesMissing."""
    places = [folder / kind / f"{name}{ending}" for ending in endings]
    places += [folder / f"{name}{ending}" for ending in endings]
    for place in places:
        if place.is_file():
            return place
    raise MeshesMissing(f"{folder} has no {kind}/{name} ({', '.join(endings)}): it must hold {', '.join(_MESHES)}")


def tube_offsets(model: RobotModel) -> tuple[float, float]:
    """How far the middles of upper arm and forearm are out along the joints' axes [m]."""
    if model.name in _OFFSETS:
        upper, fore, *_ = _OFFSETS[model.name]
        return upper, fore
    return _OUT_OF_CENTRES[0] * model.links[1].com_m[2], _OUT_OF_CENTRES[1] * model.links[2].com_m[2]
