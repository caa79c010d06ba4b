"""The user's meshes of an arm, for browsers: STL, or GLB, in a folder as ``ur-client describe`` takes it."""

from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from nicegui import app

from urproto.robots.meshes import MeshesMissing, PlacedMesh, mesh_file, placed_meshes
from urproto.robots.model import RobotModel

__all__ = ["ServedMesh", "served_meshes"]

_VISUAL: Final = (".glb", ".gltf", ".stl")  # what browsers read; ur_description's .dae is not among it
_COLLISION: Final = (".stl",)


class ServedMesh(NamedTuple):
    """One link's. url: on this pendant."""

    url: str
    placed: PlacedMesh

    @property
    def is_stl(self) -> bool:
        """It has no colours of its own."""
        return self.url.endswith(".stl")


@cache
def served_meshes(folder: Path, model: RobotModel) -> tuple[ServedMesh, ...]:
    """Of base to wrist 3, from the folder itself or the one in it that is named for the model. Raises MeshesMissing."""
    own = folder / model.name
    place = own if own.is_dir() else folder
    return tuple(_served(place, model, mesh) for mesh in placed_meshes(model))


def _served(folder: Path, model: RobotModel, mesh: PlacedMesh) -> ServedMesh:
    try:
        file = mesh_file(folder, "visual", mesh.name, _VISUAL)
    except MeshesMissing:
        file = mesh_file(folder, "collision", mesh.name, _COLLISION)
    url = f"/meshes/{model.name}/{mesh.name}{file.suffix}"
    app.add_static_file(local_file=file, url_path=url)
    return ServedMesh(url, mesh)
