"""Program state and program threads messages for the primary clients, once every 100 ms.

Work and bytes per cycle are bounded for any program: values that do not fit into one cycle follow in the next ones, and
a value that is too large for a message is truncated.
"""

import math
from dataclasses import dataclass
from typing import Final

from emulator.programs.runner import Programs
from emulator.programs.view import ProgramView
from urproto.primary.messages import ProgramThread, ProgramThreadsMessage
from urproto.primary.program_state import (
    GlobalVariableNames,
    GlobalVariableValues,
    MatrixValue,
    PoseValue,
    Value,
    has_matrices,
)
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion
from urscript import values as script
from urscript.values import cut_text

_MESSAGE: Final = 2000  # bytes; one public client has a buffer of 2048, another accepts no size above 2000
_CYCLE: Final = 2000  # bytes of values in a cycle, rounded up to a complete message: about 0.3 ms of work (guess)
_HEADER: Final = 16  # bytes of a message before its names or values
_SMALLEST: Final = 28  # bytes that must be left in a message to add another item to a list
_MAX_VARIABLES: Final = 65536  # an index has two bytes in the message
_LONGEST_LABEL: Final = 255  # bytes (guess)
_FLOAT32_MAX: Final = 3.4028234e38


@dataclass(frozen=True, slots=True)
class ProgramReport:
    """The packages of one cycle. ``names``: for clients that do not know the program, all of them if it is ``new``."""

    new: bool
    names: bytes
    state: bytes


class ProgramReporter:
    """Reports the main program to clients that get their states at the same moments."""

    def __init__(self, programs: Programs, version: PolyscopeVersion) -> None:
        self._programs = programs
        self._version = version
        self._fitter = _Fitter(has_matrices(version))
        self._announced = 0  # number of the program whose names were sent
        self._reported_end = 0  # number of the last program whose end was reported
        self._names = b""
        self._cursor = 0  # index of the first variable of the next cycle

    def first_client_connected(self) -> None:
        """Call when the first client connects: a program that has ended is not reported to it."""
        view = self._programs.view
        if view is not None and not view.running:
            self._reported_end = view.number

    def cycle(self, time_us: int) -> ProgramReport | None:
        """Return the report of this cycle; None without a program. A program that has ended is reported once more."""
        view = self._programs.view
        if view is None or view.number == self._reported_end:
            return None
        new = view.number != self._announced
        if new:
            self._announced, self._cursor = view.number, 0
            self._names = self._encode_names(view.names)
        if not view.running:
            self._reported_end, self._cursor = view.number, 0
        return ProgramReport(new, self._names, self._threads(view, time_us) + self._values(view))

    def _encode_names(self, names: tuple[str, ...]) -> bytes:
        messages = []
        start, size = 0, _HEADER
        for index, name in enumerate(names[:_MAX_VARIABLES]):
            if size + len(name) + 1 > _MESSAGE and index > start:
                messages.append(GlobalVariableNames(start_index=start, names=names[start:index]))
                start, size = index, _HEADER
            size += len(name) + 1  # a name is ASCII
        if names:
            messages.append(GlobalVariableNames(start_index=start, names=names[start:_MAX_VARIABLES]))
        return b"".join([message.encode(self._version) for message in messages])

    def _threads(self, view: ProgramView, time_us: int) -> bytes:
        if not view.labelled:
            return b""
        threads, size = [], _HEADER
        for thread in view.threads:
            label = cut_text(thread.label, _LONGEST_LABEL)
            shown = ProgramThread(thread.label_id, label, cut_text(thread.name, _LONGEST_LABEL))
            size += 12 + len(to_bytes(shown.label)) + len(to_bytes(shown.name))
            if size > _MESSAGE:
                break
            threads.append(shown)
        return ProgramThreadsMessage(timestamp_us=time_us, threads=tuple(threads)).encode(self._version)

    def _values(self, view: ProgramView) -> bytes:
        """Return messages with as many values as fit into a cycle, from the cursor on, each variable at most once."""
        count = min(len(view.names), _MAX_VARIABLES)
        if not count:  # a simulator sends it for a program without variables too
            return GlobalVariableValues(values=()).encode(self._version)
        messages: list[bytes] = []
        left, size = count, 0
        while left and size < _CYCLE:
            values = self._message(view, min(count, self._cursor + left))
            message = GlobalVariableValues(start_index=self._cursor, values=tuple(values)).encode(self._version)
            messages.append(message)
            size += len(message)
            left -= len(values)
            self._cursor = (self._cursor + len(values)) % count
        return b"".join(messages)

    def _message(self, view: ProgramView, stop: int) -> list[Value]:
        """Return the values of one message, at least one."""
        room = _MESSAGE - _HEADER
        fitted: list[Value] = []
        for value in view.values(self._cursor, min(stop, self._cursor + room // 2)):
            cut, size = self._fitter.fit(value, _MESSAGE - _HEADER - 1)
            room -= size + 1  # the line feed
            if room < 0 and fitted:
                break
            fitted.append(cut)
        return fitted


class _Fitter:
    """Converts values of URScript to those of the message, truncated to a size in bytes."""

    def __init__(self, matrices: bool) -> None:
        self._matrices = matrices
        self._room = 0

    def fit(self, value: script.Value, room: int) -> tuple[Value, int]:
        """Return the value, truncated to at most ``room`` bytes, and its size in bytes."""
        self._room = room
        return self._fit(value), room - self._room

    def _fit(self, value: script.Value) -> Value:
        kind = value.__class__
        if kind is float:
            self._room -= 5
            return _float32(value)
        if kind is bool:
            self._room -= 2
            return bool(value)
        if kind is int:
            self._room -= 5
            return int(value) if script.INT_MIN <= value <= script.INT_MAX else _float32(float(value))
        if kind is script.Pose:
            self._room -= 25
            return PoseValue(tuple(map(_float32, value)))
        if isinstance(value, list):
            return self._list(value)
        if kind is script.Matrix:
            return self._matrix(value) if self._matrices else self._list(list(map(list, value.rows)))
        if value is None:
            self._room -= 1
            return None
        return self._text(value)  # the encoding of a struct is not known: its text is sent

    def _text(self, value: script.Value) -> str:
        text = cut_text(value, self._room - 3)
        self._room -= 3 + len(to_bytes(text))
        return text

    def _list(self, items: list[script.Value]) -> Value:
        self._room -= 3
        fitted = []
        for item in items:
            if self._room < _SMALLEST:
                break
            fitted.append(self._fit(item))
        return tuple(fitted)

    def _matrix(self, matrix: script.Matrix) -> Value:
        self._room -= 5
        columns = matrix.shape[1]
        rows = min(len(matrix.rows), self._room // (5 * columns)) if columns else 0
        return MatrixValue(tuple(tuple(map(self._fit, row)) for row in matrix.rows[:rows]))


def _float32(value: float) -> float:
    """Return the value, or infinity outside the range of a 32-bit float."""
    return math.copysign(math.inf, value) if abs(value) > _FLOAT32_MAX else float(value)
