"""Placement of ur_description's meshes on an arm: file names, and the rotation of each mesh in its link.

As in Universal_Robots_ROS2_Description 2.4.5. The offsets along z are in the arm's data file.
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


class MissingMeshesError(ValueError):
    """The folder does not contain the meshes of this arm, or their placement is not known."""


class PlacedMesh(NamedTuple):
    """A mesh with its placement. name: of its files, without extension. position [m], rpy [rad, about fixed axes]: in
    the link's frame."""

    name: str
    position: Vector3
    rpy: Vector3


def placed_meshes(model: RobotModel) -> tuple[PlacedMesh, ...]:
    """The meshes of base, shoulder, upper arm, forearm, wrist 1, 2 and 3. Raises MissingMeshesError."""
    if model.wrist_mesh_offsets is None:
        raise MissingMeshesError(f"the placement of the meshes of {model.title} has not been published: leave them out")
    offsets = (0.0, 0.0, *model.tube_offsets, *model.wrist_mesh_offsets)
    return tuple(PlacedMesh(name, (0.0, 0.0, z), rpy) for name, rpy, z in zip(_MESHES, _MESH_RPY, offsets, strict=True))


def mesh_file(folder: Path, kind: str, name: str, endings: Sequence[str]) -> Path:
    """The path of a mesh: ``visual/base.dae``, or ``base.dae`` if all are in one folder. Raises MissingMeshesError."""
    places = [folder / kind / f"{name}{ending}" for ending in endings]
    places += [folder / f"{name}{ending}" for ending in endings]
    for place in places:
        if place.is_file():
            return place
    raise MissingMeshesError(
        f"{folder} has no {kind}/{name} ({', '.join(endings)}): it must contain {', '.join(_MESHES)}"
    )
