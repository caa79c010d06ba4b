"""Playing from a selected node: what lies before it in the main program is skipped, once.

The script keeps all of its nodes, since loops come back to those before the selected one. A variable is true until the
selected node is reached; while it is, what lies before is skipped at each level, and the branches and loops around the
node are entered whatever their expressions say.
"""

from collections.abc import Sequence
from typing import Final

from urscript.polyscope.document import Element
from urscript.polyscope.tree import ProgramTree, TreeError, TreeLine

SKIPPING: Final = "_hidden_play_from_selection"
"""The variable."""

_ELSEWHERE: Final = (
    "SpecialSequence",
    "InitVariablesNode",
    "Thread",
    "Event",
    "SubProgram",
)  # written beside the main program
_AROUND: Final = ("MainProgram", "Folder", "Move", "Loop", "If")
_PARTS: Final = ("Case", "Until")  # belong to the node around them


class StartingNode:
    """The node at which a program begins. path: the nodes around it and itself, by the identity of their elements."""

    def __init__(self, tree: ProgramTree, number: int) -> None:
        """Raises TreeError for a node at which no program can begin, with the reason."""
        lines = tree.lines
        if not 0 < number <= len(lines):
            raise TreeError(f"{tree.name} has no node {number}: its nodes are 1 to {len(lines)}")
        line = lines[number - 1]
        self.element = line.element
        around = _around(lines, line)
        self.path = frozenset(id(each.element) for each in (*around, line))
        if (reason := _reason(line, around)) is not None:
            raise TreeError(f"the program cannot be played from node {number}: {reason}")

    def first(self, nodes: Sequence[Element]) -> int | None:
        """Which of these siblings the program begins with, or within; None when it begins elsewhere."""
        for index, node in enumerate(nodes):
            if id(node.resolved()) in self.path:
                while index and node.tag == "If" and node.get("type") != "If":  # written with its If
                    index -= 1
                    node = nodes[index]
                return index
        return None

    @staticmethod
    def skipped(nodes: Sequence[Element]) -> list[Element]:
        """Of nodes before that, those which are part of the main program."""
        return [node for node in nodes if node.tag not in _ELSEWHERE]

    def condition(self, part: Element, chain: Sequence[Element], expression: str) -> str:
        """Expression of a branch or loop, so that the way leads to the node. chain: all branches beside it."""
        if self._leads_on(part):
            return f"{SKIPPING} or ({expression})"
        if any(map(self._leads_on, chain)):
            return f"not {SKIPPING} and ({expression})"
        return expression

    def _leads_on(self, part: Element) -> bool:
        """Whether the node lies in this one."""
        part = part.resolved()
        return id(part) in self.path and part is not self.element


def _around(lines: list[TreeLine], line: TreeLine) -> list[TreeLine]:
    """The nodes a node lies in, the innermost first."""
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
        return "it is a part of the node before or around it; play from that one"
    top = (around[-1] if around else line).element.tag
    if top != "MainProgram" or element.tag in _ELSEWHERE:
        return "it is not part of the robot program, which threads, events and subprograms run beside"
    for each in around:
        if each.element.tag not in _AROUND or each.element.get("checkContinuously") == "true":
            kind = (
                "whose expression is checked continuously" if each.element.tag in _AROUND else "which begins as a whole"
            )
            return f"it lies in node {each.number}, {each.element.tag}, {kind}; play from that one"
    return None
