"""Nodes for the structure of a program: the program itself, threads, events, folders and comments."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import Field, attribute_boolean, attribute_text, expression_field, node_name, titled
from urscript.polyscope.nodes.waypoints import circle_move
from urscript.polyscope.numbers import identifier
from urscript.polyscope.registry import Kind, empty_children, node, translate_children
from urscript.polyscope.writer import Writer, expression_text, variable_name
from urscript.work import Steps

VARIABLES_SETUP: Final = Kind(
    "variables_setup",
    "Variables Setup",
    "Program",
    lambda _: "Variables Setup",
    new=lambda _: make("InitVariablesNode"),
    stands="program",
)
BEFORE_START: Final = Kind(
    "before_start",
    "BeforeStart",
    "Program",
    lambda element: element.get("type"),
    new=lambda _: make("SpecialSequence", empty_children(), type="BeforeStart"),
    stands="program",
    contains="nodes",
    matches=lambda element: element.get("type") == "BeforeStart",
)
EVENT: Final = Kind(
    "event",
    "Event",
    "Advanced",
    lambda element: titled("Event", expression_shown(element.child("expression"))),
    new=lambda _: make("Event", make("expression"), empty_children()),
    stands="program",
    contains="nodes",
    undefined=lambda element: "its expression" if lacks_expression(element) else "",
    fields=(expression_field("expression", "Expression"),),
)
FOLDER: Final = Kind(
    "folder",
    "Folder",
    "Basic",
    lambda element: element.get("name") or "Folder",
    new=lambda _: make("Folder", empty_children(), name="Folder", keepHidden="false"),
    contains="nodes",
    fields=(
        node_name(what="folder", free=True),
        attribute_boolean("hidden", "Hide folder program tree", "keepHidden"),
    ),
)
COMMENT: Final = Kind(
    "comment",
    "Comment",
    "Basic",
    lambda element: f"'{element.get('comment')}'" if element.get("comment") else "Comment",
    new=lambda _: make("Comment"),
    fields=(attribute_text("comment", "Comment", "comment", empty=False),),
)


def _loops_field(title: str) -> Field:
    """Whether the node restarts at its end; files store the opposite."""
    return Field(
        "loops",
        title,
        "boolean",
        lambda element, _: element.get("runOnlyOnce") != "true",
        lambda element, value, program: program.set_attribute(element, "runOnlyOnce", "false" if value else "true"),
    )


ROBOT_PROGRAM: Final = Kind(
    "robot_program",
    "Robot Program",
    "Program",
    lambda _: "Robot Program",
    stands="program",
    contains="nodes",
    fields=(_loops_field("Program loops forever"),),
)


@node("MainProgram", ROBOT_PROGRAM, attributes="runOnlyOnce InitVariablesNode")
def main_program(writer: Writer, element: Element) -> Steps[None]:
    """The robot program, which repeats forever unless it runs only once."""
    if element.get("runOnlyOnce") == "true":
        writer.label(element, "Robot Program")
        yield from translate_children(writer, element)
        return
    with writer.block("while (True):"):
        writer.label(element, "Robot Program")
        yield from translate_children(writer, element)


@node("InitVariablesNode", VARIABLES_SETUP)
def init_variables(writer: Writer, element: Element) -> None:
    """Initial values of variables."""
    with writer.into("variables"):
        for variable in element.child("variables") or ():
            text = expression_text(writer, variable.child("expression", "initializeExpression"))
            if text:
                writer.line(f"global {variable_name(variable)}={text}")


@node("SpecialSequence", BEFORE_START, status="partial", note="BeforeStart, and the CircleMove of old files")
def special_sequence(writer: Writer, element: Element) -> Steps[None]:
    """Nodes that run once before the program starts."""
    if element.get("type") == "CircleMove":
        circle_move(writer, element)
        return
    if element.get("type") != "BeforeStart":
        raise DocumentError(f"an unknown special sequence {element.get('type')!r}")
    with writer.into("before"):
        writer.label(element, element.get("type"))
        yield from translate_children(writer, element)


THREAD: Final = Kind(
    "thread",
    "Thread",
    "Advanced",
    lambda element: element.get("name"),
    new=lambda program: make(
        "Thread", empty_children(), name=program.unused("Thread", program.names("Thread")), runOnlyOnce="false"
    ),
    stands="program",
    contains="nodes",
    fields=(node_name(what="thread"), _loops_field("Loops forever")),
)


@node("Thread", THREAD)
def thread(writer: Writer, element: Element) -> Steps[None]:
    """Runs alongside the robot program, forever unless it runs only once."""
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


@node("Event", EVENT, children="expression children")
def event(writer: Writer, element: Element) -> Steps[None]:
    """Runs alongside the robot program whenever its expression is true; one thread runs the first that is due."""
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


@node("Folder", FOLDER)
def folder(writer: Writer, element: Element) -> Steps[None]:
    """Groups nodes under a name."""
    writer.label(element, element.get("name") or "Folder")
    yield from translate_children(writer, element)


@node("SuppressedNode")
def suppressed(writer: Writer, element: Element) -> None:
    """Nodes that are not executed."""


@node(
    "Placeholder",
    Kind("empty", "<empty>", "Program", lambda _: "<empty>", undefined=lambda _: "the node to execute here"),
)
def placeholder(writer: Writer, element: Element) -> None:
    """An empty line of the tree."""


@node("Comment", COMMENT)
def comment(writer: Writer, element: Element) -> None:
    """A remark, written as a label that clients see."""
    text = element.get("comment")
    writer.label(element, f"'{text}'" if text else "Comment")
