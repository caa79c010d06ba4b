"""Modbus signals of an installation file."""

from collections.abc import Iterator
from dataclasses import dataclass

from emulator.programs.trees.document import Element
from emulator.programs.trees.numbers import number

__all__ = ["ModbusSignal", "read_modbus"]


@dataclass(frozen=True, slots=True)
class ModbusSignal:
    """One signal, with the arguments of modbus_add_signal; ``frequency`` [Hz]."""

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
        if unit.tag.rpartition(".")[2] == "ModbusUnit":
            address = _value(unit, "ip__address", "ipAddress", "ip_address", "ip")
            for signal in unit.walk():
                if signal.tag.rpartition(".")[2] == "ModbusSignal":
                    yield _signal(signal, address)


def _signal(signal: Element, address: str) -> ModbusSignal:
    return ModbusSignal(
        name=_value(signal, "name"),
        address=address,
        slave=int(number(_value(signal, "slaveAddress", "slave_address") or "255")),
        register=int(number(_value(signal, "signalAddress", "signal_address", "address") or "0")),
        type=int(number(_value(signal, "type") or "0")),
        frequency=int(number(_value(signal, "updateFrequency", "update_frequency") or "10")),
    )


def _value(element: Element, *names: str) -> str:
    for name in names:
        child = element.child(name)
        if element.get(name):
            return element.get(name)
        if child is not None and child.text.strip():
            return child.text.strip()
    return ""
