"""Inputs and outputs by the names that programs use for them."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from emulator.programs.trees.document import DocumentError, Element
from emulator.programs.trees.naming import quoted

if TYPE_CHECKING:
    from emulator.programs.trees.writer import Writer

__all__ = ["PINS", "find_pin", "pin_name", "pin_reading", "pin_writing", "resolve_pin"]

_NUMBERED: Final = re.compile(r"(\w+)\[([0-9]{1,9})\]")

# name without the number -> reading and writing call, as PolyScope writes them
PINS: Final[dict[str, tuple[str, str]]] = {
    "digital_in": ("get_standard_digital_in({0})", ""),
    "digital_out": ("get_standard_digital_out({0})", "set_standard_digital_out({0}, {1})"),
    "config_in": ("get_configurable_digital_in({0})", ""),
    "config_out": ("get_configurable_digital_out({0})", "set_configurable_digital_out({0}, {1})"),
    "tool_in": ("get_tool_digital_in({0})", ""),
    "tool_out": ("get_tool_digital_out({0})", "set_tool_digital_out({0}, {1})"),
    "analog_in": ("get_standard_analog_in({0})", ""),
    "analog_out": ("get_standard_analog_out({0})", "set_standard_analog_out({0}, {1})"),
    "tool_analog_in": ("get_tool_analog_in({0})", ""),
    "GP_bool_in": ("read_input_boolean_register({0})", ""),
    "GP_bool_out": ("read_output_boolean_register({0})", "write_output_boolean_register({0}, {1})"),
    "GP_int_in": ("read_input_integer_register({0})", ""),
    "GP_int_out": ("read_output_integer_register({0})", "write_output_integer_register({0}, {1})"),
    "GP_float_in": ("read_input_float_register({0})", ""),
    "GP_float_out": ("read_output_float_register({0})", "write_output_float_register({0}, {1})"),
}


def pin_name(pin: Element | None) -> str:
    """The name a node gives for its pin. Raises DocumentError without one."""
    name = "" if pin is None else pin.get("referencedName")
    if not name:
        raise DocumentError("a node does not say which input or output it means")
    return name


def find_pin(name: str, names: Mapping[str, tuple[str, str]]) -> tuple[str, str] | None:
    """Kind (a key of PINS, or modbus) and number (or signal name) of a pin; ``names``: those of the installation."""
    match = _NUMBERED.fullmatch(name)
    return (match[1], match[2]) if match and match[1] in PINS else names.get(name)


def resolve_pin(writer: "Writer", pin: Element | None) -> tuple[str, str]:
    """Kind (a key of PINS, or modbus) and number (or signal name) of a pin.

    Raises DocumentError for a name that neither PolyScope nor the installation gives.
    """
    name = pin_name(pin)
    found = find_pin(name, writer.installation.pins)
    if found is None:
        raise DocumentError(f"the installation {writer.installation.name} has no input or output called {name}")
    return found


def pin_reading(writer: "Writer", pin: Element | None) -> str:
    """URScript that reads an input, or what an output is set to."""
    kind, number = resolve_pin(writer, pin)
    if kind == "modbus":
        return f"modbus_get_signal_status({quoted(number)})"
    return PINS[kind][0].format(number)


def pin_writing(writer: "Writer", pin: Element | None, value: str) -> str:
    """URScript that sets an output. Raises DocumentError for an input."""
    kind, number = resolve_pin(writer, pin)
    if kind == "modbus":
        call = "modbus_set_output_signal" if value in ("True", "False") else "modbus_set_output_register"
        return f"{call}({quoted(number)}, {value})"
    if not PINS[kind][1]:
        raise DocumentError(f"{pin_name(pin)} is an input and cannot be set")
    return PINS[kind][1].format(number, value)
