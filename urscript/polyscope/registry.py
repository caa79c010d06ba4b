"""The table of node types: one decorated function each, which writes the node's URScript, and what PolyScope shows.

A node type is declared in one place. Its `Kind` says what it is called, where the palette has it, what can be set at
it, how a new one is made, where it may stand and when it is still undefined. Some types are several kinds: an ElseIf is
an If of another type.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

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

# where nodes may stand: directly in the program, among others, in a Switch, in a Direction, in a Move, behind an If
Place = Literal["program", "nodes", "switch", "direction", "move", "if"]
PROGRAM: Final = "Program"  # the group of nodes that a program has or has not, and nobody inserts elsewhere


def _nothing_undefined(_: Element) -> str:
    return ""


def _every(_: Element) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of node as the palette and the forms have it.

    new: makes one, as PolyScope would; None for those that are only read. shown: its line in the tree. stands: where it
    may stand. contains: what may stand in it: "nodes", or only the cases of a Switch and so on; empty for nothing.
    undefined: what it still lacks, in words; empty when it is complete. matches: whether an element of the tag is one.
    available: the PolyScope versions that have it. shown_by: its line in the tree, where the installation gives it.
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
        """The field of a key."""
        return next((field for field in self.fields if field.key == key), None)

    def exists_in(self, version: PolyscopeVersion) -> bool:
        """Whether a PolyScope has it."""
        return self.available is None or self.available.covers(version)


@dataclass(frozen=True, slots=True)
class NodeType:
    """A kind of node: its XML tag, what it is for, how far it is translated, the kinds of it in the palette."""

    tag: str
    doc: str
    status: Status
    note: str
    translation: Translation
    kinds: tuple[Kind, ...] = ()


_NODE_WORK: Final = 50  # guess [units of `urscript.work`]

NODES: Final[dict[str, NodeType]] = {}  # by XML tag


def node(
    tag: str,
    *kinds: Kind,
    status: Status = "supported",
    note: str = "",
    attributes: str = "",
    children: str = "",
) -> Callable[[Translation], Translation]:
    """Register a function as the translation of a node type. A generator yields after each of its steps.

    attributes, children: names in the order in which files have them; what is set anew stands where they say.
    """

    def register(translation: Translation) -> Translation:
        NODES[tag] = NodeType(tag, (translation.__doc__ or "").strip(), status, note, translation, kinds)
        ORDERS[tag] = tuple(attributes.split()), tuple(children.split())
        return translation

    return register


def empty_children() -> Element:
    """The children of a new node: the empty line that PolyScope puts where nothing is yet."""
    return make("children", make("Placeholder"))


def kind_of(element: Element) -> Kind | None:
    """The kind of a node, None when no palette has it."""
    found = NODES.get(tag_of(element))
    return next((kind for kind in found.kinds if kind.matches(element.resolved())), None) if found else None


def kinds() -> dict[str, Kind]:
    """All kinds, by their keys."""
    return {kind.key: kind for found in NODES.values() for kind in found.kinds}


def translate(writer: Writer, element: Element) -> Steps[None]:
    """Write the URScript of a node and of those in it. Raises TreeError or DocumentError for one that cannot be run;
    a writer that collects problems notes it, and goes on behind the node."""
    kind = NODES.get(element.tag)
    with writer.node(element):
        try:
            if kind is None:
                raise TreeError(f"node <{element.tag}> is not known")
            steps = kind.translation(writer, element)
            if steps is not None:
                yield from steps
        except (DocumentError, TreeError) as error:
            if writer.problems is None:
                raise
            writer.problems.append((element, str(error)))
    yield _NODE_WORK


def translate_children(writer: Writer, element: Element) -> Steps[None]:
    """Write the nodes below a node; those before the one at which the program begins are skipped by it."""
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
