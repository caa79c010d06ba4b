"""The table of node types: one decorated function each, which writes the node's URScript."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from urscript.polyscope.document import Element
from urscript.polyscope.starting import SKIPPING
from urscript.polyscope.tree import TreeError
from urscript.polyscope.writer import Writer
from urscript.work import Steps

Status = Literal["supported", "partial"]
Translation: TypeAlias = Callable[[Writer, Element], Steps[None] | None]


@dataclass(frozen=True, slots=True)
class NodeType:
    """A kind of node: its XML tag, what it is for, how far it is translated."""

    tag: str
    doc: str
    status: Status
    note: str
    translation: Translation


_NODE_WORK: Final = 50  # guess [units of `urscript.work`]

NODES: Final[dict[str, NodeType]] = {}  # by XML tag


def node(tag: str, *, status: Status = "supported", note: str = "") -> Callable[[Translation], Translation]:
    """Register a function as the translation of a node type. A generator yields after each of its steps."""

    def register(translation: Translation) -> Translation:
        NODES[tag] = NodeType(tag, (translation.__doc__ or "").strip(), status, note, translation)
        return translation

    return register


def translate(writer: Writer, element: Element) -> Steps[None]:
    """Write the URScript of a node and of those in it. Raises TreeError for one that cannot be run."""
    kind = NODES.get(element.tag)
    if kind is None:
        raise TreeError(f"node <{element.tag}> is not known")
    with writer.node(element.tag):
        steps = kind.translation(writer, element)
        if steps is not None:
            yield from steps
    yield _NODE_WORK


def translate_children(writer: Writer, element: Element) -> Steps[None]:
    """Write the nodes below a node; those before the one at which the program begins are skipped by it."""
    nodes = [child.resolved() for child in element.child("children") or ()]
    starting = writer.starting
    first = starting.first(nodes) if starting is not None else None
    if starting is not None and first is not None:
        if before := starting.skipped(nodes[:first]):
            with writer.block(f"if (not {SKIPPING}):"):
                for node in before:
                    yield from translate(writer, node)
        nodes = [node for node in nodes[:first] if node not in before] + nodes[first:]
    for node in nodes:
        if starting is not None and node is starting.element:
            writer.line(f"{SKIPPING} = False")
        yield from translate(writer, node)
