"""Modbus units whose values are constants, sequences, or those of a Python object."""

import errno
import math
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

from emulator.peers.log import PeerLog
from emulator.services.modbus import DISCONNECTED, ModbusBackend, ModbusExchange, ModbusUnit
from urproto.modbus import ExceptionCode, Function, ModbusRequest

_BITS = (Function.READ_COILS, Function.READ_DISCRETE_INPUTS, Function.WRITE_COIL, Function.WRITE_COILS)


class Values(dict[int, Any]):
    """Values by address. A list is read one element after the other; the last one repeats, until it is written."""

    def __getitem__(self, address: int) -> int:
        value = super().__getitem__(address)
        if isinstance(value, list):
            return int(value.pop(0) if len(value) > 1 else value[0])
        return int(value)


class _Delayed(ModbusExchange):
    """A request whose outcome arrives at some time [s of robot time]."""

    __slots__ = ("_arrives_s", "_known", "_now")

    def __init__(self, arrives_s: float, now: Callable[[], float]) -> None:
        self._arrives_s, self._now = arrives_s, now
        super().__init__()

    @property
    def done(self) -> bool:
        return self._known and self._now() >= self._arrives_s

    @done.setter
    def done(self, known: bool) -> None:
        self._known = known


@dataclass
class UnitPeer:
    """A unit.

    refusals: the number of connections that it refuses first. delay_s: before each answer. lasts_s: after this time, it
    closes a connection; the next request opens another one. exception: the code with which it answers every request, or
    0. written: called with the kind (``coil``, ``register``), address and value of each write.
    """

    log: PeerLog
    coils: MutableMapping[int, int] = field(default_factory=Values)
    registers: MutableMapping[int, int] = field(default_factory=Values)
    refusals: float = 0
    delay_s: float = 0.0
    lasts_s: float = math.inf
    exception: int = 0
    written: Callable[[str, int, int], object] = lambda kind, address, value: None

    def __post_init__(self) -> None:
        self._last: dict[tuple[str, int], int] = {}  # as written
        self._closes_s: float | None = None  # while a connection is open
        self._busy_until_s = 0.0

    def request(self, request: ModbusRequest) -> ModbusExchange:
        """Carry a request out, or refuse it; answers come one after the other."""
        now_s = self.log.now()
        if self._closes_s is None:
            if self.refusals > 0:
                self.refusals -= 1
                return self._failed(errno.ECONNREFUSED, now_s)
            self._closes_s = now_s + self.lasts_s
        arrives_s = max(now_s, self._busy_until_s) + self.delay_s
        if arrives_s >= self._closes_s:
            closes_s, self._closes_s = self._closes_s, None
            return self._failed(DISCONNECTED, closes_s)
        self._busy_until_s = arrives_s
        exchange = _Delayed(arrives_s, self.log.now)
        self._answer(request, exchange)
        return exchange

    def _failed(self, error: int, arrives_s: float) -> ModbusExchange:
        exchange = _Delayed(arrives_s, self.log.now)
        exchange.complete(connection_error=error)
        return exchange

    def _answer(self, request: ModbusRequest, exchange: ModbusExchange) -> None:
        """Coils and discrete inputs are one table, so are the registers.

        A value that is written again, as a signal does all the time, is not reported again.
        """
        kind, table = ("coil", self.coils) if request.function in _BITS else ("register", self.registers)
        start = request.write_address if request.function == Function.READ_WRITE_REGISTERS else request.address
        wanted = range(request.address, request.address + request.count)
        if self.exception:
            exchange.complete(device_error=self.exception)
        else:
            for address, value in enumerate(request.values, start):
                table[address] = value
            if request.values and request.function != Function.READ_WRITE_REGISTERS:
                exchange.complete()
            elif all(address in table for address in wanted):
                exchange.complete(tuple(table[address] for address in wanted))
            else:
                exchange.complete(device_error=ExceptionCode.ILLEGAL_DATA_ADDRESS)
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
        return peer.request(request)

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        if (peer := self._units.get(unit.address)) is not None:
            peer.log.add(f"command {pdu.hex()}")
        else:
            self._others.send(unit, pdu)

    def reset(self, address: str) -> None:
        self._others.reset(address)

    def release(self, unit: ModbusUnit) -> None:
        self._others.release(unit)
