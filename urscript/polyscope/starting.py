"""Play from a selected node: the nodes before it in the main program are skipped, once.

The script keeps all nodes, because loops may return to those before the selected one. A variable is true until the
selected node is reached. While it is true, the nodes before are skipped at each level, and the branches and loops
around the selected node are entered regardless of their expressions.
"""

from collections.abc import Sequence
from typing import Final

from urscript.polyscope.document import Element
from urscript.polyscope.tree import ProgramTree, TreeError, TreeLine

SKIPPING: Final = "_hidden_play_from_selection"
"""The name of that variable."""

_ELSEWHERE: Final = (
    "SpecialSequence",
    "InitVariablesNode",
    "Thread",
    "Event",
    "SubProgram",
)  # written outside the main program
_AROUND: Final = ("MainProgram", "Folder", "Move", "Loop", "If")
_PARTS: Final = ("Case", "Until")  # belong to the node around them


class StartingNode:
    """The node at which a program begins. path: this node and those that contain it, by the id() of their elements."""

    def __init__(self, tree: ProgramTree, number: int) -> None:
        """Raises TreeError, with the reason, for a node at which the program cannot begin."""
        lines = tree.lines
        if not 0 < number <= len(lines):
            raise TreeError(f"{tree.name} has no node {number}: its nodes are numbered 1 to {len(lines)}")
        line = lines[number - 1]
        self.element = line.element
        around = _around(lines, line)
        self.path = frozenset(id(each.element) for each in (*around, line))
        if (reason := _reason(line, around)) is not None:
            raise TreeError(f"the program cannot be played from node {number}: {reason}")

    def first(self, nodes: Sequence[Element]) -> int | None:
        """The index of the sibling that is or contains the first node; None if that is elsewhere."""
        for index, node in enumerate(nodes):
            if id(node.resolved()) in self.path:
                while index and node.tag == "If" and node.get("type") != "If":  # written with its If
                    index -= 1
                    node = nodes[index]
                return index
        return None

    @staticmethod
    def skipped(nodes: Sequence[Element]) -> list[Element]:
        """Those of the nodes before it that are part of the main program."""
        return [node for node in nodes if node.tag not in _ELSEWHERE]

    def condition(self, part: Element, chain: Sequence[Element], expression: str) -> str:
        """The expression of a branch or loop, changed so that it leads to the node. chain: all branches of the If."""
        if self._leads_on(part):
            return f"{SKIPPING} or ({expression})"
        if any(map(self._leads_on, chain)):
            return f"not {SKIPPING} and ({expression})"
        return expression

    def _leads_on(self, part: Element) -> bool:
        """Whether the first node is inside this one."""
        part = part.resolved()
        return id(part) in self.path and part is not self.element


def _around(lines: list[TreeLine], line: TreeLine) -> list[TreeLine]:
    """The nodes that contain a node, innermost first."""
    found, depth = list[TreeLine](), line.depth
    for each in reversed(lines[: line.number - 1]):
        if each.depth < depth:
            found.append(each)
            depth = each.depth
    return found


def _reason(line: TreeLine, around: list[TreeLine]) -> str | None:
    element = line.element
    if line.suppressed:
        return "it is suppressed"
    if element.tag in _PARTS or (element.tag == "If" and element.get("type") != "If"):
        return "it is part of the node before or around it: play from that one"
    top = (around[-1] if around else line).element.tag
    if top != "MainProgram" or element.tag in _ELSEWHERE:
        return "it is not part of the robot program: threads, events and subprograms run alongside it"
    for each in around:
        if each.element.tag not in _AROUND or each.element.get("checkContinuously") == "true":
            kind = (
                "whose expression is checked continuously"
                if each.element.tag in _AROUND
                else "which only starts as a whole"
            )
            return f"it lies in node {each.number}, {each.element.tag}, {kind}: play from that one"
    return None
