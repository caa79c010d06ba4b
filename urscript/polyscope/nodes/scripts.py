"""Script, Subprogram and Call nodes."""

from typing import Final

from urproto.text import lines
from urscript.polyscope.document import DocumentError, Element, make, sharing
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import Field, attribute_boolean, expression_field, node_name, of_type, parts_choice
from urscript.polyscope.nodes.waits import child_text
from urscript.polyscope.numbers import identifier
from urscript.polyscope.registry import Kind, empty_children, node, translate_children
from urscript.polyscope.surroundings import FieldError, Surroundings
from urscript.polyscope.tree import tag_of
from urscript.polyscope.writer import Writer, expression_label, expression_text
from urscript.work import Steps

SUBPROGRAM: Final = Kind(
    "subprogram",
    "SubProgram",
    "Advanced",
    lambda element: element.get("name"),
    new=lambda program: make(
        "SubProgram",
        empty_children(),
        name=program.unused("SubProgram", program.names("SubProgram")),
        keepHidden="false",
        keepSynchronizedWithDisk="false",
    ),
    stands="program",
    contains="nodes",
    fields=(
        node_name(what="subprogram"),
        attribute_boolean("hidden", "Hide subprogram tree", "keepHidden"),
        attribute_boolean("synchronized", "Keep in sync with the file", "keepSynchronizedWithDisk"),
    ),
)


def _choose_file(element: Element, value: str, program: Surroundings) -> None:
    """Set the script file; like PolyScope, this also copies its text into the program."""
    program.set_text(element, "file", value)
    text = program.folder.text(value)
    program.set_text(element, "cachedContents", text if text is not None else "")


def _script_shown(element: Element) -> str:
    if element.get("type") != "File":
        return expression_shown(element.child("expression")) or "Script"
    name = child_text(element, "file").rpartition("/")[2]
    return f"Script: {name}" if name else "Script"


def _script_lacks(element: Element) -> str:
    if element.get("type") == "File":
        return "" if child_text(element, "file") else "the script file"
    return "the line of script" if lacks_expression(element) else ""


SCRIPT: Final = Kind(
    "script",
    "Script",
    "Advanced",
    _script_shown,
    new=lambda _: make("Script", make("expression"), type="Line"),
    undefined=_script_lacks,
    fields=(
        parts_choice("type", "Script", "type", {"Line": "Line", "File": "File"}, {"Line": [make("expression")]}),
        expression_field("line", "Line", shown=of_type("Line")),
        Field(
            "file",
            "File",
            "file",
            lambda element, _: child_text(element, "file") or None,
            _choose_file,
            shown=of_type("File"),
            help="a path in the programs folder",
        ),
    ),
)


@node("Script", SCRIPT, children="cachedContents file expression")
def script(writer: Writer, element: Element) -> None:
    """A line of URScript, or a script file, read from the programs folder or else from the copy in the program."""
    if element.get("type") != "File":
        text = expression_text(writer, element.child("expression"))
        writer.label(element, expression_label(writer, element.child("expression")))
        if text:
            writer.line(text)
        return
    name = child_text(element, "file")
    writer.label(element, f"Script: {name.rpartition('/')[2]}")
    text = _file_text(writer, element, name)
    for line in lines(text):
        writer.line(line)


def _file_text(writer: Writer, element: Element, name: str) -> str:
    """The text of the file, unless PolyScope has overwritten it when it saved a program of the same name."""
    copy = element.child("cachedContents")
    folder = writer.tree.folder
    overwritten = copy is not None and folder.find(f"{name.removesuffix('.script')}.urp") is not None
    found = folder.text(name) if name and not overwritten else None
    if found is not None:
        return found
    if copy is None:
        raise DocumentError(f"the script file {name} is not in the programs folder")
    return copy.text


@node("SubProgram", SUBPROGRAM)
def subprogram(writer: Writer, element: Element) -> Steps[None]:
    """A part of the program that Call nodes run; it becomes a function of the script."""
    name = identifier(element.get("name"))
    if not writer.once(f"subprogram {name}"):
        return  # it was called before its place in the tree
    body = yield from _body(writer, element)
    with writer.into("subprograms"), writer.block(f"def {name}():"):
        writer.label(element, element.get("name"), "noBreak")
        yield from translate_children(writer, body)


def _subprograms(program: Surroundings) -> dict[str, Element]:
    """The subprograms of the program by name."""
    children = program.root.child("children")
    return {
        place.get("name"): place.resolved()
        for place in children or ()
        if tag_of(place) == "SubProgram" and place.get("name")
    }


def _choose_subprogram(element: Element, value: str | None, program: Surroundings) -> None:
    found = _subprograms(program)
    if value is not None and value not in found:
        raise FieldError(f"there is no subprogram called {value!r} in the program")
    program.set_child(element, "subprogram", sharing("subprogram", found[value]) if value else None)


def _called(element: Element, _: Surroundings | None = None) -> str | None:
    subprogram = element.child("subprogram")
    return subprogram.get("name") if subprogram else None


CALL: Final = Kind(
    "call",
    "Call",
    "Advanced",
    lambda element: f"Call {_called(element) or ''}",
    new=lambda _: make("CallSubProgram"),
    undefined=lambda element: "" if _called(element) else "the subprogram to call",
    fields=(
        Field(
            "subprogram",
            "Subprogram",
            "subprogram",
            _called,
            _choose_subprogram,
            options=lambda program: list(_subprograms(program)),
            optional=True,
        ),
    ),
)


@node("CallSubProgram", CALL)
def call(writer: Writer, element: Element) -> Steps[None]:
    """Call a subprogram, which may be a separate program file."""
    called = element.child("subprogram")
    if called is None:
        raise DocumentError("a Call does not name a subprogram")
    writer.label(element, f"Call {called.get('name')}")
    writer.line(f"{identifier(called.get('name'))}()")
    yield from subprogram(writer, called)


def _body(writer: Writer, element: Element) -> Steps[Element]:
    """The element with the subprogram's nodes: here or in its own file.

    The file is used if the subprogram is kept in sync with it, or has no copy here.
    """
    own = element.child("children")
    name = child_text(element, "programFile")
    if own is not None and element.get("keepSynchronizedWithDisk") != "true":
        return element
    tree = (yield from writer.tree.called(name)) if name else None
    if tree is None:
        if own is None:
            raise DocumentError(f"the subprogram {name or element.get('name')} is not in the programs folder")
        return element
    main = next((line.element for line in tree.lines if line.element.tag == "MainProgram"), None)
    if main is None:
        raise DocumentError(f"{name} has no robot program")
    writer.adopt(tree)
    return main
