"""PolyScope's XML files: reading arbitrary bytes in bounded pieces, modifying, and writing as PolyScope does.

PolyScope writes its files with XStream: an object that occurs twice is written once, and the second time as a relative
path to the first (``reference="../../Move[2]/feature"``). `link` replaces the paths by the objects themselves, so that
nodes can be moved, copied and deleted; `write_document` computes the paths again.
"""

import gzip
import itertools
import re
import zlib
from collections.abc import Iterator, Sequence
from typing import Any, Final
from xml.parsers import expat

from urscript.work import Steps, run_to_end

_GZIP: Final = b"\x1f\x8b"
_PIECE: Final = 2048  # bytes of XML read in one step: a millisecond even if all of them are tags
_PIECE_WORK: Final = 20  # [units of `urscript.work`], and for each tag in it, and for each kB of an unfinished one:
_TAG_WORK: Final = 4  # measured: 3.5 microseconds for an empty element
_SCAN_WORK: Final = 3  # measured: 2 microseconds
_ATTRIBUTE: Final = re.compile(rb"=\s*[\"']")
_MAX_BYTES: Final = 8 << 20  # of XML; the largest of 643 public programs has 3.3 MB
_MAX_ELEMENTS: Final = 60_000  # guess; freeing a program of so many takes Python 40 ms
_MAX_TAG: Final = 1 << 20  # bytes, with its attributes
_MAX_ATTRIBUTES: Final = 1000  # of a tag
_MAX_DEPTH: Final = 200
_AT_ONCE: Final = 64  # elements that are freed between two yields
_MAX_REFERENCES: Final = 20  # references that lead to references
_REFERENCE: Final = "reference"
_STEP: Final = re.compile(r"([^\[\]]+)(?:\[([0-9]{1,9})\])?")
_OF_PLACE: Final = ("class", "referenceName")  # attributes of the place where an object is, not of the object
_ESCAPES: Final = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&apos;", "\r": "&#xd;"}
_ESCAPED: Final = re.compile("[&<>\"'\r]")
_ESCAPED_IN_ATTRIBUTE: Final = re.compile("[&<>\"'\r\n\t]")
_NOT_IN_XML: Final = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class DocumentError(ValueError):
    """The bytes are not a file as PolyScope saves it."""


