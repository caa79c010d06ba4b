"""The ways by which anything enters a controller: `DOORS`. Each is recorded and replayed by a pair of stand-ins here.

Commands and verbs are passed on as they come; what programs and the tool receive is looked at once per control period,
before it, when the controller may first see it.
"""

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any, Final

from emulator.devices.tool_line import SerialDevice, SerialSettings
from emulator.services.modbus import DISCONNECTED, ModbusBackend, ModbusExchange, ModbusUnit
from emulator.services.sockets import ScriptSocket, ScriptSocketBackend, SocketState
from urproto.modbus import ModbusRequest

DOORS: Final = {
    "post": "a command of a client of any port, with its place in the order of all of them",
    "verb": "a verb of the control API, among them faults; `left`: its caller has given up waiting",
    "socket": "what a socket of a program has received, and its state",
    "unsent": "data that a socket of a program did not take",
    "modbus": "the outcome of a request to a Modbus unit",
    "tool": "bytes from the device on the tool's serial line",
    "file": "a program, installation or such that has changed since the start",
    "reboot": "the controller was switched off and on by a fault",
}
"""Kinds of records, and what they contain. Everything else follows from them and from the first record."""

_NOT_REPEATED: Final = frozenset({"actual_execution_time", "messages"})  # values of a snapshot

Write = Callable[..., None]
"""Writes a record: its kind, and what belongs to it."""


class RecordedSockets:
    """Opens sockets of programs with another backend, and records what they receive."""

    def __init__(self, backend: ScriptSocketBackend, write: Write, opened: int = 0) -> None:
        self.count = opened  # so far in the run, also with another backend
        self._backend = backend
        self._write = write
        self._opened: list[_RecordedSocket] = []

    @property
    def idle(self) -> bool:
        return not self._opened

    def open(self, address: str, port: int) -> ScriptSocket:
        opened = _RecordedSocket(self._backend.open(address, port), self.count, self._write)
        self._write("socket", self.count, opened.state, opened.failure, b"")
        self.count += 1
        self._opened.append(opened)
        return opened

    def look(self) -> None:
        """Before a control period: record what has changed since the last one."""
        for socket in self._opened:
            socket.look()

    def rest(self) -> None:
        for socket in self._opened:
            socket.rest()
        if any(socket.over for socket in self._opened):
            self._opened = [socket for socket in self._opened if not socket.over]


class _RecordedSocket:
    def __init__(self, socket: ScriptSocket, number: int, write: Write) -> None:
        self.inbox = socket.inbox
        self._socket = socket
        self._number = number
        self._write = write
        self._known = len(socket.inbox)  # bytes that were in the inbox after the last period
        self._sends = 0
        self.state: SocketState = socket.state
        self.failure = socket.failure

    @property
    def over(self) -> bool:
        return self.state == "closed"

    def look(self) -> None:
        state, inbox = self._socket.state, self.inbox
        if state != self.state or len(inbox) != self._known:
            self.state, self.failure = state, self._socket.failure
            self._write("socket", self._number, state, self.failure, bytes(inbox[self._known :]))

    def rest(self) -> None:
        self._known = len(self.inbox)

    def send(self, data: bytes) -> bool:
        sent = self._socket.send(data)
        if not sent and self.state == "open":
            self._write("unsent", self._number, self._sends)
        self._sends += 1
        return sent

    def close(self) -> None:
        self._socket.close()
        self.state = "closed"


class ReplayedSockets:
    """Sockets that receive what was recorded. opened: before the beginning, all closed since."""

    def __init__(self, opened: int = 0) -> None:
        self._unsent: set[tuple[int, int]] = set()
        self._opened = [_ReplayedSocket(number, "closed", "", self._unsent) for number in range(opened)]
        self._first: deque[tuple[SocketState, str]] = deque()  # of the sockets that will be opened next

    def open(self, address: str, port: int) -> ScriptSocket:
        state, failure = self._first.popleft() if self._first else ("closed", "it was not opened in the recorded run")
        socket = _ReplayedSocket(len(self._opened), state, failure, self._unsent)
        self._opened.append(socket)
        return socket

    def expect(self, number: int, state: SocketState, failure: str, data: bytes) -> None:
        """Take a record about a socket that is open, or will be opened in the next period."""
        if number >= len(self._opened):
            self._first.append((state, failure))
            return
        socket = self._opened[number]
        socket.state, socket.failure = state, failure
        socket.inbox += data

    def refuse(self, number: int, send: int) -> None:
        """Take a record about data that a socket did not take: of its sends, by number."""
        self._unsent.add((number, send))

    def close_all(self) -> None:
        """Close every socket: from now on, nobody is at the other end."""
        for socket in self._opened:
            socket.close()


