"""A program tree, and the URScript it is run as."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

from emulator.programs.trees.document import DocumentError, Element, read_steps
from emulator.programs.trees.folder import ProgramsFolder
from emulator.programs.trees.installation_file import InstallationFile
from emulator.programs.trees.nodes import NODE_MODULES
from emulator.programs.trees.nodes.urcaps import is_external_control
from emulator.programs.trees.preamble import write_preamble
from emulator.programs.trees.registry import NODES, translate
from emulator.programs.trees.twin import TwinBlock, urcap_blocks
from emulator.programs.trees.writer import ExternalControlCode, TreeError, Writer
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.work import Steps, run_to_end

__all__ = [
    "NODES",
    "ExternalControlCode",
    "ProgramTree",
    "TreeError",
    "read_tree",
    "script_of",
    "script_steps",
    "write_steps",
]

assert NODES, NODE_MODULES  # importing the modules has filled the table
_ROOT: Final = "URProgram"


class ProgramTree:
    """A PolyScope program. ``name``: as PolyScope shows it, without ``.urp``. ``twin``: text of the
    ``.script`` saved beside it, which holds the code of URCap nodes; empty without one.
    ``folder``: where the files it names are looked for."""

    def __init__(self, root: Element, name: str, twin: str = "", folder: ProgramsFolder | None = None) -> None:
        if root.tag != _ROOT or root.child("children") is None:
            raise TreeError(f"<{root.tag}> is no PolyScope program")
        self.root = root
        self.name = name
        self.twin = twin
        self.folder = folder or ProgramsFolder(None)

    @property
    def installation_names(self) -> tuple[str, ...]:
        """Names of the installation it was saved with, without extension: relative to the program, and alone."""
        relative, alone = self.root.get("installationRelativePath"), self.root.get("installation")
        return (relative or alone, alone)

    @cached_property
    def urcap_blocks(self) -> list[TwinBlock]:
        """Code of URCap nodes in the script beside the program."""
        return urcap_blocks(self.twin)

    @cached_property
    def needs_external_control(self) -> bool:
        """Whether it has External Control nodes, for whose text a driver must be asked."""
        return any(is_external_control(element) for element in self.active())

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


def read_tree(path: Path, folder: ProgramsFolder | None = None) -> ProgramTree:
    """A ``.urp`` file. Raises OSError, DocumentError or TreeError."""
    return run_to_end(read_tree_steps(path, folder))


def read_tree_steps(path: Path, folder: ProgramsFolder | None = None) -> Steps[ProgramTree]:
    """`read_tree` in pieces, for a control loop."""
    twin = path.with_suffix(".script")
    text = twin.read_bytes().decode("utf-8", "replace").removeprefix("\ufeff") if twin.is_file() else ""
    root = yield from read_steps(path.read_bytes())
    tree = ProgramTree(root, path.stem, text, folder)
    yield len(tree.urcap_blocks)
    return tree


def script_of(
    tree: ProgramTree,
    installation: InstallationFile,
    *,
    version: PolyscopeVersion = DEFAULT_VERSION[Series.E],
    external_control: ExternalControlCode | None = None,
) -> str:
    """The URScript of a program. Raises TreeError when the tree has nodes that cannot be run, or
    External Control nodes and no code for them."""
    return run_to_end(script_steps(tree, installation, version=version, external_control=external_control))


def script_steps(
    tree: ProgramTree,
    installation: InstallationFile,
    *,
    version: PolyscopeVersion = DEFAULT_VERSION[Series.E],
    external_control: ExternalControlCode | None = None,
) -> Steps[str]:
    """`script_of` in pieces, for a control loop."""
    writer = yield from write_steps(tree, installation, version=version, external_control=external_control)
    return writer.text()


def write_steps(
    tree: ProgramTree,
    installation: InstallationFile,
    *,
    version: PolyscopeVersion,
    external_control: ExternalControlCode | None,
) -> Steps[Writer]:
    """Everything written that `script_of` puts together, with the labels of the nodes."""
    writer = Writer(tree, installation, version, external_control)
    children = tree.root.child("children")
    assert children is not None
    try:
        write_preamble(writer)
        for child in children:
            yield from translate(writer, child)
    except DocumentError as error:
        raise TreeError(f"{tree.name}: {error}") from error
    return writer
