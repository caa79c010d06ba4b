"""Reading the XML that PolyScope saves, from any bytes, a bounded piece at a time.

PolyScope writes its files with XStream: an object that occurs twice is written once, and
the second time as a relative path to the first (``reference="../../Move[2]/feature"``).
"""

import re
import zlib
from collections.abc import Iterator
from typing import Any, Final
from xml.parsers import expat

from urscript.work import Steps, run_to_end

_GZIP: Final = b"\x1f\x8b"
_PIECE: Final = 4096  # bytes of XML read in one step: well under a millisecond
_PIECE_WORK: Final = 200  # guess [units of `urscript.work`]
_MAX_BYTES: Final = 16 << 20  # of XML; the largest of 643 public programs has 3.3 MB
_MAX_ELEMENTS: Final = 1_000_000
_MAX_DEPTH: Final = 200
_MAX_REFERENCES: Final = 20  # references that lead to references
_STEP: Final = re.compile(r"([^\[\]]+)(?:\[([0-9]{1,9})\])?")


class DocumentError(ValueError):
    """The bytes are not a file as PolyScope saves it."""


class Element:
    """One XML element; what it refers to is looked up when asked for."""

    __slots__ = ("attributes", "children", "parent", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], parent: "Element | None") -> None:
        self.tag = tag
        self.attributes = attributes
        self.parent = parent
        self.children: list[Element] = []
        self.text = ""

    def __iter__(self) -> Iterator["Element"]:
        return iter(self.children)

    def get(self, name: str, default: str = "") -> str:
        """An attribute of this element, or of the one it refers to."""
        return self.resolved().attributes.get(name, default)

    def child(self, *tags: str) -> "Element | None":
        """The first child with one of these tags, of the element referred to, resolved."""
        for element in self.resolved().children:
            if element.tag in tags:
                return element.resolved()
        return None

    def walk(self) -> Iterator["Element"]:
        """This element and all below it, in order."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))

    def resolved(self) -> "Element":
        """The element itself, or the one that its reference leads to. Raises DocumentError if that is nowhere."""
        element = self
        for _ in range(_MAX_REFERENCES):
            path = element.attributes.get("reference")
            if path is None:
                return element
            element = element._follow(path)
        raise DocumentError(f"<{self.tag}> refers to itself")

    def _follow(self, path: str) -> "Element":
        element: Element | None = self
        for step in path.split("/"):
            assert element is not None
            element = element.parent if step == ".." else element._nth(step)
            if element is None:
                raise DocumentError(f"<{self.tag}> refers to {path}, where nothing is")
        assert element is not None
        return element

    def _nth(self, step: str) -> "Element | None":
        match = _STEP.fullmatch(step)
        if match is None:
            return None
        same = [child for child in self.children if child.tag == match[1]]
        index = int(match[2] or 1) - 1
        return same[index] if 0 <= index < len(same) else None


def read_document(data: bytes) -> Element:
    """The root of a file, compressed or not. Raises DocumentError."""
    return run_to_end(read_steps(data))


def read_steps(data: bytes) -> Steps[Element]:
    """`read_document` in pieces that each take well under a millisecond."""
    builder = _Builder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.characters
    parser.StartDoctypeDeclHandler = _refuse_doctype
    size, enough, pending = 0, _PIECE, bytearray()
    try:
        for piece in _pieces(data):
            size += len(piece)
            if size > _MAX_BYTES:
                raise DocumentError(f"more than {_MAX_BYTES >> 20} MiB of XML")
            pending += piece
            if len(pending) >= enough:
                seen = builder.events
                parser.Parse(bytes(pending), False)
                pending.clear()
                # within a long attribute expat begins anew with every piece
                enough = _PIECE if builder.events > seen else 2 * enough
            yield _PIECE_WORK
        parser.Parse(bytes(pending), True)
    except expat.ExpatError as error:
        raise DocumentError(f"not XML: {error}") from error
    except (zlib.error, ValueError) as error:
        raise DocumentError(str(error)) from error
    assert builder.root is not None
    return builder.root


def _pieces(data: bytes) -> Iterator[bytes]:
    if not data.startswith(_GZIP):
        for start in range(0, len(data), _PIECE):
            yield data[start : start + _PIECE]
        return
    unpacking = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
    rest = data
    while rest and not unpacking.eof:
        piece = unpacking.decompress(rest, _PIECE)
        rest = unpacking.unconsumed_tail
        if not piece and not unpacking.eof and not rest:
            break
        yield piece
    if not unpacking.eof:
        raise DocumentError("the compressed file is cut off")


def unpacked(data: bytes) -> bytes:
    """The content of a file, compressed or not. Raises DocumentError."""
    content = bytearray()
    try:
        for piece in _pieces(data):
            content += piece
            if len(content) > _MAX_BYTES:
                raise DocumentError(f"more than {_MAX_BYTES >> 20} MiB")
    except zlib.error as error:
        raise DocumentError(str(error)) from error
    return bytes(content)


def _refuse_doctype(*_: Any) -> None:
    raise DocumentError("a document type, which PolyScope never writes and which may define entities")


class _Builder:
    """Puts the elements together."""

    def __init__(self) -> None:
        self.root: Element | None = None
        self.events = 0
        self._current: Element | None = None
        self._count = 0
        self._depth = 0
        self._text: list[str] = []

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.events += 1
        self._count += 1
        self._depth += 1
        if self._count > _MAX_ELEMENTS:
            raise DocumentError(f"more than {_MAX_ELEMENTS} elements")
        if self._depth > _MAX_DEPTH:
            raise DocumentError(f"elements more than {_MAX_DEPTH} deep")
        self._put_text()
        element = Element(tag, attributes, self._current)
        if self._current is None:
            self.root = element
        else:
            self._current.children.append(element)
        self._current = element

    def end(self, _: str) -> None:
        assert self._current is not None
        self.events += 1
        self._put_text()
        self._current = self._current.parent
        self._depth -= 1

    def characters(self, text: str) -> None:
        self.events += 1
        self._text.append(text)

    def _put_text(self) -> None:
        if self._current is not None and self._text:
            self._current.text += "".join(self._text)
        self._text.clear()
