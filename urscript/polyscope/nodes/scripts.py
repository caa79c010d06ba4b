"""URScript written by the user, and subprograms."""

from urproto.text import lines
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import identifier
from urscript.polyscope.nodes.waits import child_text
from urscript.polyscope.registry import node, translate_children
from urscript.polyscope.writer import Writer, expression_label, expression_text
from urscript.work import Steps


@node("Script")
def script(writer: Writer, element: Element) -> None:
    """A line of URScript, or a file of it, taken from the folder and else from the copy in the program."""
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
    """The file's text, unless PolyScope has written that program over it when it saved one of that name."""
    copy = element.child("cachedContents")
    folder = writer.tree.folder
    overwritten = copy is not None and folder.find(f"{name.removesuffix('.script')}.urp") is not None
    found = folder.text(name) if name and not overwritten else None
    if found is not None:
        return found
    if copy is None:
        raise DocumentError(f"the script file {name} is not in the programs folder")
    return copy.text


@node("SubProgram")
def subprogram(writer: Writer, element: Element) -> Steps[None]:
    """A part of the program that others call; a function of the script."""
    yield from _write_subprogram(writer, element)


def _write_subprogram(writer: Writer, element: Element) -> Steps[None]:
    """Once, also when it is called before the tree comes to it."""
    name = _declared(writer, element)
    if not writer.once(f"subprogram {name}"):
        return
    body = yield from _body(writer, element)
    with writer.into("subprograms"), writer.block(f"def {name}():"):
        writer.label(element, element.get("name"), "noBreak")
        yield from translate_children(writer, body)


@node("CallSubProgram")
def call(writer: Writer, element: Element) -> Steps[None]:
    """Call a subprogram, which may be a program file of its own."""
    called = element.child("subprogram")
    if called is None:
        raise DocumentError("a Call names no subprogram")
    writer.label(element, f"Call {called.get('name')}")
    writer.line(f"{_declared(writer, called)}()")
    yield from _write_subprogram(writer, called)


def _declared(writer: Writer, element: Element) -> str:
    return identifier(element.get("name"))


def _body(writer: Writer, element: Element) -> Steps[Element]:
    """Where the subprogram's nodes are: here, or in its own file.

    The file counts if the subprogram is kept in step with it, or has no copy here.
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
