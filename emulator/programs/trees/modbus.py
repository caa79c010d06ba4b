"""Modbus signals of an installation file."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from emulator.programs.trees.document import Element
from emulator.programs.trees.numbers import number

__all__ = ["ModbusSignal", "read_modbus"]

_TYPES: Final = {"DIGITAL_INPUT": 0, "DIGITAL_OUTPUT": 1, "REGISTER_INPUT": 2, "REGISTER_OUTPUT": 3}  # as for scripts


@dataclass(frozen=True, slots=True)
class ModbusSignal:
    """One signal, with the arguments of modbus_add_signal; ``frequency`` [Hz], negative: the usual one."""

    name: str
    address: str
    slave: int
    register: int
    type: int
    frequency: int


def read_modbus(root: Element) -> tuple[ModbusSignal, ...]:
    """Every signal, in the two forms files have: values as attributes, or as elements."""
    return tuple(_signals(root))


def _signals(root: Element) -> Iterator[ModbusSignal]:
    for unit in root.walk():
        address = _value(unit, "ipAddress", "ip__address")
        if address and unit.tag != "ModbusSignal":
            for signal in unit.walk():
                if signal.tag.rpartition(".")[2] == "ModbusSignal":
                    yield _signal(signal, address)


def _signal(signal: Element, address: str) -> ModbusSignal:
    kind = _value(signal, "type")
    return ModbusSignal(
        name=_value(signal, "name"),
        address=address,
        slave=int(number(_value(signal, "slaveAddress") or "255")),
        register=int(number(_value(signal, "signalAddress") or "0")),
        type=_TYPES[kind] if kind in _TYPES else int(number(kind or "0")),
        frequency=int(number(_value(signal, "updateFrequency") or "-1")),
    )


def _value(element: Element, *names: str) -> str:
    for name in names:
        child = element.child(name)
        if element.get(name):
            return element.get(name)
        if child is not None and child.text.strip():
            return child.text.strip()
    return ""