class _ReplayedSocket:
    def __init__(self, number: int, state: SocketState, failure: str, unsent: set[tuple[int, int]]) -> None:
        self.inbox = bytearray()
        self.state: SocketState = state
        self.failure = failure
        self._number = number
        self._unsent = unsent
        self._sends = 0

    def send(self, data: bytes) -> bool:
        place, self._sends = (self._number, self._sends), self._sends + 1
        return self.state == "open" and place not in self._unsent

    def close(self) -> None:
        self.state = "closed"


class RecordedModbus:
    """Sends requests with another backend, and records their outcomes."""

    def __init__(self, backend: ModbusBackend, write: Write, requested: int = 0) -> None:
        self.count = requested  # so far in the run
        self._backend = backend
        self._write = write
        self._waiting: list[tuple[int, ModbusExchange]] = []

    @property
    def idle(self) -> bool:
        return not self._waiting

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = self._backend.request(unit, request, sequential=sequential)
        self._waiting.append((self.count, exchange))
        self.count += 1
        if exchange.done:
            self.look()
        return exchange

    def look(self) -> None:
        """Before a control period: record the outcomes since the last one."""
        if self._waiting and any(exchange.done for _, exchange in self._waiting):
            for number, one in self._waiting:
                if one.done:
                    self._write("modbus", number, one.values, one.device_error, one.connection_error)
            self._waiting = [(number, exchange) for number, exchange in self._waiting if not exchange.done]

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        self._backend.send(unit, pdu)

    def reset(self, address: str) -> None:
        self._backend.reset(address)

    def release(self, unit: ModbusUnit) -> None:
        self._backend.release(unit)


class ReplayedModbus:
    """Requests whose outcomes are those that were recorded. requested: before the beginning."""

    def __init__(self, requested: int = 0) -> None:
        self._exchanges: dict[int, ModbusExchange] = {}
        self._outcomes: dict[int, tuple[tuple[int, ...], int, int]] = {}  # known before the request was sent
        self._count = requested

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = ModbusExchange()
        number, self._count = self._count, self._count + 1
        self._exchanges[number] = exchange
        if number in self._outcomes:
            self.expect(number, *self._outcomes.pop(number))
        return exchange

    def expect(self, number: int, values: tuple[int, ...], device_error: int, connection_error: int) -> None:
        if number not in self._exchanges:
            self._outcomes[number] = values, device_error, connection_error
            return
        exchange = self._exchanges.pop(number)
        exchange.complete(values, device_error=device_error, connection_error=connection_error)

    def close_all(self) -> None:
        """No request is answered any more."""
        for exchange in self._exchanges.values():
            exchange.complete(connection_error=DISCONNECTED)
        self._exchanges.clear()

    def send(self, unit: ModbusUnit, pdu: bytes) -> None: ...

    def reset(self, address: str) -> None: ...

    def release(self, unit: ModbusUnit) -> None: ...


class RecordedDevice:
    """A device on the tool's serial line, of which everything that it sends is recorded."""

    def __init__(self, device: SerialDevice, write: Write) -> None:
        self._device = device
        self._write = write

    def configure(self, settings: SerialSettings) -> None:
        self._device.configure(settings)

    def write(self, data: bytes) -> None:
        self._device.write(data)

    def read(self, most: int) -> bytes:
        if data := self._device.read(most):
            self._write("tool", data)
        return data


class ReplayedDevice:
    """A device that sends what was recorded. periods: how many control periods are over."""

    def __init__(self, periods: Callable[[], int]) -> None:
        self._periods = periods
        self._due: dict[int, deque[bytes]] = defaultdict(deque)

    def configure(self, settings: SerialSettings) -> None: ...

    def write(self, data: bytes) -> None: ...

    def expect(self, period: int, data: bytes) -> None:
        """Take what is read in a control period."""
        self._due[period].append(data)

    def read(self, most: int) -> bytes:
        due = self._due.get(self._periods())
        return due.popleft() if due else b""


def plain_values(snapshot: Any) -> dict[str, Any]:
    """The values of a snapshot that a replay must repeat, in a form for JSON.

    Not how long computing took, which is the machine's, nor messages, which the log has.
    """
    return {name: _plain(value) for name, value in snapshot.values().items() if name not in _NOT_REPEATED}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value.hex() if isinstance(value, bytes) else value
