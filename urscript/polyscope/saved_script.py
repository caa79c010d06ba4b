"""The script that PolyScope saved with a program, which is the source of the code of URCap nodes.

PolyScope writes a node's code between ``# begin: URCap Program Node`` and ``# end: URCap Program Node``: first comments
with the URCap and the type of the node, then the node's label, whose number is its line in the program tree. Nodes
inside that node have nested blocks. Labels such as ``$ 7 "text"`` mark all other nodes, too, so they show whether the
program has changed since the script was saved.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from urproto.text import lines
from urscript.work import Steps

_MARK: Final = ": URCap "
_HEAD: Final = 3  # lines at the start of a block that may describe it
_BEGIN: Final = re.compile(r"\s*# begin: URCap (Program|Installation) Node\s*$")
_END: Final = re.compile(r"(?:.*\s)?# end: URCap (Program|Installation) Node\s*$")
_SOURCE: Final = re.compile(r"\s*#\s*Source: (.*)$")
_TYPE: Final = re.compile(r"\s*#\s*Type: (.*)$")
_LABEL: Final = re.compile(r'\s*\$ ([0-9]{1,9}) "(.*?)"(?: "(?:breakAfter|noBreak)")?\s*$')
_DEFINES: Final = re.compile(r"\s*(?:(?:def|thread)\s+(\w+)\s*\(|(?:global\s+)?(\w+)\s*=[^=])")
_WORD: Final = re.compile(r"\w+")
_LINES_AT_ONCE: Final = 200  # well under a millisecond
_PIECE_WORK: Final = 300  # [units of `urscript.work`]; measured: a microsecond for a line


@dataclass(slots=True)
class SavedBlock:
    """The code of a node. source: name, version and developer of the URCap. type: name of the node type.

    number: its line in the program tree; 0 for an installation node, and for text that only resembles a block.
    """

    kind: str
    source: str = ""
    type: str = ""
    number: int = 0
    lines: list[str] = field(default_factory=list)
    nests: bool = False  # a nested block has begun


@dataclass(slots=True)
class SavedScript:
    """The parts of the script that belong to the program tree. labels: the texts of the nodes by their line."""

    blocks: list[SavedBlock]
    labels: dict[int, str]

    def code(self, number: int, urcap: str, node_type: str) -> list[str] | None:
        """Code of the URCap's node at a line of the program tree; None if the script does not contain it."""
        found = {
            tuple(block.lines): block
            for block in self.blocks
            if block.number == number and block.type == node_type and block.source.startswith(urcap)
        }
        return next(iter(found.values())).lines if len(found) == 1 else None

    def used_by(self, program: Sequence[str]) -> Steps[list[str]]:
        """The code of the installation nodes, if a program (its lines) uses a name defined in it.

        PolyScope writes it into every program. Here, a URCap that the program does not need would only fail because its
        server is missing.
        """
        lines = [line for block in self.blocks if block.kind == "Installation" for line in block.lines]
        names = {match[1] or match[2] for line in lines if (match := _DEFINES.match(line))}
        for index, line in enumerate(program if names else ()):
            if index % _LINES_AT_ONCE == 0:
                yield _PIECE_WORK
            if not names.isdisjoint(_WORD.findall(line)):
                return lines
        return []


NO_SAVED_SCRIPT: Final = SavedScript([], {})


def read_saved_script(script: str) -> Steps[SavedScript]:
    """Read the blocks and labels of a script, in pieces for a control loop."""
    saved = SavedScript([], {})
    open_blocks: list[SavedBlock] = []
    for index, line in enumerate(lines(script)):
        if index % _LINES_AT_ONCE == 0:
            yield _PIECE_WORK
        marked = _MARK in line
        if marked and (begin := _BEGIN.match(line)):
            for outer in open_blocks:
                outer.nests = True
            open_blocks.append(SavedBlock(begin[1]))
            saved.blocks.append(open_blocks[-1])
        elif "$" in line and (label := _LABEL.match(line)):
            saved.labels.setdefault(int(label[1]), label[2])
            if open_blocks and not open_blocks[-1].nests and open_blocks[-1].kind == "Program":
                open_blocks[-1].number = open_blocks[-1].number or int(label[1])
        elif open_blocks:
            _describe(open_blocks[-1], line)
        for block in open_blocks:
            block.lines.append(line)
        if open_blocks and marked and _END.match(line):
            open_blocks.pop()
    return saved


def _describe(block: SavedBlock, line: str) -> None:
    if len(block.lines) > _HEAD:
        return
    if not block.source and (source := _SOURCE.match(line)):
        block.source = source[1].strip()
    elif not block.type and (kind := _TYPE.match(line)):
        block.type = kind[1].strip()
