"""Setting outputs, the tool and the payload."""

from typing import Final

from urproto.versions import Availability
from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import (
    Field,
    attribute_boolean,
    attribute_number,
    child_number,
    expression_field,
    in_child,
    of_type,
    parts_choice,
    pin_field,
)
from urscript.polyscope.nodes.waits import child_text, level_field, pin_shown
from urscript.polyscope.numbers import list_text, number, number_text, truth
from urscript.polyscope.registry import Kind, node
from urscript.polyscope.surroundings import ANALOG_OUTPUTS, DIGITAL_OUTPUTS, OUTPUTS, FieldError, Surroundings
from urscript.polyscope.writer import Writer, expression_text, pin_name, pin_writing, resolve_pin

_PULSE: Final = "SingleDigitalPulseActionState"
_VOLTS: Final = 10.0  # maximum voltage of an analog output
_MILLIAMPERES: Final = (4.0, 20.0)


_ACTIONS: Final = {
    "NoAction": "No action",
    "DigitalOutput": "A digital output",
    "AnalogOutput": "An analog output",
    "ExpressionOutput": "An output to an expression",
    _PULSE: "A single pulse",
}
_PARTS: Final = {
    "DigitalOutput": [make("digitalValue", text="1")],
    "AnalogOutput": [make("analogValue", text="0.0")],
    "ExpressionOutput": [make("expression")],
    _PULSE: [make(_PULSE, hiPulseInSeconds="0.5")],
}


def tcp_names(program: Surroundings) -> list[str]:
    """The TCPs of the installation."""
    return sorted(program.installation.tcps)


def _set_tcp(element: Element, value: str | None, program: Surroundings) -> None:
    if value is not None and value not in program.installation.tcps:
        raise FieldError(f"the installation {program.installation.name} has no TCP called {value!r}")
    program.set_child(element, "tcp", program.named("tcp", value) if value else None)


def _set_shown(element: Element) -> str:
    kind = element.get("type")
    if kind == "DigitalOutput":
        return f"Set {pin_shown(element)}={'On' if truth(child_text(element, 'digitalValue')) == 'True' else 'Off'}"
    if kind == "AnalogOutput":
        return f"Set {pin_shown(element)}={child_text(element, 'analogValue')}"
    if kind == "ExpressionOutput":
        return f"Set {pin_shown(element)}={expression_shown(element.child('expression'))}"
    pulse = element.child(_PULSE)
    return f"Set {pin_shown(pulse)}=HI:Pulse {pulse.get('hiPulseInSeconds')}" if pulse else "Set"


def _set_lacks(element: Element) -> str:
    kind = element.get("type")
    holder = element.child(_PULSE) if kind == _PULSE else element
    if kind != "NoAction" and (holder is None or holder.child("pin") is None):
        return "the output to set"
    return "the expression to set the output to" if kind == "ExpressionOutput" and lacks_expression(element) else ""


SET: Final = Kind(
    "set",
    "Set",
    "Basic",
    _set_shown,
    new=lambda _: make("Set", type="NoAction"),
    undefined=_set_lacks,
    fields=(
        parts_choice("type", "Set", "type", _ACTIONS, _PARTS, keep=["tcp"]),
        pin_field("output", "Output", DIGITAL_OUTPUTS, shown=of_type("DigitalOutput")),
        level_field(shown=of_type("DigitalOutput")),
        pin_field("analog_output", "Output", ANALOG_OUTPUTS, shown=of_type("AnalogOutput")),
        child_number(
            "value", "Value", "analogValue", shown=of_type("AnalogOutput"), help="V or mA, as set in the installation"
        ),
        pin_field("any_output", "Output", OUTPUTS, shown=of_type("ExpressionOutput")),
        expression_field("expression", "Expression", shown=of_type("ExpressionOutput")),
        in_child(_PULSE, pin_field("pulse_output", "Output", DIGITAL_OUTPUTS, shown=of_type(_PULSE))),
        in_child(
            _PULSE,
            attribute_number("pulse", "Pulse", "hiPulseInSeconds", unit="s", low=0.0, shown=of_type(_PULSE)),
        ),
        Field("tcp", "TCP", "tcp", lambda e, _: e.named("tcp") or None, _set_tcp, options=tcp_names, optional=True),
        attribute_number("payload", "Payload", "payload", unit="kg", low=0.0, optional=True),
        attribute_boolean(
            "tcp_as_cog", "Centre of gravity at the TCP", "tcpAsCog", shown=lambda e: bool(e.get("payload"))
        ),
    ),
)


@node(
    "Set",
    SET,
    status="partial",
    note="no single pulses from high to low, because their file format is not known",
    attributes="type payload tcpAsCog centerOfGravity",
    children=f"tcp pin digitalValue analogValue expression {_PULSE}",
)
def set_node(writer: Writer, element: Element) -> None:
    """Set an output, permanently or as a pulse, the TCP or the payload."""
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
        raise DocumentError(f"a Set of unknown type {kind!r}")
    writer.label(element, f"Set {pin_name(pin)}={shown}")
    writer.line(pin_writing(writer, pin, value))


def _share_of_range(writer: Writer, pin: Element | None, value: float) -> str:
    """The argument of the built-in, as a fraction of the range. Files contain volts (seen) or milliamperes (guess),
    depending on the installation."""
    kind, port = resolve_pin(writer, pin)
    if kind != "analog_out":
        return repr(value)
    volts = writer.installation.analog_outputs[int(port)] == 1
    return number_text(value / _VOLTS if volts else (value - _MILLIAMPERES[0]) / (_MILLIAMPERES[1] - _MILLIAMPERES[0]))


def _pulse(writer: Writer, element: Element) -> None:
    """Set an output high for a time, while the program continues."""
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


def _choose_payload(element: Element, value: str, program: Surroundings) -> None:
    if value not in program.installation.payloads:
        raise FieldError(f"the installation {program.installation.name} has no payload called {value!r}")
    program.set_attribute(element, "workpieceName", value)


SET_PAYLOAD: Final = Kind(
    "set_payload",
    "Set Payload",
    "Basic",
    lambda element: f"Set Payload: {element.get('workpieceName')}".rstrip(": "),
    new=lambda program: make("SetPayload", workpieceName=next(iter(program.installation.payloads), "")),
    undefined=lambda element: "" if element.get("workpieceName") else "the payload to set",
    available=Availability.since(None, "5.10"),
    fields=(
        Field(
            "payload",
            "Payload",
            "payload",
            lambda element, _: element.get("workpieceName"),
            _choose_payload,
            options=lambda program: sorted(program.installation.payloads),
        ),
    ),
)


@node("SetPayload", SET_PAYLOAD)
def set_payload(writer: Writer, element: Element) -> None:
    """Set a payload of the installation by its name (PolyScope 5.10 and later)."""
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
