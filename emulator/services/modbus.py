"""Modbus signals: the values of other devices that programs read and set by name.

A signal polls its unit at its frequency, one request at a time: an input reads; an output
reads until a program sets it, and writes from then on. Signals belong to the controller, not
to the program that added them: installers add them in a separate secondary program, and the
next program uses them.

A signal whose last request failed is in error. It keeps its last value for the time of its
watchdog; after that, reading or setting it ends the program.
"""

import errno
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

from emulator.services.outputs import OutputAction, level_at_end, level_at_start, output_action
from urproto.modbus import Function, ModbusRequest
from urproto.versions import Series

# Connection errors in addition to errno. Script Manual, modbus_get_error; CONNECTING: another maker's manual
CONNECTING: Final = -1
DISCONNECTED: Final = -2
_DEFAULT_FREQUENCY_HZ: Final = 10  # PolyScope's default
_MAX_FREQUENCY_HZ: Final = 500  # Script Manual
_DEFAULT_WATCHDOG_S: Final = 2.0  # Script Manual, modbus_set_signal_watchdog
_MAX_WATCHDOG_S: Final = 300.0  # Script Manual
_MAX_NAME: Final = 20  # characters; Script Manual
_MAX_VALUES: Final = 123  # Script Manual, register_count
_MAX_WRITTEN: Final = 121  # by function 23: Modbus Application Protocol; the Script Manual says 123
_MAX_SIGNALS: Final = 500  # guess: bounds the cost of polling in a control period
_MAX_WORD: Final = 0xFFFF
_F = Function


class ModbusUnit(NamedTuple):
    """A polled unit: an address and the unit's number behind it. The rest, such as the port, is up to the backend."""

    address: str
    slave: int


class ModbusExchange:
    """A request in progress. ``device_error``: the unit's exception code; ``connection_error``: errno or negative."""

    __slots__ = ("connection_error", "device_error", "done", "values")

    def __init__(self) -> None:
        self.done = False
        self.values: tuple[int, ...] = ()
        self.device_error = 0
        self.connection_error = 0

    def complete(self, values: tuple[int, ...] = (), *, device_error: int = 0, connection_error: int = 0) -> None:
        """Set the outcome; later ones are ignored."""
        if not self.done:
            self.done, self.values = True, values
            self.device_error, self.connection_error = device_error, connection_error


class ModbusBackend(Protocol):
    """Connections to units. No method fails or waits: errors are outcomes of the exchange."""

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        """Send a request. ``sequential``: not while another one to the unit is unanswered."""

    def send(self, unit: ModbusUnit, pdu: bytes) -> None:
        """Send function code and data; the answer is ignored."""

    def reset(self, address: str) -> None:
        """Close all connections to an address; the next request immediately opens a new one."""

    def release(self, unit: ModbusUnit) -> None:
        """No signal uses this unit any longer."""


class NoModbusNetwork:
    """Backend of a controller without servers: the network is unreachable."""

    def request(self, unit: ModbusUnit, request: ModbusRequest, *, sequential: bool) -> ModbusExchange:
        exchange = ModbusExchange()
        exchange.complete(connection_error=errno.ENETUNREACH)
        return exchange

    def send(self, unit: ModbusUnit, pdu: bytes) -> None: ...

    def reset(self, address: str) -> None: ...

    def release(self, unit: ModbusUnit) -> None: ...


class ModbusSignalError(ValueError):
    """An operation on a Modbus signal is not possible."""


@dataclass(frozen=True, slots=True)
class SignalType:
    """One kind of signal: whether its values are bits, and the functions that read and write one or several."""

    title: str
    bits: bool
    read: Function
    write_one: Function | None = None
    write_many: Function | None = None


# Script Manual, modbus_add_signal; 23 is modbus_add_rw_signal's.
SIGNAL_TYPES: Final[dict[int, SignalType]] = {
    0: SignalType("digital input", True, _F.READ_DISCRETE_INPUTS),
    1: SignalType("digital output", True, _F.READ_COILS, _F.WRITE_COIL, _F.WRITE_COILS),
    2: SignalType("register input", False, _F.READ_INPUT_REGISTERS),
    3: SignalType("register output", False, _F.READ_HOLDING_REGISTERS, _F.WRITE_REGISTER, _F.WRITE_REGISTERS),
    15: SignalType("digital output", True, _F.READ_COILS, _F.WRITE_COILS, _F.WRITE_COILS),
    16: SignalType("register output", False, _F.READ_HOLDING_REGISTERS, _F.WRITE_REGISTERS, _F.WRITE_REGISTERS),
    23: SignalType(
        "register output", False, _F.READ_HOLDING_REGISTERS, _F.READ_WRITE_REGISTERS, _F.READ_WRITE_REGISTERS
    ),
}
# e-Series manuals let type 1 write by function 15, the CB3 user manual by 5
_E_SERIES_DIGITAL_OUTPUT: Final = SignalType("digital output", True, _F.READ_COILS, _F.WRITE_COILS, _F.WRITE_COILS)


