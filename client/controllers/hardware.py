"""What a controller manager asks of the hardware under it."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from client.controllers.interfaces import Interfaces

__all__ = ["Hardware"]


class Hardware(Protocol):
    """A robot as interfaces.

    states, commands: all there are. failure: why the arm cannot be moved and will not be by
    itself; None while all is well, also while the robot merely waits.
    """

    states: Interfaces
    commands: Interfaces
    failure: str | None

    def read(self, state: Mapping[str, Any], period_s: float) -> None:
        """Set the states from what the robot reported."""

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Whether these command interfaces can be begun and ended together; raises ControllerError if not."""

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Begin and end them."""

    def write(self, time_s: float, period_s: float) -> None:
        """Do what is commanded."""

    def take_halt(self) -> str | None:
        """Why the arm was stopped by something else than its controllers since the last call; None if it was not."""
