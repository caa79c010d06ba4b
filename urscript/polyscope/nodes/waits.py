"""Waiting."""

import re
from typing import Any, Final

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import Field, child_number, expression_field, of_type, parts_choice, pin_field, titled
from urscript.polyscope.numbers import truth
from urscript.polyscope.registry import Kind, node
from urscript.polyscope.surroundings import ANALOG_INPUTS, DIGITAL_INPUTS, Surroundings
from urscript.polyscope.writer import Writer, expression_label, expression_text, pin_name, pin_reading

_COMPARISONS: Final = {"0": "<", "1": ">"}  # description of program files of 5.15, FuNingHu/urp-generator-5
_LEVELS: Final = {"1": "On", "0": "Off"}
_SHORT: Final = re.compile(r"(digital|tool|analog|config)_(in|out)\[")
_WAITS: Final = {
    "NoWait": "No wait",
    "Sleep": "A time",
    "DigitalInput": "A digital input",
    "AnalogInput": "An analog input",
    "Condition": "An expression",
}
_PARTS: Final = {
    "Sleep": [make("waitTime", text="0.01")],
    "DigitalInput": [make("digitalValue", text="1")],
    "AnalogInput": [make("analogComparison", text="1"), make("analogValue", text="0.0")],
    "Condition": [make("expression")],
}


def level_field(**more: Any) -> Field:
    """Field for high or low, stored as the text of a child."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_text(element, "digitalValue", value)

    def read(element: Element, _: Surroundings) -> str:
        text = child_text(element, "digitalValue")
        return "" if not text else "1" if truth(text) == "True" else "0"

    return Field("level", "Level", "choice", read, write, choices=tuple(_LEVELS.items()), **more)


def pin_shown(element: Element) -> str:
    """The name of a node's pin as shown in the tree: DO[0] for digital_out[0] (seen; the same for others: a guess)."""
    name = element.named("pin") or "?"
    return _SHORT.sub(lambda match: f"{match[1][0]}{match[2][0]}[".upper(), name)


def _shown(element: Element) -> str:
    kind = element.get("type")
    if kind == "Sleep":
        return f"Wait: {child_text(element, 'waitTime')}"
    if kind == "Condition":
        return titled("Wait", expression_shown(element.child("expression")))
    if kind == "DigitalInput":
        return f"Wait {pin_shown(element)}={truth(child_text(element, 'digitalValue'))}"
    if kind == "AnalogInput":
        comparison = _COMPARISONS.get(child_text(element, "analogComparison"), "?")
        return f"Wait {pin_shown(element)}{comparison}{child_text(element, 'analogValue')}"
    return "Wait"


def _lacks(element: Element) -> str:
    kind = element.get("type")
    if kind == "Condition":
        return "the condition to wait for" if lacks_expression(element) else ""
    if kind in ("DigitalInput", "AnalogInput"):
        return "" if element.child("pin") else "the input to wait for"
    return "what to wait for" if kind == "Undefined" else ""


WAIT: Final = Kind(
    "wait",
    "Wait",
    "Basic",
    _shown,
    new=lambda _: make("Wait", type="NoWait"),
    undefined=_lacks,
    fields=(
        parts_choice("type", "Wait for", "type", _WAITS, _PARTS),
        child_number("time", "Time", "waitTime", unit="s", low=0.0, shown=of_type("Sleep")),
        pin_field("input", "Input", DIGITAL_INPUTS, shown=of_type("DigitalInput")),
        level_field(shown=of_type("DigitalInput")),
        pin_field("analog_input", "Input", ANALOG_INPUTS, shown=of_type("AnalogInput")),
        Field(
            "comparison",
            "Comparison",
            "choice",
            lambda e, _: child_text(e, "analogComparison"),
            lambda e, value, program: program.set_text(e, "analogComparison", value),
            choices=tuple(_COMPARISONS.items()),
            shown=of_type("AnalogInput"),
        ),
        child_number("value", "Value", "analogValue", shown=of_type("AnalogInput")),
        expression_field("condition", "Condition", shown=of_type("Condition")),
    ),
)


@node("Wait", WAIT, children="waitTime pin digitalValue analogComparison analogValue expression")
def wait(writer: Writer, element: Element) -> None:
    """Wait for a time, an input or a condition."""
    kind = element.get("type")
    if kind == "Sleep":
        writer.label(element, f"Wait: {child_text(element, 'waitTime')}")
        writer.line(f"sleep({child_text(element, 'waitTime')})")
    elif kind in ("NoWait", "Undefined"):
        writer.label(element, "Wait")
    else:
        label, waiting = _condition(writer, element, kind)
        writer.label(element, f"Wait {label}")
        with writer.block(f"while ({waiting}):"):
            writer.line("sync()")


def _condition(writer: Writer, element: Element, kind: str) -> tuple[str, str]:
    """The condition as shown in the tree, and URScript that is true until it is met."""
    if kind == "Condition":
        expression = element.child("expression")
        return expression_label(writer, expression), f"not({expression_text(writer, expression)})"
    if kind == "DigitalInput":
        expected = truth(child_text(element, "digitalValue"))
        other = "False" if expected == "True" else "True"
        pin = element.child("pin")
        return f"{pin_name(pin)}={expected}", f"{pin_reading(writer, pin)} == {other}"
    if kind == "AnalogInput":
        condition = analog_condition(writer, element)
        return condition, f"not({condition})"
    raise DocumentError(f"a Wait of unknown type {kind!r}")


def analog_condition(writer: Writer, element: Element) -> str:
    """URScript that compares an analog input with a value."""
    operator = _COMPARISONS.get(child_text(element, "analogComparison") or element.get("analogComparison"))
    if operator is None:
        raise DocumentError(f"the comparison of {pin_name(element.child('pin'))} with a value is not known")
    return f"{pin_reading(writer, element.child('pin'))} {operator} {child_text(element, 'analogValue')}"


def child_text(element: Element, tag: str) -> str:
    """Text of a child, stripped; empty without one."""
    child = element.child(tag)
    return child.text.strip() if child else ""