class ModbusSignal:
    """One signal. ``values``: bits or words as last read or set, zeros before that."""

    def __init__(
        self, name: str, unit: ModbusUnit, kind: SignalType, address: int, count: int, *, sequential: bool, step: int
    ) -> None:
        self.name = name
        self.unit = unit
        self.kind = kind
        self.sequential = sequential
        self.count = count
        self.write_address = address
        self.write_count = count
        self.frequency_hz = _DEFAULT_FREQUENCY_HZ
        self.watchdog_s = _DEFAULT_WATCHDOG_S
        self.runstate_choice = OutputAction.KEEP
        self.values: tuple[int, ...] = (0,) * count
        self.wanted: tuple[int, ...] | None = None
        self.device_error = 0
        self.connection_error = CONNECTING
        self.valid_step = step  # time of the last successful request; at first, when the signal was added
        self._read = ModbusRequest(kind.read, address, count)
        self._exchange: ModbusExchange | None = None
        self._due = step

    @property
    def in_error(self) -> bool:
        """Whether the last request failed or none has been answered yet."""
        return bool(self.device_error or self.connection_error)

    @property
    def output(self) -> bool:
        """Whether programs may set it."""
        return self.kind.write_one is not None

    @property
    def settled(self) -> bool:
        """Whether no request is in progress or due."""
        return self._exchange is None and self._due < 0

    def set(self, values: Sequence[int]) -> None:
        """Write these values from now on; values beyond them stay as they are. Raises ModbusSignalError."""
        if not 1 <= len(values) <= self.write_count:
            raise ModbusSignalError(f'"{self.name}" takes 1 to {self.write_count} values, not {len(values)}')
        before = self.wanted
        if before is None:  # what function 23 writes is not what it reads
            before = self.values if self.write_count == self.count else (0,) * self.write_count
        self.wanted = (*values, *before[len(values) :])
        if self.kind.write_one is not Function.READ_WRITE_REGISTERS:
            self.values = self.wanted

    def poll_now(self, step: int) -> None:
        self._due = step

    def due_since(self, step: int) -> int | None:
        """Process an answer; returns the step since which a request is due, None if none is."""
        exchange = self._exchange
        if exchange is not None:
            if not exchange.done:
                return None
            self._take(exchange, step)
        return self._due if 0 <= self._due <= step else None

    def send_request(self, step: int, frames_a_second: float, backend: ModbusBackend) -> None:
        self._due = self._next_turn(step, frames_a_second)
        self._exchange = backend.request(self.unit, self._request(), sequential=self.sequential)

    def _next_turn(self, step: int, frames_a_second: float) -> int:
        if self.frequency_hz <= 0:
            return -1
        return step + max(1, round(frames_a_second / self.frequency_hz))

    def _request(self) -> ModbusRequest:
        wanted = self.wanted
        if wanted is None:
            return self._read
        function = self.kind.write_one if len(wanted) == 1 else self.kind.write_many
        assert function is not None, "only outputs are set"
        if function is Function.READ_WRITE_REGISTERS:
            return ModbusRequest(function, self._read.address, self.count, wanted, self.write_address)
        return ModbusRequest(function, self.write_address, len(wanted), wanted)

    def _take(self, exchange: ModbusExchange, step: int) -> None:
        self._exchange = None
        self.device_error, self.connection_error = exchange.device_error, exchange.connection_error
        if self.in_error:
            return
        self.valid_step = step
        # the answer to a read of an output that a program has set since is obsolete
        if exchange.values and (self.wanted is None or self.kind.write_one is Function.READ_WRITE_REGISTERS):
            self.values = exchange.values


