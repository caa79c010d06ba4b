"""Waiting."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import truth
from urscript.polyscope.registry import node
from urscript.polyscope.writer import Writer, expression_label, expression_text, pin_name, pin_reading

_COMPARISONS: Final = {"0": "<", "1": ">"}  # guess: which is which


@node("Wait", status="partial", note="which of < and > an analogue condition means is a guess")
def wait(writer: Writer, element: Element) -> None:
    """Wait for a time, an input or a condition."""
    kind = element.get("type")
    if kind == "Sleep":
        writer.label(element, f"Wait: {child_text(element, 'waitTime')}")
        writer.line(f"sleep({child_text(element, 'waitTime')})")
    elif kind == "NoWait":
        writer.label(element, "Wait")
    else:
        label, waiting = _condition(writer, element, kind)
        writer.label(element, f"Wait {label}")
        with writer.block(f"while ({waiting}):"):
            writer.line("sync()")


def _condition(writer: Writer, element: Element, kind: str) -> tuple[str, str]:
    """How it is shown, and URScript that is true until it is met."""
    if kind == "Condition":
        expression = element.child("expression")
        return expression_label(writer, expression), f"not({expression_text(writer, expression)})"
    if kind == "DigitalInput":
        wanted = truth(child_text(element, "digitalValue"))
        other = "False" if wanted == "True" else "True"
        pin = element.child("pin")
        return f"{pin_name(pin)}={wanted}", f"{pin_reading(writer, pin)} == {other}"
    if kind == "AnalogInput":
        condition = analog_condition(writer, element)
        return condition, f"not({condition})"
    raise DocumentError(f"a Wait of type {kind!r}, which is not known")


def analog_condition(writer: Writer, element: Element) -> str:
    """An analogue input above or below a value."""
    operator = _COMPARISONS.get(child_text(element, "analogComparison") or element.get("analogComparison"))
    if operator is None:
        raise DocumentError(f"how {pin_name(element.child('pin'))} is compared with a value is not known")
    return f"{pin_reading(writer, element.child('pin'))} {operator} {child_text(element, 'analogValue')}"


def child_text(element: Element, tag: str) -> str:
    """Text of a child, stripped; empty without one."""
    child = element.child(tag)
    return child.text.strip() if child else ""
