"""Setting outputs, the tool and the payload."""

from emulator.programs.trees.document import DocumentError, Element
from emulator.programs.trees.expressions import expression_text
from emulator.programs.trees.naming import truth
from emulator.programs.trees.nodes.waits import child_text
from emulator.programs.trees.numbers import list_text, number
from emulator.programs.trees.pins import pin_name, pin_writing
from emulator.programs.trees.registry import node, refused
from emulator.programs.trees.writer import Writer

__all__: list[str] = []


@node("Set", status="partial", note="no single pulses: how files describe them is not known")
def set_node(writer: Writer, element: Element) -> None:
    """Set an output, the TCP or the payload."""
    _set_output(writer, element)
    if element.child("tcp"):
        writer.line(f"set_tcp({writer.tcp(element.child('tcp'))})")
    if element.get("payload"):
        _set_payload(writer, element)


def _set_output(writer: Writer, element: Element) -> None:
    kind, pin = element.get("type"), element.child("pin")
    if kind == "NoAction":
        writer.label(element, "Set")
        return
    if kind == "DigitalOutput":
        value = truth(child_text(element, "digitalValue"))
    elif kind == "AnalogOutput":
        value = repr(number(child_text(element, "analogValue")))
    elif kind == "ExpressionOutput":
        value = expression_text(writer, element.child("expression"))
    else:
        raise DocumentError(f"a Set of type {kind!r}, which is not known")
    writer.label(element, f"Set {pin_name(pin)}={value}")
    writer.line(pin_writing(writer, pin, value))


def _set_payload(writer: Writer, element: Element) -> None:
    mass = number(element.get("payload"))
    if element.get("tcpAsCog") == "true":
        writer.line(f"set_payload({mass}, [get_tcp_offset()[0], get_tcp_offset()[1], get_tcp_offset()[2]])")
        return
    cog = element.get("centerOfGravity") or "0.0, 0.0, 0.0"
    writer.line(f"set_payload({mass}, {list_text([number(part) for part in cog.split(',')])})")


refused("SetPayload", "how files of PolyScope 5.10 and later describe it is not known")
