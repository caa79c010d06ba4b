"""Networks in memory: what the sockets and the Modbus signals of scripts connect to."""

import errno
from collections.abc import MutableMapping
from dataclasses import dataclass, field

from emulator.services.modbus import ModbusExchange, ModbusUnit
from emulator.services.sockets import SocketState
from urproto.modbus import ExceptionCode, Function, ModbusRequest

_BITS = (Function.READ_COILS, Function.READ_DISCRETE_INPUTS, Function.WRITE_COIL, Function.WRITE_COILS)


class MemorySocket:
    """A connection without a network: ``sent`` contains what the script wrote, ``feed`` is the peer writing."""

    def __init__(self, state: SocketState, failure: str = "") -> None:
        self.inbox = bytearray()
        self.sent = bytearray()
        self.failure = failure
        self._state: SocketState = state

    @property
    def state(self) -> SocketState:
        return self._state

    def accept(self) -> None:
        """The peer takes the connection."""
        if self._state == "connecting":
            self._state = "open"

    def feed(self, data: bytes) -> None:
        """Bytes from the peer."""
        self.inbox += data

    def send(self, data: bytes) -> bool:
        if self._state != "open":
            return False
        self.sent += data
        return True

    def close(self) -> None:
        self._state = "closed"


class MemorySockets:
    """Backend that connects immediately to the addresses in ``listening``, refuses all others.

    ``opened`` lists the connections in order. Addresses in ``silent`` never answer.
    """

    def __init__(self, *listening: tuple[str, int]) -> None:
        self.listening = set(listening)
        self.silent: set[tuple[str, int]] = set()
        self.opened: list[MemorySocket] = []

    def open(self, address: str, port: int) -> MemorySocket:
        where = (address, port)
        state: SocketState = "connecting" if where in self.silent else "open" if where in self.listening else "closed"
        socket = MemorySocket(state, "Connection refused" if state == "closed" else "")
        self.opened.append(socket)
        return socket


@dataclass
class MemoryUnit:
    """A unit in memory. ``broken``: the exception code with which it answers every request."""

    coils: MutableMapping[int, int] = field(default_factory=dict)
    registers: MutableMapping[int, int] = field(default_factory=dict)
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
        for address, value in enumerate(request.values, start):
            table[address] = value
        if request.values and not rw:
            exchange.complete()
            return
        wanted = range(request.address, request.address + request.count)
        if all(address in table for address in wanted):
            exchange.complete(tuple(table[address] for address in wanted))
        else:
            exchange.complete(device_error=ExceptionCode.ILLEGAL_DATA_ADDRESS)


class MemoryModbus:
    """Backend that answers immediately for its units, refuses connections to others.

    ``silent``: units that do not answer until ``speak`` is called.
    """

    def __init__(self) -> None:
        self.units: dict[ModbusUnit, MemoryUnit] = {}
        self.silent: set[ModbusUnit] = set()
        self.released: list[ModbusUnit] = []
        self.resets: list[str] = []
        self._waiting: list[tuple[ModbusUnit, ModbusRequest, ModbusExchange]] = []

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = ModbusExchange()
        if unit in self.silent:
            self._waiting.append((unit, request, exchange))
        elif unit in self.units:
            self.units[unit].answer(request, exchange)
        else:
            exchange.complete(connection_error=errno.ECONNREFUSED)
        return exchange

    def speak(self, unit: ModbusUnit) -> None:
        """Let a silent unit answer its pending requests, and all later ones."""
        self.silent.discard(unit)
        for addressed, request, exchange in self._waiting:
            if addressed == unit:
                self.units[unit].answer(request, exchange)

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        if unit in self.units:
            self.units[unit].commands.append(pdu)

    def reset(self, address: str) -> None:
        self.resets.append(address)

    def release(self, unit: ModbusUnit) -> None:
        self.released.append(unit)
