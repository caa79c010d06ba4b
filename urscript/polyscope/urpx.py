"""Programs of PolyScope X (``.urpx``): JSON with the application, the nodes, and the URScript of both.

The application is what PolyScope 5 calls the installation; its URScript precedes that of the program. Nodes are
converted to the equivalent nodes of PolyScope 5 (`urscript.polyscope.nodes`), so there is only one translation of each
to URScript. The parameters of nodes are known only from public files, of which there are few. For a program with other
nodes, the URScript in the file is used if it was saved with these nodes.

Format: ``.urpx`` files of the vendor's C++ and ROS 2 repositories (PolyScope 10.12), and a public converter.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from urproto.text import from_bytes, lines
from urscript.polyscope.document import Element, make
from urscript.polyscope.program import OutlineNode
from urscript.polyscope.saved_script import SavedScript
from urscript.polyscope.tree import ProgramTree, TreeError, tag_of
from urscript.work import Steps

SUFFIX: Final = ".urpx"
_LARGEST: Final = 1 << 20  # bytes: JSON is read in one go; public programs have some 10 kB
_MAX_NODES: Final = 5000  # converted in one go (guess)
URPX_BYTES_PER_WORK: Final = 10
"""Bytes of a file that are read with one unit of `urscript.work`."""
_MAX_DEPTH: Final = 60  # nesting of nodes, as in older programs
_NIL: Final = "00000000-0000-0000-0000-000000000000"
_FINAL: Final = "FINAL"
_FRAME: Final = ("ur-modules", "ur-functions", "ur-before-start", "ur-configuration", "ur-status", "ur-code")
_ROOT: Final = "ur-program"
_SILENT: Final = ("ur-configuration", "ur-status")  # write no URScript


class UrpxError(ValueError):
    """The bytes are not a program of PolyScope X, or it cannot be run; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class UrpxInformation:
    """The entry of a program in a list of programs. Dates are milliseconds since 1970, None for never."""

    name: str
    description: str
    created_ms: int
    modified_ms: int | None
    saved_ms: int | None
    state: str

    def as_object(self) -> dict[str, Any]:
        """The JSON object as in files and the Robot API."""
        return {
            "name": self.name,
            "description": self.description,
            "createdDate": self.created_ms,
            "lastSavedDate": self.saved_ms,
            "lastModifiedDate": self.modified_ms,
            "programState": self.state,
        }


@dataclass(frozen=True, slots=True)
class Node:
    """A node. label: as shown on the pendant. number: of its label in the URScript of the file, 0 without one."""

    type: str
    parameters: Mapping[str, Any]
    children: "tuple[Node, ...]"
    label: str
    guid: str
    number: int
    depth: int

    def walk(self) -> Iterator["Node"]:
        """This node and all nodes below it, in order."""
        yield self
        for child in self.children:
            yield from child.walk()


@dataclass(frozen=True, slots=True)
class Urpx:
    """A program. application, script: the saved URScript of the application and of the program.

    numbered: the number of nodes with labels in the program's URScript.
    """

    information: UrpxInformation
    root: Node
    application: str
    script: str
    numbered: int

    @property
    def name(self) -> str:
        """Its name on the pendant and in the Robot API."""
        return self.information.name

    def tree(self) -> ProgramTree:
        """The program as a tree of PolyScope 5. Raises UrpxError for nodes that cannot be translated."""
        children = [element for part in self.root.children for element in _elements(part)]
        root = make("URProgram", make("children", *children))
        try:
            return ProgramTree(root, self.name, _Application(self.application))
        except TreeError as error:
            raise UrpxError(f"{self.name}: {error}") from error

    @property
    def changed_since_saved(self) -> str:
        """A difference between the URScript in the file and the nodes, as text; empty when they match."""
        if not self.script.strip():
            return "the file has no URScript"
        running = [node for node in self.root.walk() if node.type not in _SILENT]
        if missing := [node for node in running if not node.number]:
            return f"the URScript in the file lacks the node {missing[0].label or missing[0].type}"
        if self.numbered > len(running):
            return f"{len(running)} nodes write URScript, but the URScript in the file has {self.numbered}"
        return ""

    def saved_program(self) -> str:
        """The URScript saved by PolyScope X, as one program."""
        body = "\n".join(f"  {line}" for part in (self.application, self.script) for line in lines(part))
        return f"def program():\n{body}\nend\n"

    def outline(self) -> list[OutlineNode]:
        """The nodes as shown on the pendant, numbered as in the file's URScript."""
        return [OutlineNode(node.number, node.depth, node.label or node.type) for node in self.root.walk()]


