"""The table of node types. Each has a decorated function, which writes the node's URScript, and its `Kind`s.

A node type is declared in one place. Its `Kind` defines its title, its group in the palette, its fields, how to create
one, where it may be placed and when it is incomplete. Some types have several kinds: an ElseIf is an If whose attribute
``type`` differs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, TypeVar

from urproto.versions import Availability, PolyscopeVersion
from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.forms import Field
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.starting import SKIPPING
from urscript.polyscope.surroundings import ORDERS, Surroundings
from urscript.polyscope.tree import TreeError, tag_of
from urscript.polyscope.writer import Writer
from urscript.work import Steps

Status = Literal["supported", "partial"]
Group = Literal["Basic", "Advanced", "Templates", "URCaps", "Program"]
Translation: TypeAlias = Callable[[Writer, Element], Steps[None] | None]
_Written = TypeVar("_Written", bound=Translation)

# where a node may be: at the top level, among other nodes, in a Switch, in a Direction, in a Move, after an If
Place = Literal["program", "nodes", "switch", "direction", "move", "if"]
PROGRAM: Final = "Program"  # the group of nodes at the top level of a program
_NODE_WORK: Final = 50  # guess [units of `urscript.work`]


def _nothing_undefined(_: Element) -> str:
    return ""


def _every(_: Element) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of node for the palette and the forms.

    new: creates one as PolyScope does; None for kinds that can only be read. shown: its line in the tree. stands: where
    it may be placed. contains: what may be inside it: "nodes", or only the cases of a Switch and so on; empty for
    nothing. undefined: what it still lacks, as text; empty when it is complete. matches: whether an element of the tag
    is of this kind. available: the PolyScope versions that have it. shown_by: its line in the tree, if that depends on
    the installation.
    """

    key: str
    title: str
    group: Group
    shown: Callable[[Element], str]
    new: Callable[[Surroundings], Element] | None = None
    fields: Sequence[Field] = ()
    stands: Place = "nodes"
    contains: Literal["", "nodes", "switch", "direction", "circle"] = ""
    undefined: Callable[[Element], str] = _nothing_undefined
    matches: Callable[[Element], bool] = _every
    available: Availability | None = None
    shown_by: Callable[[InstallationFile], str] | None = None

    def field(self, key: str) -> Field | None:
        """The field with this key."""
        return next((field for field in self.fields if field.key == key), None)

    def exists_in(self, version: PolyscopeVersion) -> bool:
        """Whether a PolyScope version has it."""
        return self.available is None or self.available.covers(version)


@dataclass(frozen=True, slots=True)
class NodeType:
    """A node type: its XML tag, its purpose, how far it is supported, and its kinds in the palette."""

    tag: str
    doc: str
    status: Status
    note: str
    translation: Translation
    kinds: tuple[Kind, ...] = ()


NODES: Final[dict[str, NodeType]] = {}  # by XML tag


def node(
    tag: str,
    *kinds: Kind,
    status: Status = "supported",
    note: str = "",
    attributes: str = "",
    children: str = "",
) -> Callable[[_Written], _Written]:
    """Register a function as the translation of a node type. A generator function yields after each step.

    attributes, children: names in the order of the files, which determines where a new one is inserted.
    """

    def register(translation: _Written) -> _Written:
        NODES[tag] = NodeType(tag, (translation.__doc__ or "").strip(), status, note, translation, kinds)
        ORDERS[tag] = tuple(attributes.split()), tuple(children.split())
        return translation

    return register


def empty_children() -> Element:
    """The children of a new node: the empty line that PolyScope inserts as a placeholder."""
    return make("children", make("Placeholder"))


def kind_of(element: Element) -> Kind | None:
    """The kind of a node; None for an unknown one."""
    found = NODES.get(tag_of(element))
    return next((kind for kind in found.kinds if kind.matches(element.resolved())), None) if found else None


def kinds() -> dict[str, Kind]:
    """All kinds by their keys."""
    return {kind.key: kind for found in NODES.values() for kind in found.kinds}


def translate(writer: Writer, element: Element) -> Steps[None]:
    """Write the URScript of a node and of the nodes inside it.

    Raises TreeError or DocumentError for a node that cannot be run; a writer that collects problems records it instead,
    and continues after the node.
    """
    kind = NODES.get(element.tag)
    with writer.node(element):
        try:
            if kind is None:
                raise TreeError(f"unknown node <{element.tag}>")
            steps = kind.translation(writer, element)
            if steps is not None:
                yield from steps
        except (DocumentError, TreeError) as error:
            if writer.problems is None:
                raise
            writer.problems.append((element, str(error)))
    yield _NODE_WORK


def translate_children(writer: Writer, element: Element) -> Steps[None]:
    """Write the nodes below a node; at run time, the script skips those before the node at which the program begins."""
    nodes = list(element.child("children") or ())
    starting = writer.starting
    first = starting.first(nodes) if starting is not None else None
    if starting is not None and first is not None:
        if before := starting.skipped(nodes[:first]):
            with writer.block(f"if (not {SKIPPING}):"):
                for node in before:
                    yield from translate(writer, node)
        nodes = [node for node in nodes[:first] if node not in before] + nodes[first:]
    for node in nodes:
        if starting is not None and node.resolved() is starting.element:
            writer.line(f"{SKIPPING} = False")
        yield from translate(writer, node)
