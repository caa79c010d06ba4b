"""The outline of a program as shown on a pendant: the name and depth of each node."""

from dataclasses import dataclass
from typing import Final

from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import Element
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.naming import tag_in_words
from urscript.polyscope.program import write_steps
from urscript.polyscope.tree import ProgramTree
from urscript.polyscope.writer import ExternalControlCode
from urscript.work import Steps

_NODE_WORK: Final = 20  # guess [units of `urscript.work`]


@dataclass(frozen=True, slots=True)
class OutlineNode:
    """A node of the outline. number: its line in the tree, as used in labels. suppressed: it is not executed."""

    number: int
    depth: int
    text: str
    suppressed: bool = False


def outline_steps(
    tree: ProgramTree, installation: InstallationFile, version: PolyscopeVersion
) -> Steps[list[OutlineNode]]:
    """All nodes in order, in pieces for a control loop. Raises TreeError for a tree that cannot be run."""
    writer = yield from write_steps(tree, installation, version=version, external_control=ExternalControlCode("", ""))
    nodes = list[OutlineNode]()
    for line in tree.lines:
        text = writer.labels.get(line.number) or _name(line.element)
        nodes.append(OutlineNode(line.number, line.depth, text, line.suppressed))
        yield _NODE_WORK
    return nodes


def _name(element: Element) -> str:
    """The name of a node without a label: its own, or that of its kind."""
    kind, named = element.tag, element
    if element.tag == "SuppressedNode" and (inner := element.child("suppressedNode")) is not None:
        kind, named = inner.get("class") or kind, inner
    return named.attributes.get("name") or tag_in_words(kind)