class _Application(SavedScript):
    """The application's URScript, in place of the code that URCaps write for an installation; all of it is used."""

    def __init__(self, script: str) -> None:
        super().__init__([], {})
        self._script = script

    def used_by(self, program: Sequence[str]) -> Steps[list[str]]:
        yield from ()
        return [f"  {line}" for line in lines(self._script)]


# reading


def read_urpx(data: bytes) -> Urpx:
    """Read a program. Raises UrpxError."""
    program, application = urpx_parts(data)
    content = _object(program.get("programContent"), "program.programContent")
    saved = _object(program.get("urscript") or {}, "program.urscript")
    ids = saved.get("nodeIDList") or []
    if not isinstance(ids, list):
        raise UrpxError("program.urscript.nodeIDList is not a list")
    numbers = {guid: number for number, guid in enumerate(ids) if isinstance(guid, str) and guid != _NIL}
    installed = _object(application.get("urscript") or {}, "application.urscript")
    root = _node(content, numbers, iter(range(_MAX_NODES)), 0)
    if root.type != _ROOT:
        raise UrpxError(f"the program begins with {root.type!r}, not with {_ROOT}")
    for part in root.children:
        if part.type not in _FRAME:
            raise UrpxError(f"{part.type!r} is at the top level of the program, where only {', '.join(_FRAME)} can be")
    return Urpx(
        _information(program),
        root,
        _text(installed, "script", "application.urscript"),
        _text(saved, "script", "program.urscript"),
        len(numbers),
    )


def read_information(data: bytes) -> UrpxInformation:
    """Read only the entry for a list of programs. Raises UrpxError."""
    return _information(urpx_parts(data)[0])


