"""A program as PolyScope saves it (``.urp``): its nodes, and the lines by which PolyScope numbers them."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from urscript.polyscope.document import Element, read_steps
from urscript.polyscope.folder import ProgramsFolder, read_file, read_text
from urscript.polyscope.numbers import quoted
from urscript.polyscope.saved_script import NO_SAVED_SCRIPT, SavedScript, read_saved_script
from urscript.work import Steps, run_to_end

EXTERNAL_CONTROL: Final = "External Control"  # the name of the URCap
_ROOT: Final = "URProgram"
_OLD_ROOT: Final = "gui.program.ProgramRootNode"
_LINES_AT_ONCE: Final = 64  # between two yields
_LINE_WORK: Final = 6  # measured: 5 microseconds for a node


class TreeError(ValueError):
    """The program tree cannot be run; the message names the node and the reason."""


def tag_of(element: Element) -> str:
    """The tag of a node; also that of a suppressed node, which stores it in a different place."""
    own = element.attributes.get("class", "") if element.tag == "suppressedNode" else element.tag
    return own or element.tag


def is_external_control(element: Element) -> bool:
    """Whether a node is one of the External Control URCap."""
    return tag_of(element) == "Contributed" and element.get("strategyURCapName") == EXTERNAL_CONTROL


@dataclass(frozen=True, slots=True)
class TreeLine:
    """A node. number: its line in the program tree, from 1, as used in labels. suppressed: it is not executed."""

    number: int
    depth: int
    element: Element
    suppressed: bool


class ProgramTree:
    """A PolyScope program.

    name: as PolyScope shows it, without ``.urp``. saved_script: the ``.script`` saved with it, which contains the code
    of URCap nodes. folder: where the files that it names are searched.
    """

    def __init__(
        self,
        root: Element,
        name: str,
        saved_script: SavedScript = NO_SAVED_SCRIPT,
        folder: ProgramsFolder | None = None,
    ) -> None:
        if root.tag == _OLD_ROOT:
            raise TreeError(
                "it was saved by PolyScope 3.1 or earlier (seen: 1.7 to 3.1), whose files contain the controller's "
                "internal objects and cannot be read: load and save it with a newer PolyScope"
            )
        if root.tag != _ROOT or root.child("children") is None:
            raise TreeError(f"<{root.tag}> is not a PolyScope program")
        self.root = root
        self.name = name
        self.saved_script = saved_script
        self.folder = folder or ProgramsFolder(None)

    @property
    def installation_names(self) -> tuple[str, ...]:
        """Names of the installation it was saved with, without extension: relative to the program, and alone."""
        relative, alone = self.root.get("installationRelativePath"), self.root.get("installation")
        return (relative or alone, alone)

    @cached_property
    def changed_since_saved(self) -> str:
        """A difference between the program and the script saved with it, as text; empty when they match.

        Only nodes with names given by users are compared, because other labels depend on the pendant's language.
        """
        for line in self.lines:
            label = self.saved_script.labels.get(line.number)
            name = quoted(_given_name(line.element))[1:-1]
            if label is not None and line.suppressed:
                return f"line {line.number} is suppressed in the program but {label!r} in the script"
            if label is not None and name and label != name:
                return f"line {line.number} is {name!r} in the program but {label!r} in the script"
        last = max(self.saved_script.labels, default=0)
        if last > len(self.lines):
            return f"the program has {len(self.lines)} lines but the script has {last}"
        return ""

    @cached_property
    def needs_external_control(self) -> bool:
        """Whether it has External Control nodes, whose code must be requested from a driver."""
        return any(is_external_control(line.element) for line in self.lines if not line.suppressed)

    @cached_property
    def lines(self) -> list["TreeLine"]:
        """Every node, in the order in which PolyScope shows and numbers them.

        The file contains a subprogram where it is first mentioned, which may be in a Call. Its lines count at the
        position of the subprogram itself in the tree.
        """
        return run_to_end(self._line_steps())

    def number_steps(self) -> Steps[None]:
        """Find all lines and their numbers, in pieces for a control loop; otherwise this is done on first use."""
        lines = yield from self._line_steps()
        numbers, external = dict[int, int](), False
        for line in lines:
            numbers[id(line.element)] = line.number
            external = external or (not line.suppressed and is_external_control(line.element))
            if line.number % _LINES_AT_ONCE == 0:
                yield _LINES_AT_ONCE
        vars(self).update(lines=lines, numbers=numbers, needs_external_control=external)  # the cached properties

    def _line_steps(self) -> Steps[list["TreeLine"]]:
        lines = list[TreeLine]()
        seen = set[int]()
        waiting = [(child, 0, False) for child in reversed(_nodes(self.root))]
        while waiting:
            element, depth, suppressed = waiting.pop()
            if id(element) in seen:
                continue
            seen.add(id(element))
            suppressed |= element.tag == "SuppressedNode"
            lines.append(TreeLine(len(lines) + 1, depth, element, suppressed))
            waiting.extend((child, depth + 1, suppressed) for child in reversed(_nodes(element)))
            if len(lines) % _LINES_AT_ONCE == 0:
                yield _LINES_AT_ONCE * _LINE_WORK
        return lines

    @cached_property
    def numbers(self) -> dict[int, int]:
        """The line of each node in the program tree, by the identity of its element."""
        return {id(line.element): line.number for line in self.lines}

    def called(self, name: str) -> Steps["ProgramTree | None"]:
        """The program file that this one calls by name; None if it is missing. Raises DocumentError or TreeError."""
        path = self.folder.find(name)
        return (yield from read_tree_steps(path, self.folder)) if path else None


def _given_name(element: Element) -> str:
    """The name that a user gave a node, which its label shows unchanged; empty for other nodes."""
    if element.tag == "Waypoint" and element.get("type") == "Variable":
        variable = element.child("variable")
        return variable.get("name") if variable else ""
    return element.get("name") if element.tag in ("Waypoint", "Folder", "SubProgram", "Thread") else ""


def _nodes(element: Element) -> list[Element]:
    """The nodes directly below a node. A suppressed node has a wrapper, which is not a separate line."""
    node = element.child("suppressedNode") if element.tag == "SuppressedNode" else element
    children = node.child("children") if node else None
    return [child.resolved() for child in children or ()]


def read_tree_steps(path: Path, folder: ProgramsFolder | None = None) -> Steps[ProgramTree]:
    """A ``.urp`` file, read in pieces for a control loop. Raises OSError, DocumentError or TreeError."""
    beside = path.with_suffix(".script")
    data = read_file(path)
    saved_script = yield from read_saved_script(read_text(beside) if beside.is_file() else "")
    tree = ProgramTree((yield from read_steps(data)), path.stem, saved_script, folder)
    yield from tree.number_steps()
    return tree
