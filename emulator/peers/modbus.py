"""Modbus units whose values are constants, sequences, or those of a Python object."""

import errno
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

from emulator.peers.log import PeerLog
from emulator.services.modbus import MemoryUnit, ModbusBackend, ModbusExchange, ModbusUnit
from urproto.modbus import Function, ModbusRequest

_WRITES_COILS = (Function.WRITE_COIL, Function.WRITE_COILS)


class Values(dict[int, Any]):
    """Values by address. A list is read one element after the other; the last one repeats, until it is written."""

    def __getitem__(self, address: int) -> int:
        value = super().__getitem__(address)
        if isinstance(value, list):
            return int(value.pop(0) if len(value) > 1 else value[0])
        return int(value)


@dataclass
class UnitPeer:
    """A unit.

    refuse: it accepts no connection. exception: the code with which it answers every request, or 0. written: called
    with the kind (``coil``, ``register``), address and value of each write.
    """

    log: PeerLog
    coils: MutableMapping[int, int] = field(default_factory=Values)
    registers: MutableMapping[int, int] = field(default_factory=Values)
    refuse: bool = False
    exception: int = 0
    written: Callable[[str, int, int], object] = lambda kind, address, value: None

    def __post_init__(self) -> None:
        self._unit = MemoryUnit(self.coils, self.registers, self.exception)
        self._last: dict[tuple[str, int], int] = {}  # as written

    def answer(self, request: ModbusRequest, exchange: ModbusExchange) -> None:
        """Carry a request out; a value that is written again, as a signal does all the time, is not reported again."""
        if self.refuse:
            exchange.complete(connection_error=errno.ECONNREFUSED)
            return
        self._unit.answer(request, exchange)
        self._unit.requests.clear()
        kind = "coil" if request.function in _WRITES_COILS else "register"
        start = request.write_address if request.function == Function.READ_WRITE_REGISTERS else request.address
        for address, value in enumerate(request.values, start):
            if self._last.get((kind, address)) != value:
                self._last[kind, address] = value
                self.log.add(f"{kind} {address} = {value}")
                self.written(kind, address, value)


class PeerModbus:
    """The Modbus network: the units of a file by their address, and `others` for the rest."""

    def __init__(self, units: Mapping[str, UnitPeer], others: ModbusBackend) -> None:
        self._units = units
        self._others = others

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        peer = self._units.get(unit.address)
        if peer is None:
            return self._others.request(unit, request, sequential=sequential)
        exchange = ModbusExchange()
        peer.answer(request, exchange)
        return exchange

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        if (peer := self._units.get(unit.address)) is not None:
            peer.log.add(f"command {pdu.hex()}")
        else:
            self._others.send(unit, pdu)

    def reset(self, address: str) -> None:
        self._others.reset(address)

    def release(self, unit: ModbusUnit) -> None:
        self._others.release(unit)
