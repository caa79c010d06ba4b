"""Dialogues with the operator, and the program's end."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import quoted
from urscript.polyscope.registry import node
from urscript.polyscope.writer import Writer, expression_label, expression_text, variable_name

_FLAGS: Final = {"Message": "False, False", "Warning": "True, False", "Error": "False, True"}  # warning, error


@node("Popup")
def popup(writer: Writer, element: Element) -> None:
    """A text on the screen, which may end the program."""
    kind = element.get("type")
    if kind not in _FLAGS:
        raise DocumentError(f"a Popup of type {kind!r}, which is not known")
    variable = element.child("variable")
    shown = f'str_cat("", {variable_name(variable)})' if variable else quoted(element.get("message"))
    ends = element.get("haltProgram") == "true"
    writer.label(element, "Popup" if variable else f"Popup: {element.get('message')}")
    writer.line(f'popup({shown}, "{kind}", {_FLAGS[kind]}, blocking={not ends})')
    if ends:
        writer.line("halt")


@node("Halt")
def halt(writer: Writer, element: Element) -> None:
    """The program ends here."""
    writer.label(element, "Halt")
    writer.line("halt")


@node("Assignment")
def assignment(writer: Writer, element: Element) -> None:
    """A variable gets the value of an expression, or what the operator answers."""
    name = variable_name(element.child("variable"))
    if element.get("valueSource") == "Operator":
        kind = element.get("valueType").lower()
        if kind not in ("boolean", "integer", "float", "string"):
            raise DocumentError(f"an operator cannot be asked for a {kind!r}")
        writer.label(element, f"{name}≔{element.get('message')}")
        writer.line(f"global {name}=request_{kind}_from_primary_client({quoted(element.get('message'))})")
        return
    expression = element.child("expression")
    writer.label(element, f"{name}≔{expression_label(writer, expression)}")
    writer.line(f"global {name}={expression_text(writer, expression)}")
