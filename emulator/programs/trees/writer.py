"""The URScript of a program tree while it is being written."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from emulator.programs.trees.document import Element
from emulator.programs.trees.naming import identifier, quoted

if TYPE_CHECKING:
    from emulator.programs.trees.installation_file import InstallationFile
    from emulator.programs.trees.program import ProgramTree

__all__ = ["ExternalControlCode", "TreeError", "Writer"]

SECTIONS: Final = ("preamble", "variables", "waypoints", "subprograms", "before", "threads", "main")


class TreeError(ValueError):
    """The program tree cannot be run; the text names the node and the reason."""


@dataclass(frozen=True, slots=True)
class ExternalControlCode:
    """What a driver wants to run. ``header``: once per program; ``node``: at each External Control node."""

    header: str
    node: str


class Writer:
    """Collects the lines of a program by section, in the order PolyScope writes the sections."""

    def __init__(
        self, tree: "ProgramTree", installation: "InstallationFile", external_control: ExternalControlCode | None
    ) -> None:
        self.tree = tree
        self.installation = installation
        self.external_control = external_control
        self.subprograms: dict[str, Element] = {}  # met so far, by the name of their function
        self._sections: dict[str, list[str]] = {name: [] for name in SECTIONS}
        self._levels: dict[str, int] = dict.fromkeys(SECTIONS, 1)
        self._section = "main"
        self._numbers = tree.numbers()
        self._counters: dict[str, int] = {}
        self._once: set[str] = set()

    def line(self, text: str) -> None:
        """Write one line; further lines of a text are written as they are."""
        self._sections[self._section].append(f"{'  ' * self._levels[self._section]}{text}")

    def label(self, element: Element, text: str, stop: str = "") -> None:
        """The mark by which a client sees where the program is. ``stop``: breakAfter or noBreak."""
        number = self._numbers.get(id(element), 0)
        self.line(f"$ {number} {quoted(text)}" + (f' "{stop}"' if stop else ""))

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """A block with its end."""
        self.line(head)
        with self.indented():
            yield
        self.line("end")

    @contextmanager
    def indented(self) -> Iterator[None]:
        """What is written belongs to a block."""
        section = self._section
        self._levels[section] += 1
        yield
        self._levels[section] -= 1

    @contextmanager
    def into(self, section: str) -> Iterator[None]:
        """Write to another section."""
        before, self._section = self._section, section
        yield
        self._section = before

    def count(self, kind: str) -> int:
        """1, 2, 3, ... for each kind of thing."""
        self._counters[kind] = self._counters.get(kind, 0) + 1
        return self._counters[kind]

    def once(self, key: str) -> bool:
        """True the first time."""
        if key in self._once:
            return False
        self._once.add(key)
        return True

    def text(self) -> str:
        """The whole program."""
        lines = [f"def {identifier(self.tree.name)}():"]
        for name in SECTIONS:
            lines += self._sections[name]
        return "\n".join([*lines, "end", ""])