class Element:
    """An XML element; its reference is resolved on demand.

    shared: the element with the content, in a linked document. open: when it is empty, it is written with a separate
    end tag, as XStream writes empty text. parent: where it was read, or first inserted.
    """

    __slots__ = ("_by_tag", "attributes", "children", "open", "parent", "shared", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], parent: "Element | None") -> None:
        self.tag = tag
        self.attributes = attributes
        self.parent = parent
        self.children: list[Element] = []
        self.text = ""
        self.open = False
        self.shared: Element | None = None
        self._by_tag = _NO_INDEX

    def __iter__(self) -> Iterator["Element"]:
        return iter(self.children)

    def get(self, name: str, default: str = "") -> str:
        """An attribute of this element, or of the one it refers to."""
        return self.resolved().attributes.get(name, default)

    def child(self, *tags: str) -> "Element | None":
        """The first child with one of these tags; references of the element and the child are resolved."""
        for element in self.resolved().children:
            if element.tag in tags:
                return element.resolved()
        return None

    def named(self, tag: str) -> str:
        """The name of the pin, TCP or feature that a child of this element refers to; empty without one."""
        child = self.child(tag)
        return (child.get("referencedName") or child.get("featureName")) if child is not None else ""

    def walk(self) -> Iterator["Element"]:
        """This element and all elements below it, in document order."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))

    def places(self) -> Iterator["Element"]:
        """This place and all places below it, in order, including those in shared objects; each object once."""
        seen = set[int]()
        waiting = [self]
        while waiting:
            place = waiting.pop()
            yield place
            element = place.resolved()
            if id(element) not in seen:
                seen.add(id(element))
                waiting.extend(reversed(element.children))

    def resolved(self) -> "Element":
        """The element itself, or the target of its reference. Raises DocumentError if that does not exist."""
        if self.shared is None and _REFERENCE not in self.attributes:  # nearly always
            return self
        element = self
        for _ in range(_MAX_REFERENCES):
            if element.shared is not None:
                element = element.shared
                continue
            path = element.attributes.get(_REFERENCE)
            if path is None:
                return element
            element = element._follow(path)
        raise DocumentError(f"<{self.tag}> refers to itself")

    def _follow(self, path: str) -> "Element":
        if path.count("/") > 2 * _MAX_DEPTH:
            raise DocumentError(f"<{self.tag}> refers to {path[:40]}..., which does not exist")
        element: Element | None = self
        for step in path.split("/"):
            assert element is not None
            element = element.parent if step == ".." else element._nth(step)
            if element is None:
                raise DocumentError(f"<{self.tag}> refers to {path}, which does not exist")
        assert element is not None
        return element

    def _nth(self, step: str) -> "Element | None":
        match = _STEP.fullmatch(step)
        if match is None:
            return None
        same = self._children_of(match[1])
        index = int(match[2] or 1) - 1
        return same[index] if 0 <= index < len(same) else None

    def _children_of(self, tag: str) -> "list[Element]":
        """The children with a tag, from an index: many elements may refer to the same ones."""
        count, index = self._by_tag
        if count != len(self.children):
            index = {}
            for child in self.children:
                index.setdefault(child.tag, []).append(child)
            self._by_tag = len(self.children), index
        return index.get(tag, [])


_NO_INDEX: Final[tuple[int, dict[str, list[Element]]]] = 0, {}  # of the first so many children; never changed


def read_document(data: bytes, max_elements: int = _MAX_ELEMENTS) -> Element:
    """The root of a file, compressed or not. Raises DocumentError, also for a file beyond the limits."""
    return run_to_end(read_steps(data, max_elements))


def read_steps(data: bytes, max_elements: int = _MAX_ELEMENTS) -> Steps[Element]:
    """Like `read_document`, in pieces that each take well under a millisecond."""
    parser = expat.ParserCreate()
    builder = _Builder(parser, max_elements)
    try:
        yield from _read(data, parser, builder)
    except DocumentError:
        yield from _take_apart(builder.root)
        raise
    assert builder.root is not None
    return builder.root


def _take_apart(root: Element | None) -> Steps[None]:
    """Free a tree that is not needed: the garbage collector would do it in one go."""
    waiting = [] if root is None else [root]
    for count in itertools.count(1):
        if not waiting:
            return
        element = waiting.pop()
        waiting += element.children
        element.children, element.parent = [], None
        if count % _AT_ONCE == 0:
            yield _AT_ONCE


def _read(data: bytes, parser: expat.XMLParserType, builder: "_Builder") -> Steps[None]:
    """Feed the bytes of a file to the parser.

    Expat reads an unfinished tag from its beginning again whenever it gets more of it. So the pieces of a tag are
    collected until one contains a character that can end it.
    """
    if (defer := getattr(parser, "SetReparseDeferralEnabled", None)) is not None:
        defer(False)  # otherwise the elements after a long tag could wait, and be read in one go
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.characters
    parser.StartDoctypeDeclHandler = _refuse_doctype
    size, pending, in_tag = 0, bytearray(), False
    unfinished, attributes = 0, 0  # bytes and attributes since the last event
    try:
        for piece in _pieces(data):
            size += len(piece)
            unfinished += len(piece)
            attributes += len(_ATTRIBUTE.findall(piece))
            if size > _MAX_BYTES:
                raise DocumentError(f"more than {_MAX_BYTES >> 20} MiB of XML")
            if unfinished > _MAX_TAG:
                raise DocumentError(f"a tag or comment of more than {_MAX_TAG >> 20} MiB")
            if attributes > _MAX_ATTRIBUTES:
                raise DocumentError(f"a tag with more than {_MAX_ATTRIBUTES} attributes")
            pending += piece
            builder.source += piece
            yield _PIECE_WORK + _TAG_WORK * piece.count(b"<") + _SCAN_WORK * (unfinished >> 10)
            opened, closed = piece.rfind(b"<"), piece.rfind(b">")
            in_tag = opened > closed or (in_tag and closed < 0)
            if not in_tag or closed >= 0:
                seen = builder.events
                parser.Parse(bytes(pending), False)
                pending.clear()
                if builder.events > seen:
                    unfinished = attributes = 0
        parser.Parse(bytes(pending), True)
    except expat.ExpatError as error:
        raise DocumentError(f"not XML: {error}") from error
    except (zlib.error, ValueError) as error:
        raise DocumentError(str(error)) from error


def _pieces(data: bytes) -> Iterator[bytes]:
    parts = (data[start : start + _PIECE] for start in range(0, len(data), _PIECE))
    if not data.startswith(_GZIP):
        yield from parts
        return
    unpacking = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
    for part in parts:
        rest = part
        while not unpacking.eof and (piece := unpacking.decompress(rest, _PIECE)):
            rest = unpacking.unconsumed_tail
            yield piece
    if not unpacking.eof:
        raise DocumentError("the compressed file is incomplete")


def unpacked(data: bytes, max_bytes: int = _MAX_BYTES) -> bytes:
    """The content of a file, compressed or not. Raises DocumentError."""
    content = bytearray()
    try:
        for piece in _pieces(data):
            content += piece
            if len(content) > max_bytes:
                raise DocumentError(f"more than {max_bytes >> 20} MiB")
    except zlib.error as error:
        raise DocumentError(str(error)) from error
    return bytes(content)


def _refuse_doctype(*_: Any) -> None:
    raise DocumentError("the file has a document type, which PolyScope never writes and which may define entities")


class _Builder:
    """Builds the tree of elements. source: the bytes read, which tell the two forms of an empty element apart."""

    def __init__(self, parser: expat.XMLParserType, max_elements: int) -> None:
        self._max_elements = max_elements
        self.root: Element | None = None
        self.source = bytearray()
        self._parser = parser
        self.events = 0
        self._current: Element | None = None
        self._count = 0
        self._depth = 0
        self._text: list[str] = []

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.events += 1
        self._count += 1
        self._depth += 1
        if self._count > self._max_elements:
            raise DocumentError(f"more than {self._max_elements} elements")
        if len(attributes) > _MAX_ATTRIBUTES:
            raise DocumentError(f"<{tag[:40]}> has more than {_MAX_ATTRIBUTES} attributes")
        if self._depth > _MAX_DEPTH:
            raise DocumentError(f"elements are nested more than {_MAX_DEPTH} deep")
        if self._text:
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
        if self._text:
            self._put_text()
        if not self._current.children and not self._current.text:
            behind = self._parser.CurrentByteIndex
            self._current.open = self.source[behind - 2 : behind] != b"/>"
        self._current = self._current.parent
        self._depth -= 1

    def characters(self, text: str) -> None:
        self.events += 1
        self._text.append(text)

    def _put_text(self) -> None:
        if self._current is not None:
            self._current.text += "".join(self._text)
        self._text.clear()


# writing


def make(tag: str, *children: Element, text: str = "", **attributes: str) -> Element:
    """Create an element with children, text and attributes. ``class_`` is the attribute ``class``."""
    element = Element(tag, {name.removesuffix("_"): value for name, value in attributes.items()}, None)
    element.text = text
    for child in children:
        child.parent = element
        element.children.append(child)
    return element


def sharing(tag: str, owner: Element, **attributes: str) -> Element:
    """Create a place that shares the object of another element. attributes: of the place, such as ``class_``."""
    element = make(tag, **attributes)
    element.shared = owner.resolved()
    return element


def link(root: Element) -> Element:
    """Replace the paths in a document by the objects they refer to. Raises DocumentError for a path to nothing."""
    places = [element for element in root.walk() if _REFERENCE in element.attributes]
    owners = [place._follow(place.attributes[_REFERENCE]) for place in places]
    for place, owner in zip(places, owners, strict=True):
        place.shared = owner
        del place.attributes[_REFERENCE]
    for place in places:
        place.shared = place.resolved()
    return root


def write_document(root: Element) -> bytes:
    """The XML of a document as PolyScope writes it, byte for byte; `packed` compresses it.

    In document order, the first place of an object contains it completely, and the others contain the path to it.
    Raises DocumentError for text that XML does not allow, and for elements nested too deep to be read again.
    """
    link(root)
    shared = {id(place.shared) for place in root.places() if place.shared is not None}
    places: dict[int, tuple[str, ...]] = {}
    pieces: list[str] = []

    def write(place: Element, path: tuple[str, ...]) -> None:
        element = place.resolved()
        if len(path) > _MAX_DEPTH:
            raise DocumentError(f"elements are nested more than {_MAX_DEPTH} deep")
        attributes = {name: value for name, value in place.attributes.items() if name in _OF_PLACE}
        before = places.get(id(element))
        if before is not None:
            attributes[_REFERENCE] = _relative(path, before)
            pieces.append(f"{'  ' * (len(path) - 1)}<{place.tag}{_attributes_text(attributes)}/>\n")
            return
        if id(element) in shared:
            places[id(element)] = path
        if place is element:
            attributes = element.attributes
        else:
            attributes |= {name: value for name, value in element.attributes.items() if name not in _OF_PLACE}
        head = f"{'  ' * (len(path) - 1)}<{place.tag}{_attributes_text(attributes)}"
        text = _escaped(element.text, _ESCAPED)
        if not element.children:
            pieces.append(f"{head}>{text}</{place.tag}>\n" if text or element.open else f"{head}/>\n")
            return
        pieces.append(f"{head}>{'' if element.text.isspace() else text}\n")
        counts: dict[str, int] = {}
        for child in element.children:
            number = counts[child.tag] = counts.get(child.tag, 0) + 1
            write(child, (*path, child.tag if number == 1 else f"{child.tag}[{number}]"))
        pieces.append(f"{'  ' * (len(path) - 1)}</{place.tag}>\n")

    write(root, (root.tag,))
    return "".join(pieces).removesuffix("\n").encode()


def _relative(here: tuple[str, ...], there: tuple[str, ...]) -> str:
    common = 0
    while common < min(len(here), len(there)) and here[common] == there[common]:
        common += 1
    return "/".join([".."] * (len(here) - common) + list(there[common:]))


def _attributes_text(attributes: dict[str, str]) -> str:
    return "".join(f' {name}="{_escaped(value, _ESCAPED_IN_ATTRIBUTE)}"' for name, value in attributes.items())


def _escaped(text: str, which: re.Pattern[str]) -> str:
    check_text(text)
    return which.sub(lambda match: _ESCAPES.get(match[0]) or f"&#x{ord(match[0]):x};", text)


def check_text(text: str) -> None:
    """Raise DocumentError for text that XML does not allow."""
    if wrong := _NOT_IN_XML.search(text):
        raise DocumentError(f"{text[:60]!r} contains the character {wrong[0]!r}, which is not allowed in XML")


def packed(xml: bytes) -> bytes:
    """Compress a document, as PolyScope does."""
    return gzip.compress(xml, mtime=0)


class Changes:
    """A log of changes to the elements of a linked document, so that they can be undone exactly."""

    def __init__(self) -> None:
        self.steps: list[tuple[Element, str, Any, Any]] = []

    def put(self, element: Element, slot: str, value: Any) -> None:
        """Set a slot of an element: tag, attributes, text, children, open or shared."""
        before = getattr(element, slot)
        if before != value:
            self.steps.append((element, slot, before, value))
            setattr(element, slot, value)

    def undo(self, down_to: int = 0) -> None:
        """Undo and remove all steps beyond this number."""
        while len(self.steps) > down_to:
            element, slot, before, _ = self.steps.pop()
            setattr(element, slot, before)

    def set_attribute(self, element: Element, name: str, value: str | None, order: Sequence[str] = ()) -> None:
        """Set an attribute of the object, or remove it (None). A new attribute is placed according to ``order``."""
        element = element.resolved()
        attributes = dict(element.attributes)
        if value is None:
            attributes.pop(name, None)
        elif name in attributes or name not in order:
            attributes[name] = value
        else:
            behind = order[order.index(name) + 1 :]
            first = next((given for given in attributes if given in behind), None)
            attributes = {}
            for given, old in element.attributes.items():
                if given == first:
                    attributes[name] = value
                attributes[given] = old
            attributes.setdefault(name, value)
        self.put(element, "attributes", attributes)

    def set_child(self, element: Element, tag: str, child: Element | None, order: Sequence[str] = ()) -> None:
        """Replace the child with this tag, remove it (None), or add one at the position given by ``order``."""
        element = element.resolved()
        children = list(element.children)
        at = next((index for index, old in enumerate(children) if old.tag == tag), None)
        if child is not None:
            child.parent = element
        if at is not None:
            children[at : at + 1] = [] if child is None else [child]
        elif child is not None:
            behind = order[order.index(tag) + 1 :] if tag in order else ()
            at = next((index for index, old in enumerate(children) if old.tag in behind), len(children))
            children.insert(at, child)
        self.put(element, "children", children)

    def set_text(self, element: Element, tag: str, text: str | None, order: Sequence[str] = ()) -> None:
        """Set the text of a child, creating the child if necessary, or remove the child (None)."""
        child = element.child(tag)
        if text is None:
            self.set_child(element, tag, None)
        elif child is None:
            self.set_child(element, tag, make(tag, text=text), order)
        else:
            self.put(child, "text", text)
