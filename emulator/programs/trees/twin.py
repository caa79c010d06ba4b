"""The code of URCap nodes, out of the script that PolyScope saved beside a program.

PolyScope puts it between ``# begin: URCap Program Node`` and ``# end: URCap Program Node``, with
the URCap's name in the next comment; blocks lie in each other when nodes do.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

__all__ = ["TwinBlock", "UrcapCode", "urcap_blocks"]

_MARK: Final = ": URCap "
_HEAD: Final = 3  # lines of a block that may describe it
_BEGIN: Final = re.compile(r"\s*# begin: URCap (Program|Installation) Node\s*$")
_END: Final = re.compile(r"\s*# end: URCap (Program|Installation) Node\s*$")
_SOURCE: Final = re.compile(r"\s*#\s*Source: (.*)$")
_DEFINES: Final = re.compile(r"\s*(?:(?:def|thread)\s+(\w+)\s*\(|(?:global\s+)?(\w+)\s*=[^=])")
_WORD: Final = re.compile(r"\w+")
_TYPE: Final = re.compile(r"\s*#\s*Type: (.*)$")


@dataclass(slots=True)
class TwinBlock:
    """Code of one node. source: URCap's name, version and developer; type: name of the node type; empty
    for an installation node. ``inner``: how many blocks lie in it."""

    kind: str
    source: str
    type: str
    lines: list[str]
    inner: int = 0


class UrcapCode:
    """The blocks of a script: of installation nodes, and of program nodes in their order."""

    def __init__(self, blocks: list[TwinBlock]) -> None:
        self.installation = [block for block in blocks if block.kind == "Installation"]
        self._program = [block for block in blocks if block.kind == "Program"]
        self._taken: set[int] = set()

    def take(self, urcap: str, node_type: str) -> list[str] | None:
        """Code of the next node of a URCap, None when there is none left. Those in it are taken along."""
        for index, block in enumerate(self._program):
            if index not in self._taken and block.type == node_type and block.source.startswith(urcap):
                self._taken.update(range(index, index + 1 + block.inner))
                return block.lines
        return None

    def used_by(self, program: str) -> list[str]:
        """Code of the installation nodes, if a program uses a name of it.

        PolyScope writes it into every program; here a URCap that the program does not need would
        only fail for want of its server.
        """
        lines = [line for block in self.installation for line in block.lines]
        names = {match[1] or match[2] for line in lines if (match := _DEFINES.match(line))}
        return lines if names & set(_WORD.findall(program)) else []


def urcap_blocks(script: str) -> list[TwinBlock]:
    """The URCap blocks of a script."""
    return list(_blocks(script.splitlines())) if _MARK in script else []


def _blocks(lines: list[str]) -> Iterator[TwinBlock]:
    found: list[TwinBlock] = []
    open_blocks: list[TwinBlock] = []
    for line in lines:
        marked = _MARK in line
        if marked and (begin := _BEGIN.match(line)):
            block = TwinBlock(begin[1], "", "", [])
            for outer in open_blocks:
                outer.inner += 1
            open_blocks.append(block)
            found.append(block)
        elif open_blocks:
            _describe(open_blocks[-1], line)
        for block in open_blocks:
            block.lines.append(line)
        if open_blocks and marked and _END.match(line):
            open_blocks.pop()
    yield from found


def _describe(block: TwinBlock, line: str) -> None:
    if len(block.lines) > _HEAD:
        return
    if not block.source and (source := _SOURCE.match(line)):
        block.source = source[1].strip()
    elif not block.type and (kind := _TYPE.match(line)):
        block.type = kind[1].strip()
