"""What the verbs of every subject build on."""

from abc import ABC, abstractmethod
from collections.abc import Generator
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["ControlBase", "Waiting"]

_T = TypeVar("_T")
Waiting = Generator[None, None, _T]  # yields once for each control period it waits; returns the verb's result


class ControlBase(ABC):
    """A robot under control. Verbs are carried out between two control periods."""

    def __init__(self, controller: "Controller") -> None:
        self.controller = controller

    @abstractmethod
    def _wait(self, steps: "Waiting[_T]") -> _T:
        """Let control periods pass until the steps are done; their result.

        The last thing that a verb does, since who serves many clients takes the steps and goes on later.
        """
