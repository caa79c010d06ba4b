"""A program tree, and the URScript it is run as."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

from emulator.programs.trees import nodes
from emulator.programs.trees.document import Element, read_document
from emulator.programs.trees.installation_file import InstallationFile
from emulator.programs.trees.registry import translate
from emulator.programs.trees.writer import ExternalControlCode, TreeError, Writer
from urscript.work import Steps, run_to_end

__all__ = ["ExternalControlCode", "ProgramTree", "TreeError", "read_tree", "script_of", "script_steps"]

assert nodes.REGISTERED
_ROOT: Final = "URProgram"


class ProgramTree:
    """A PolyScope program. ``name``: as PolyScope shows it, without ``.urp``. ``twin``: text of the
    ``.script`` saved beside it, which holds the code of URCap nodes; empty without one."""

    def __init__(self, root: Element, name: str, twin: str = "") -> None:
        if root.tag != _ROOT or root.child("children") is None:
            raise TreeError(f"<{root.tag}> is no PolyScope program")
        self.root = root
        self.name = name
        self.twin = twin

    @cached_property
    def needs_external_control(self) -> bool:
        """Whether it has External Control nodes, for whose text a driver must be asked."""
        return any(nodes.is_external_control(element) for element in self.active())

    def active(self) -> Iterator[Element]:
        """Every node that is not suppressed, in the order of the tree."""
        waiting = [self.root]
        while waiting:
            element = waiting.pop()
            if element.tag == "SuppressedNode":
                continue
            yield element
            waiting.extend(reversed(element.children))

    def numbers(self) -> dict[int, int]:
        """The line of each node in the program tree, by the identity of its element."""
        tree = (element for element in self.root.walk() if element.parent and element.parent.tag == "children")
        return {id(element): number for number, element in enumerate(tree, 1)}


def read_tree(path: Path) -> ProgramTree:
    """A ``.urp`` file. Raises OSError, DocumentError or TreeError."""
    twin = path.with_suffix(".script")
    text = twin.read_bytes().decode("utf-8", "replace") if twin.is_file() else ""
    return ProgramTree(read_document(path.read_bytes()), path.stem, text)


def script_of(
    tree: ProgramTree, installation: InstallationFile, *, external_control: ExternalControlCode | None = None
) -> str:
    """The URScript of a program. Raises TreeError when the tree has nodes that cannot be run, or
    External Control nodes and no code for them."""
    return run_to_end(script_steps(tree, installation, external_control=external_control))


def script_steps(
    tree: ProgramTree, installation: InstallationFile, *, external_control: ExternalControlCode | None = None
) -> Steps[str]:
    """`script_of` in pieces, for a control loop."""
    writer = Writer(tree, installation, external_control)
    children = tree.root.child("children")
    assert children is not None
    for child in children:
        yield from translate(writer, child)
    return writer.text()
