"""Dialogs with the operator, Halt and Assignment."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import (
    Field,
    attribute_boolean,
    attribute_choice,
    attribute_text,
    expression_field,
    having,
    parts_choice,
    variable_field,
)
from urscript.polyscope.numbers import quoted
from urscript.polyscope.registry import Kind, node
from urscript.polyscope.surroundings import Surroundings
from urscript.polyscope.writer import Writer, expression_label, expression_text, variable_name

_FLAGS: Final = {"Message": "False, False", "Warning": "True, False", "Error": "False, True"}  # warning, error
_SOURCES: Final = {"Expression": "An expression", "Operator": "The operator"}
_ANSWERS: Final = {"Boolean": "Yes or no", "Integer": "A whole number", "Float": "A number", "String": "A text"}


def variable_shown(element: Element | None) -> str:
    """The name of a variable, or of the feature that is used as one; a question mark without one."""
    return (element.get("name") or element.get("featureName") if element else "") or "?"


_asks_for_variable: Final = having("inputType", "Variable")


def _choose_input(element: Element, value: str, program: Surroundings) -> None:
    """Choose whether a popup shows a text or a variable; removes the other one."""
    program.set_attribute(element, "inputType", value)
    if value == "Text":
        program.set_child(element, "variable", None)
    program.set_attribute(element, "message", "" if value == "Text" else None)


def _popup_lacks(element: Element) -> str:
    if _asks_for_variable(element):
        return "" if element.child("variable") else "the variable to show"
    return "" if element.get("message") else "the text to show"


POPUP: Final = Kind(
    "popup",
    "Popup",
    "Basic",
    lambda element: f"Popup: {element.get('message')}" if element.get("message") else "Popup",
    new=lambda _: make("Popup", type="Message", haltProgram="false", message="", inputType="Text"),
    undefined=_popup_lacks,
    fields=(
        attribute_choice("type", "Type", "type", {"Message": "Message", "Warning": "Warning", "Error": "Error"}),
        Field(
            "shows",
            "Shows",
            "choice",
            lambda element, _: "Variable" if _asks_for_variable(element) else "Text",
            _choose_input,
            choices=(("Text", "A text"), ("Variable", "A variable")),
        ),
        attribute_text("message", "Text", "message", shown=lambda element: not _asks_for_variable(element)),
        variable_field("variable", "Variable", shown=_asks_for_variable),
        attribute_boolean("halts", "Halt program execution at this popup", "haltProgram"),
    ),
)


@node("Popup", POPUP, attributes="type haltProgram message inputType")
def popup(writer: Writer, element: Element) -> None:
    """Show a message on the screen; it may end the program."""
    kind = element.get("type")
    if kind not in _FLAGS:
        raise DocumentError(f"a Popup of unknown type {kind!r}")
    variable = element.child("variable")
    shown = f'str_cat("", {variable_name(variable)})' if variable else quoted(element.get("message"))
    ends = element.get("haltProgram") == "true"
    writer.label(element, "Popup" if variable else f"Popup: {element.get('message')}")
    writer.line(f'popup({shown}, "{kind}", {_FLAGS[kind]}, blocking={not ends})')
    if ends:
        writer.line("halt")


@node("Halt", Kind("halt", "Halt", "Basic", lambda _: "Halt", new=lambda _: make("Halt")))
def halt(writer: Writer, element: Element) -> None:
    """End the program."""
    writer.label(element, "Halt")
    writer.line("halt")


_of_operator: Final = having("valueSource", "Operator")


def _new_assignment(program: Surroundings) -> Element:
    variable = program.variable(program.unused("var", program.variables()))
    return make("Assignment", variable, make("expression"), valueSource="Expression")


def _assignment_shown(element: Element) -> str:
    shown = f"'{element.get('message')}'" if _of_operator(element) else expression_shown(element.child("expression"))
    return f"{variable_shown(element.child('variable'))}≔{shown}"


def _assignment_lacks(element: Element) -> str:
    if element.child("variable") is None:
        return "the variable to assign to"
    return "" if _of_operator(element) or not lacks_expression(element) else "the expression to assign"


ASSIGNMENT: Final = Kind(
    "assignment",
    "Assignment",
    "Advanced",
    _assignment_shown,
    new=_new_assignment,
    undefined=_assignment_lacks,
    fields=(
        variable_field("variable", "Variable"),
        parts_choice(
            "source",
            "Source",
            "valueSource",
            _SOURCES,
            {"Expression": [make("expression")]},
            {"Operator": {"message": "", "valueType": "Boolean"}},
            ["variable"],
        ),
        expression_field("expression", "Expression", shown=lambda element: not _of_operator(element)),
        attribute_text("message", "Question", "message", shown=_of_operator),
        attribute_choice("answer", "Answer", "valueType", _ANSWERS, shown=_of_operator),
    ),
)


@node("Assignment", ASSIGNMENT, attributes="valueSource message valueType", children="variable expression")
def assignment(writer: Writer, element: Element) -> None:
    """Assign the value of an expression, or the operator's answer, to a variable."""
    name = variable_name(element.child("variable"))
    if element.get("valueSource") == "Operator":
        kind = element.get("valueType").lower()
        if kind not in ("boolean", "integer", "float", "string"):
            raise DocumentError(f"the operator cannot be asked for a {kind!r}")
        writer.label(element, f"{name}≔{element.get('message')}")
        writer.line(f"global {name}=request_{kind}_from_primary_client({quoted(element.get('message'))})")
        return
    expression = element.child("expression")
    writer.label(element, f"{name}≔{expression_label(writer, expression)}")
    writer.line(f"global {name}={expression_text(writer, expression)}")
