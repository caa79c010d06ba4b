"""Injected disturbances of a world: the interface for faults, independent of how the world is computed."""

from collections.abc import Collection
from typing import Protocol


class Disturbances(Protocol):
    """Disturbances by the names in the world file. Each can be repeated and undone."""

    @property
    def parts(self) -> Collection[str]:
        """Objects that move freely."""

    @property
    def conveyors(self) -> Collection[str]:
        """Belts."""

    @property
    def cameras(self) -> Collection[str]:
        """Cameras."""

    def take_away(self, part: str) -> None:
        """Remove a part, even if it has been put back since."""

    def bring_back(self, part: str) -> None:
        """Return a part, at rest, to its first position or to where it was put since."""

    def set_friction(self, part: str, friction: float | None) -> None:
        """Set a part's coefficient of friction with everything it touches; None restores its own."""

    def jam(self, conveyor: str, *, jammed: bool) -> None:
        """Stop a belt regardless of its output, or release it."""

    def cover(self, camera: str, *, covered: bool) -> None:
        """Cover a camera's lens, or uncover it."""