def urpx_parts(data: bytes) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """The program and the application of a file, as JSON. Raises UrpxError."""
    if len(data) > _LARGEST:
        raise UrpxError(f"it has {len(data):,} bytes, and a program may have {_LARGEST:,}")
    try:
        document = json.loads(from_bytes(data).removeprefix("\ufeff"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise UrpxError(f"not JSON: {error}") from error
    document = _object(document, "the file")
    return _object(document.get("program"), "program"), _object(document.get("application") or {}, "application")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _information(program: Mapping[str, Any]) -> UrpxInformation:
    where = "program.programInformation"
    found = _object(program.get("programInformation"), where)
    name = _text(found, "name", where)
    if not name.strip():
        raise UrpxError(f"{where}.name is empty")
    return UrpxInformation(
        name,
        _text(found, "description", where),
        _date(found, "createdDate") or 0,
        _date(found, "lastModifiedDate"),
        _date(found, "lastSavedDate"),
        _text(found, "programState", where) or _FINAL,
    )


def _date(found: Mapping[str, Any], key: str) -> int | None:
    value = found.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 63:
        raise UrpxError(f"program.programInformation.{key} is not a date in milliseconds")
    return value


def _object(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise UrpxError(f"{where} is not an object")
    return value


def _text(found: Mapping[str, Any], key: str, where: str) -> str:
    value = found.get(key)
    if value is not None and not isinstance(value, str):
        raise UrpxError(f"{where}.{key} is not text")
    return value or ""


def _node(value: Any, numbers: Mapping[str, int], room: Iterator[int], depth: int) -> Node:
    """The node and those below it. room: has an element for each node that the program may still have."""
    if next(room, None) is None:
        raise UrpxError(f"more than {_MAX_NODES} nodes")
    if depth > _MAX_DEPTH:
        raise UrpxError(f"nodes are nested more than {_MAX_DEPTH} deep")
    found = _object(value, "a node")
    contributed = _object(found.get("contributedNode"), "contributedNode")
    kind = _text(contributed, "type", "contributedNode")
    children = found.get("children") or []
    if not kind or not isinstance(children, list):
        raise UrpxError("a node has no type, or its children are not a list")
    guid = _text(found, "guid", kind)
    return Node(
        kind,
        _object(contributed.get("parameters") or {}, f"parameters of {kind}"),
        tuple(_node(child, numbers, room, depth + 1) for child in children),
        _label(kind, found.get("programLabel")),
        guid,
        numbers.get(guid, 0),
        depth,
    )


def _label(kind: str, label: Any) -> str:
    """The label on the pendant: the kind of node, and the label in the file."""
    words = kind.removeprefix("ur-").replace("-", " ").capitalize()
    parts = label if isinstance(label, list) else [{"value": label}]
    said = [str(part["value"]) for part in parts if isinstance(part, dict) and part.get("value")]
    return " ".join([words, *said])


# translating

_Translation = Callable[[Node], list[Element]]
NODE_TYPES: Final[dict[str, _Translation]] = {}
"""Converters of the supported node types, by their names in files."""


def _node_type(name: str) -> Callable[[_Translation], _Translation]:
    def register(translation: _Translation) -> _Translation:
        NODE_TYPES[name] = translation
        return translation

    return register


def _elements(node: Node) -> list[Element]:
    translation = NODE_TYPES.get(node.type)
    if translation is None:
        raise UrpxError(f"unknown node {node.type}")
    return translation(node)


def _children(node: Node) -> Element:
    return make("children", *(element for child in node.children for element in _elements(child)))


def counterpart(element: Element) -> str:
    """The node of PolyScope X for a node of an older program; empty for one without a counterpart that is known."""
    sleeps = tag_of(element) == "Wait" and element.get("type") == "Sleep"
    starts = tag_of(element) == "SpecialSequence" and element.get("type") == "BeforeStart"
    names = {"MainProgram": "ur-code", "Wait": "ur-wait" * sleeps, "SpecialSequence": "ur-before-start" * starts}
    return names.get(tag_of(element), "")


@_node_type("ur-modules")
@_node_type("ur-functions")
@_node_type("ur-configuration")
@_node_type("ur-status")
def _without_code(node: Node) -> list[Element]:
    """Parts that every program has and that are usually empty."""
    if node.children:
        raise UrpxError(f"unknown node {node.children[0].type} in {node.type}")
    return []


@_node_type("ur-before-start")
def _before_start(node: Node) -> list[Element]:
    """Nodes that run once before the program starts."""
    return [make("SpecialSequence", _children(node), type="BeforeStart")] if node.children else []


@_node_type("ur-code")
def _code(node: Node) -> list[Element]:
    """The robot program."""
    loops = node.parameters.get("loopForever") is True
    return [make("MainProgram", _children(node), runOnlyOnce="false" if loops else "true")]


@_node_type("ur-wait")
def _wait(node: Node) -> list[Element]:
    """A wait for a time. The parameters of other waits are not public."""
    if node.parameters.get("type") != "time":
        raise UrpxError(f"node ur-wait for {node.parameters.get('type')!r} is not supported")
    time = _object(node.parameters.get("time"), "time of ur-wait")
    entity = _object(time.get("entity"), "time.entity of ur-wait")
    value, unit = entity.get("value"), entity.get("unit")
    if (
        time.get("selectedType") != "VALUE"
        or unit != "s"
        or isinstance(value, bool)
        or not isinstance(value, int | float)
    ):
        raise UrpxError("node ur-wait waits for something other than a number of seconds, which is not supported")
    return [make("Wait", make("waitTime", text=repr(value)), type="Sleep")]
