"""Solids of revolution for NiceGUI's scenes, which have none."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from nicegui.elements.scene.scene_object3d import Object3D

__all__ = ["Lathe"]

_SEGMENTS: Final = 28


class Lathe(Object3D, component=Path(__file__).with_name("static") / "lathe.js"):
    """About its z axis. profile: (radius, z), from bottom to top."""

    def __init__(self, profile: Sequence[tuple[float, float]]) -> None:
        super().__init__([list(point) for point in profile], _SEGMENTS)
