"""Setting outputs, the tool and the payload."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import truth
from urscript.polyscope.nodes.waits import child_text
from urscript.polyscope.numbers import list_text, number, number_text
from urscript.polyscope.registry import node
from urscript.polyscope.writer import Writer, expression_text, pin_name, pin_writing, resolve_pin

_PULSE: Final = "SingleDigitalPulseActionState"
_VOLTS: Final = 10.0  # what an analogue output gives at most
_MILLIAMPERES: Final = (4.0, 20.0)


@node("Set", status="partial", note="no single pulses from high to low: how files describe them is not known")
def set_node(writer: Writer, element: Element) -> None:
    """Set an output, for a time or for good, the TCP or the payload."""
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
    if kind == _PULSE:
        _pulse(writer, element)
        return
    if kind == "DigitalOutput":
        shown = value = truth(child_text(element, "digitalValue"))
    elif kind == "AnalogOutput":
        shown = child_text(element, "analogValue")
        value = _share_of_range(writer, pin, number(shown))
    elif kind == "ExpressionOutput":
        shown = value = expression_text(writer, element.child("expression"))
    else:
        raise DocumentError(f"a Set of type {kind!r}, which is not known")
    writer.label(element, f"Set {pin_name(pin)}={shown}")
    writer.line(pin_writing(writer, pin, value))


def _share_of_range(writer: Writer, pin: Element | None, value: float) -> str:
    """What the built-in takes: files have volts (seen) or milliamperes (guess), as the installation has it."""
    kind, port = resolve_pin(writer, pin)
    if kind != "analog_out":
        return repr(value)
    volts = writer.installation.analog_outputs[int(port)] == 1
    return number_text(value / _VOLTS if volts else (value - _MILLIAMPERES[0]) / (_MILLIAMPERES[1] - _MILLIAMPERES[0]))


def _pulse(writer: Writer, element: Element) -> None:
    """High for a time, and the program goes on meanwhile."""
    pulse = element.child(_PULSE)
    seconds = pulse.get("hiPulseInSeconds") if pulse else ""
    if pulse is None or not seconds:
        raise DocumentError("a Set with a single pulse that does not go from low to high")
    pin = pulse.child("pin")
    writer.label(element, f"Set {pin_name(pin)}=HI:Pulse {seconds}")
    name = writer.number(element)
    with writer.block(f"thread SinglePulse{name}():"):
        writer.line(pin_writing(writer, pin, "True"))
        writer.line(f"sleep({seconds})")
        writer.line(pin_writing(writer, pin, "False"))
    writer.line(f"singlePulse{name} = run SinglePulse{name}()")


@node("SetPayload")
def set_payload(writer: Writer, element: Element) -> None:
    """Set a payload that the installation has under a name (PolyScope 5.10 and later)."""
    name = element.get("workpieceName")
    payload = writer.installation.payloads.get(name)
    if payload is None:
        raise DocumentError(f"the installation {writer.installation.name} has no payload called {name!r}")
    writer.label(element, f"Set Payload: {name}")
    writer.line(writer.payload(payload))


def _set_payload(writer: Writer, element: Element) -> None:
    mass = number(element.get("payload"))
    if element.get("tcpAsCog") == "true":
        writer.line(f"set_payload({mass}, [get_tcp_offset()[0], get_tcp_offset()[1], get_tcp_offset()[2]])")
        return
    cog = element.get("centerOfGravity") or "0.0, 0.0, 0.0"
    writer.line(f"set_payload({mass}, {list_text([number(part) for part in cog.split(',')])})")
