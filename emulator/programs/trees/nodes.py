"""Node types."""

from emulator.programs.trees.document import Element
from emulator.programs.trees.registry import node, translate_children
from emulator.programs.trees.writer import TreeError, Writer
from urscript.work import Steps

REGISTERED = True


def is_external_control(element: Element) -> bool:
    """Whether a node is one of the External Control URCap."""
    return element.tag == "Contributed" and element.get("strategyURCapName") == "External Control"


@node("MainProgram")
def main_program(writer: Writer, element: Element) -> Steps[None]:
    """The robot program, in a loop unless it runs only once."""
    if element.get("runOnlyOnce") == "true":
        yield from translate_children(writer, element)
        return
    with writer.block("while (True):"):
        writer.label(element, "Robot Program")
        yield from translate_children(writer, element)


@node("Wait")
def wait(writer: Writer, element: Element) -> None:
    """Wait for a time."""
    time = element.child("waitTime")
    writer.line(f"sleep({time.text.strip() if time else 0.0})")


@node("InitVariablesNode")
def init_variables(writer: Writer, element: Element) -> None:
    """First values of variables."""


@node("Contributed")
def contributed(writer: Writer, element: Element) -> None:
    """A node of a URCap."""
    if not is_external_control(element) or writer.external_control is None:
        raise TreeError(f"a node of the URCap {element.get('strategyURCapName')} cannot be translated")
    if writer.once("external control header"):
        with writer.into("preamble"):
            writer.line(writer.external_control.header)
    writer.line(writer.external_control.node)