class ModbusSignals:
    """All signals of the controller by name. ``backend``: the connections to their units."""

    def __init__(self, series: Series) -> None:
        self.backend: ModbusBackend = NoModbusNetwork()
        self._series = series
        self._frames_a_second = float(series.frequency_hz)
        self._signals: dict[str, ModbusSignal] = {}
        self._step = 0
        self._program_runs = False

    def __len__(self) -> int:
        return len(self._signals)

    def is_high(self, name: str) -> bool:
        """Whether a digital signal was high when its unit last answered; False while it is in error."""
        signal = self._signals.get(name)
        return signal is not None and not signal.in_error and any(signal.values)

    def get(self, name: str) -> ModbusSignal:
        """The signal of that name. Raises ModbusSignalError."""
        signal = self._signals.get(name)
        if signal is None:
            raise ModbusSignalError(f'there is no Modbus signal "{name}": add it with modbus_add_signal() first')
        return signal

    def add(
        self, unit: ModbusUnit, type_: int, address: int, count: int, name: str, *, sequential: bool
    ) -> ModbusSignal:
        """Add a signal; one of the same name is replaced. Raises ModbusSignalError."""
        _check_unit(unit)
        if not 1 <= len(name) <= _MAX_NAME:
            raise ModbusSignalError(f"a Modbus signal's name must have 1 to {_MAX_NAME} characters, not {len(name)}")
        _check_span(address, count)
        if name not in self._signals and len(self._signals) >= _MAX_SIGNALS:
            raise ModbusSignalError(f"there are already {_MAX_SIGNALS} Modbus signals: delete some")
        kind = _E_SERIES_DIGITAL_OUTPUT if type_ == 1 and self._series is Series.E else SIGNAL_TYPES[type_]
        old = self._signals.pop(name, None)
        signal = ModbusSignal(name, unit, kind, address, count, sequential=sequential, step=self._step)
        self._signals[name] = signal
        self._release(old)
        return signal

    def add_read_write(
        self, unit: ModbusUnit, read: tuple[int, int], write: tuple[int, int], name: str, *, sequential: bool
    ) -> ModbusSignal:
        """Add a signal that reads and writes registers; spans are (address, count). Raises ModbusSignalError."""
        _check_span(*write)
        if write[1] > _MAX_WRITTEN:
            raise ModbusSignalError(f"function 23 writes at most {_MAX_WRITTEN} registers, not {write[1]}")
        signal = self.add(unit, 23, *read, name, sequential=sequential)
        signal.write_address, signal.write_count = write
        return signal

    def delete(self, name: str) -> None:
        """Remove a signal; an unknown one is ignored, as programs delete before they add."""
        self._release(self._signals.pop(name, None))

    def _release(self, signal: ModbusSignal | None) -> None:
        if signal is not None and all(other.unit != signal.unit for other in self._signals.values()):
            self.backend.release(signal.unit)

    # requests of programs

    def readable(self, name: str) -> ModbusSignal:
        """The signal of that name. Raises ModbusSignalError, also if its watchdog has expired."""
        signal = self.get(name)
        if self.invalid_s(signal) > signal.watchdog_s:
            reason = f"connection error {signal.connection_error}, device error {signal.device_error}"
            raise ModbusSignalError(
                f'Modbus signal "{name}" has been invalid for more than {signal.watchdog_s:g} s ({reason}):'
                f" check unit {signal.unit.slave} at {signal.unit.address}"
            )
        return signal

    def set(self, name: str, values: Sequence[int], *, bits: bool) -> None:
        """Set an output. Raises ModbusSignalError."""
        signal = self.readable(name)
        if not signal.output or signal.kind.bits is not bits:
            wanted = "digital" if bits else "register"
            raise ModbusSignalError(f'"{name}" is a {signal.kind.title}, not a {wanted} output')
        if any(not 0 <= value <= _MAX_WORD for value in values):
            raise ModbusSignalError(f'"{name}" takes words from 0 to {_MAX_WORD}')
        self._write(signal, values)

    def set_frequency(self, name: str, frequency_hz: int) -> None:
        """Set the polling frequency; 0 and -1: only on request of a program. Raises ModbusSignalError."""
        if not -1 <= frequency_hz <= _MAX_FREQUENCY_HZ:
            raise ModbusSignalError(
                f"the update frequency must be 0 to {_MAX_FREQUENCY_HZ} Hz, or -1, not {frequency_hz}"
            )
        signal = self.get(name)
        signal.frequency_hz = frequency_hz
        signal.poll_now(self._step)  # this also reads the first value of a signal on demand

    def set_watchdog(self, name: str, timeout_s: float) -> None:
        """Set how long errors are tolerated. Raises ModbusSignalError."""
        if not 0 <= timeout_s <= _MAX_WATCHDOG_S:
            raise ModbusSignalError(f"the watchdog time must be 0 to {_MAX_WATCHDOG_S:g} s, not {timeout_s}")
        self.get(name).watchdog_s = float(timeout_s)

    def set_runstate_choice(self, name: str, choice: int) -> None:
        """Let an output follow the run state. Raises ModbusSignalError."""
        signal = self.get(name)
        if not signal.output:
            raise ModbusSignalError(f'"{name}" is a {signal.kind.title}: only outputs follow the program')
        action = signal.runstate_choice = self._action(choice)
        self._drive(signal, level_at_start(action) if self._program_runs else level_at_end(action, unscheduled=False))

    def request_update(self, name: str) -> ModbusSignal:
        """Poll the unit as soon as possible, whatever the frequency. Raises ModbusSignalError."""
        signal = self.get(name)
        signal.poll_now(self._step)
        return signal

    def pending(self, signal: ModbusSignal) -> bool:
        """Whether a program's request for a signal on demand is unanswered."""
        return self._signals.get(signal.name) is signal and signal.frequency_hz <= 0 and not signal.settled

    def invalid_s(self, signal: ModbusSignal) -> float:
        """Time since the last successful request [s]; 0 if the signal is valid."""
        return (self._step - signal.valid_step) / self._frames_a_second if signal.in_error else 0.0

    def send_command(self, unit: ModbusUnit, function: int, data: bytes) -> None:
        """Send a request of any kind; its answer is ignored. Raises ModbusSignalError."""
        _check_unit(unit)
        self.backend.send(unit, bytes((function,)) + data)

    def reset(self, address: str) -> list[ModbusSignal]:
        """Reconnect to all units at an address; their signals are in error until they are answered."""
        signals = [signal for signal in self._signals.values() if signal.unit.address == address]
        self.backend.reset(address)
        for signal in signals:
            signal.connection_error = CONNECTING
            signal.poll_now(self._step)
        return signals

    def recovering(self, signals: Sequence[ModbusSignal]) -> bool:
        """Whether one of the signals is in error; signals on demand are polled again."""
        in_error = [signal for signal in signals if signal.in_error and self._signals.get(signal.name) is signal]
        for signal in in_error:
            if signal.settled:
                signal.poll_now(self._step)
        return bool(in_error)

    # once a control period

    def step(self, step: int) -> None:
        """Advance one control period: per unit, only the signal whose request has been due longest is polled.

        Simple units lose requests that arrive together.
        """
        self._step = step
        if not self._signals:
            return
        first: dict[ModbusUnit, tuple[int, ModbusSignal]] = {}
        for signal in self._signals.values():
            since = signal.due_since(step)
            if since is not None and (signal.unit not in first or since < first[signal.unit][0]):
                first[signal.unit] = (since, signal)
        for _, signal in first.values():
            signal.send_request(step, self._frames_a_second, self.backend)

    def program_started(self) -> None:
        self._program_runs = True
        for signal in self._signals.values():
            self._drive(signal, level_at_start(signal.runstate_choice))

    def program_stopped(self, *, unscheduled: bool) -> None:
        """The main program is over. ``unscheduled``: by a runtime error, a protective stop, fault or violation."""
        self._program_runs = False
        for signal in self._signals.values():
            self._drive(signal, level_at_end(signal.runstate_choice, unscheduled=unscheduled))

    def _action(self, choice: int) -> OutputAction:
        try:
            return output_action(choice, self._series, power=False)
        except ValueError as error:
            raise ModbusSignalError(str(error)) from None

    def _drive(self, signal: ModbusSignal, level: bool | None) -> None:
        if level is not None:  # a register is 0 or, a guess, 1
            self._write(signal, (int(level),) * signal.write_count)

    def _write(self, signal: ModbusSignal, values: Sequence[int]) -> None:
        signal.set(values)
        if signal.frequency_hz <= 0:
            signal.poll_now(self._step)


def _check_unit(unit: ModbusUnit) -> None:
    if not unit.address:
        raise ModbusSignalError("the address of a Modbus unit must not be empty")
    if not 0 <= unit.slave <= 255:
        raise ModbusSignalError(f"the number of a Modbus unit must be 0 to 255, not {unit.slave}")


def _check_span(address: int, count: int) -> None:
    if not 1 <= count <= _MAX_VALUES:
        raise ModbusSignalError(f"a Modbus signal must have 1 to {_MAX_VALUES} values, not {count}")
    if not 0 <= address <= _MAX_WORD + 1 - count:
        raise ModbusSignalError(
            f"Modbus address {address} with {count} values is out of range: addresses are 0 to {_MAX_WORD}"
        )
