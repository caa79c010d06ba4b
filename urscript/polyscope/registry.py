"""The table of node types: one decorated function each, which writes the node's URScript."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from urscript.polyscope.document import Element
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
    """Write the nodes below a node."""
    children = element.child("children")
    for child in children or ():
        yield from translate(writer, child)
