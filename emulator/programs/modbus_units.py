"""The Modbus units that signals live on, as the controller sees them.

A backend carries requests to units; the controller never waits for one, it looks at
``ModbusExchange.done`` once per control period. ``MemoryModbus`` is a backend without a
network.
"""

import errno
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

from urproto.modbus import ExceptionCode, Function, ModbusRequest

__all__ = [
    "CONNECTING",
    "DISCONNECTED",
    "MemoryModbus",
    "MemoryUnit",
    "ModbusBackend",
    "ModbusExchange",
    "ModbusUnit",
    "NoModbusNetwork",
]

# Connection errors beside the numbers of errno. Script Manual, modbus_get_error; CONNECTING from another maker's.
CONNECTING: Final = -1
DISCONNECTED: Final = -2


class ModbusUnit(NamedTuple):
    """Who is asked: an address and the number of the unit behind it. Port and all else is the backend's."""

    address: str
    slave: int


class ModbusExchange:
    """A request under way. ``device_error``: the unit's exception code; ``connection_error``: an errno or negative."""

    __slots__ = ("connection_error", "device_error", "done", "values")

    def __init__(self) -> None:
        self.done = False
        self.values: tuple[int, ...] = ()
        self.device_error = 0
        self.connection_error = 0

    def complete(self, values: tuple[int, ...] = (), *, device_error: int = 0, connection_error: int = 0) -> None:
        """Enter the outcome; later ones are ignored."""
        if not self.done:
            self.done, self.values = True, values
            self.device_error, self.connection_error = device_error, connection_error


class ModbusBackend(Protocol):
    """Where units are. Nothing here fails or waits: what goes wrong is the exchange's outcome."""

    def ask(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        """Send a request. ``sequential``: not while another one to the unit is unanswered."""
        ...

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        """Send function code and data whose answer is of no interest."""
        ...

    def reset(self, address: str) -> None:
        """Close every connection to an address; the next request opens a new one at once."""
        ...

    def release(self, unit: ModbusUnit) -> None:
        """No signal uses this unit any longer."""
        ...


class NoModbusNetwork:
    """Backend of a controller without servers: the network is unreachable."""

    def ask(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = ModbusExchange()
        exchange.complete(connection_error=errno.ENETUNREACH)
        return exchange

    def send(self, unit: ModbusUnit, pdu: bytes) -> None: ...

    def reset(self, address: str) -> None: ...

    def release(self, unit: ModbusUnit) -> None: ...


_BITS: Final = (Function.READ_COILS, Function.READ_DISCRETE_INPUTS, Function.WRITE_COIL, Function.WRITE_COILS)


@dataclass
class MemoryUnit:
    """A unit made of memory. ``broken``: the exception code it answers everything with."""

    coils: dict[int, int] = field(default_factory=dict)
    registers: dict[int, int] = field(default_factory=dict)
    broken: int = 0
    requests: list[ModbusRequest] = field(default_factory=list)
    commands: list[bytes] = field(default_factory=list)

    def answer(self, request: ModbusRequest, exchange: ModbusExchange) -> None:
        """Carry a request out; coils and discrete inputs are one table, so are the registers."""
        self.requests.append(request)
        table = self.coils if request.function in _BITS else self.registers
        rw = request.function == Function.READ_WRITE_REGISTERS
        start = request.write_address if rw else request.address
        if self.broken:
            exchange.complete(device_error=self.broken)
            return
        table.update(enumerate(request.values, start))
        if request.values and not rw:
            exchange.complete()
            return
        wanted = range(request.address, request.address + request.count)
        if all(address in table for address in wanted):
            exchange.complete(tuple(table[address] for address in wanted))
        else:
            exchange.complete(device_error=ExceptionCode.ILLEGAL_DATA_ADDRESS)


class MemoryModbus:
    """Backend for tests: answers at once for the units it has, refuses to connect to others.

    ``silent``: units that do not answer until they are taken from it by ``speak``.
    """

    def __init__(self) -> None:
        self.units: dict[ModbusUnit, MemoryUnit] = {}
        self.silent: set[ModbusUnit] = set()
        self.released: list[ModbusUnit] = []
        self.resets: list[str] = []
        self._waiting: list[tuple[ModbusUnit, ModbusRequest, ModbusExchange]] = []

    def ask(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = ModbusExchange()
        if unit in self.silent:
            self._waiting.append((unit, request, exchange))
        elif unit in self.units:
            self.units[unit].answer(request, exchange)
        else:
            exchange.complete(connection_error=errno.ECONNREFUSED)
        return exchange

    def speak(self, unit: ModbusUnit) -> None:
        """Answer what a silent unit was asked, and everything from now on."""
        self.silent.discard(unit)
        for asked, request, exchange in self._waiting:
            if asked == unit:
                self.units[unit].answer(request, exchange)

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        if unit in self.units:
            self.units[unit].commands.append(pdu)

    def reset(self, address: str) -> None:
        self.resets.append(address)

    def release(self, unit: ModbusUnit) -> None:
        self.released.append(unit)
