"""What can go wrong in a world on purpose: the interface by which faults reach it, whatever computes it."""

from collections.abc import Collection
from typing import Protocol


class Disturbances(Protocol):
    """Names are those of the world's file. Each can be called again and again, and undone."""

    @property
    def parts(self) -> Collection[str]:
        """What moves freely."""

    @property
    def conveyors(self) -> Collection[str]:
        """Belts."""

    @property
    def cameras(self) -> Collection[str]:
        """What looks."""

    def take_away(self, part: str) -> None:
        """Let a part be nowhere, although somebody has put it back since."""

    def bring_back(self, part: str) -> None:
        """Let it be where it was at first, or was put since, at rest."""

    def set_friction(self, part: str, friction: float | None) -> None:
        """Let it slide with this coefficient, whatever it touches; None for its own again."""

    def jam(self, conveyor: str, *, jammed: bool) -> None:
        """Let a belt stand whatever its output says, or not any more."""

    def cover(self, camera: str, *, covered: bool) -> None:
        """Let something be before a lens, or not any more."""
