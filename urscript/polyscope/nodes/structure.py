"""The program itself and what only orders it."""

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import identifier
from urscript.polyscope.nodes.moves import circle_move
from urscript.polyscope.registry import node, translate_children
from urscript.polyscope.writer import Writer, expression_text, variable_name
from urscript.work import Steps


@node("MainProgram")
def main_program(writer: Writer, element: Element) -> Steps[None]:
    """The robot program, for ever unless it runs only once."""
    if element.get("runOnlyOnce") == "true":
        writer.label(element, "Robot Program")
        yield from translate_children(writer, element)
        return
    with writer.block("while (True):"):
        writer.label(element, "Robot Program")
        yield from translate_children(writer, element)


@node("InitVariablesNode")
def init_variables(writer: Writer, element: Element) -> None:
    """First values of variables."""
    with writer.into("variables"):
        for variable in element.child("variables") or ():
            text = expression_text(writer, variable.child("expression", "initializeExpression"))
            if text:
                writer.line(f"global {variable_name(variable)}={text}")


@node("SpecialSequence", status="partial", note="BeforeStart, and the CircleMove of old files")
def special_sequence(writer: Writer, element: Element) -> Steps[None]:
    """What is done once before the program starts."""
    if element.get("type") == "CircleMove":
        circle_move(writer, element)
        return
    if element.get("type") != "BeforeStart":
        raise DocumentError(f"a special sequence {element.get('type')!r}, which is not known")
    with writer.into("before"):
        writer.label(element, element.get("type"))
        yield from translate_children(writer, element)


@node("Thread")
def thread(writer: Writer, element: Element) -> Steps[None]:
    """Runs beside the robot program, for ever unless it runs only once."""
    name = identifier(element.get("name"))
    with writer.into("threads"):
        writer.label(element, element.get("name"))
        with writer.block(f"thread {name}():"):
            if element.get("runOnlyOnce") == "true":
                yield from translate_children(writer, element)
            else:
                with writer.block("while (True):"):
                    yield from translate_children(writer, element)
        writer.line(f"threadId_{name} = run {name}()")


@node("Event")
def event(writer: Writer, element: Element) -> Steps[None]:
    """Done whenever its expression is true, beside the robot program; one thread looks for the first that is due."""
    if not writer.once("events"):
        return
    events = [
        line.element for line in writer.home(element).lines if line.element.tag == "Event" and not line.suppressed
    ]
    with writer.into("threads"):
        with writer.block("thread EventThread():"), writer.block("while (True):"):
            for each in events:
                condition = expression_text(writer, each.child("expression"))
                writer.line(f"{'if' if each is events[0] else 'elif'} ({condition}):")
                with writer.indented():
                    writer.label(each, "Event")
                    yield from translate_children(writer, each)
            writer.line("end")
            writer.line("sync()")
        writer.line("eventThread = run EventThread()")


@node("Folder")
def folder(writer: Writer, element: Element) -> Steps[None]:
    """Nodes under a name."""
    writer.label(element, element.get("name") or "Folder")
    yield from translate_children(writer, element)


@node("SuppressedNode")
def suppressed(writer: Writer, element: Element) -> None:
    """Left out."""


@node("Placeholder")
def placeholder(writer: Writer, element: Element) -> None:
    """An empty line of the tree."""


@node("Comment")
def comment(writer: Writer, element: Element) -> None:
    """A remark: a label that clients see."""
    text = element.get("comment")
    writer.label(element, f"'{text}'" if text else "Comment")
