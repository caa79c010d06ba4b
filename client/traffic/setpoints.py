"""The setpoints that clients stream to a robot, and the states that the robot sends meanwhile, as arrays over time."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.traffic.recording import Conversation, TrafficRecording
from client.traffic.rtde_log import RecordedRecipe, RTDELog
from urproto.errors import RemoteProtocolError
from urproto.external_control import ControlMode, ReverseMessage

Array = NDArray[np.float64]

_REVERSE_PORT: Final = 50001
_RTDE_PORT: Final = 30004
_SCRIPT_PORTS: Final = (30001, 30002, 30003)
_MODES: Final[Mapping[ControlMode, str]] = {
    ControlMode.SERVOJ: "joint positions",
    ControlMode.SPEEDJ: "joint speeds",
    ControlMode.SPEEDL: "tool speeds",
    ControlMode.POSE: "tool poses",
    ControlMode.TORQUE: "joint torques",
}
_POSITIONS: Final = _MODES[ControlMode.SERVOJ]
_UNKNOWN: Final = "six numbers"
_REGISTER = re.compile(r"input_double_register_(\d+)")
_URRTDE_SERVOJ: Final = 11  # ur_rtde's control script: first register int, the command; doubles 9 and 10 as below
_URRTDE_LOOKAHEAD: Final = 9
_URRTDE_GAIN: Final = 10
_NEAR_RAD: Final = 0.5  # guess: setpoints this close to the arm's joints are joint positions
_FEWEST: Final = 20  # guess: a stream has at least this many setpoints
_LINE = re.compile(rb"^[ \t]*(servoj|servoc|speedj|speedl|movej|movel)[ \t]*\(", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class SetpointStream:
    """Setpoints of one kind on one connection.

    source: the interface and the kind, to display. joints: whether the values are joint positions. time_s (n,): when
    they were sent, since the capture's beginning. values (n, 6): in rad, if joint positions. servo: lookahead time [s]
    and gain of servoj, if the client sends them.
    """

    source: str
    joints: bool
    time_s: Array
    values: Array
    servo: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class SentStates:
    """The states of an RTDE connection, in which the robot sent joint positions.

    time_s (n,): when the robot sent them, on the capture's clock, since its beginning: the robot's time stamps, moved
    by the least delay. arrived_s (n,): when they were captured. values: arrays (n,) or (n, 6), by variable.
    """

    time_s: Array
    arrived_s: Array
    values: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class ScriptLines:
    """Motion commands sent one by one as scripts to a client interface. time_s (n,): since the capture's beginning."""

    port: int
    command: str
    time_s: Array


def streams_and_states(recording: TrafficRecording) -> tuple[list[SetpointStream], SentStates | None]:
    """All streams of a recording, and the longest series of states with the arm's joint positions.

    The streams are in order of the connections. The states are None if no connection has at least two.
    """
    begin_ns, streams = _begin_ns(recording), list[SetpointStream]()
    logs = [RTDELog(one) for one in recording.on_port(_RTDE_PORT)]
    states = _sent_states(logs, begin_ns)
    for one in recording.on_port(_REVERSE_PORT):
        streams += _of_external_control(one, begin_ns, recording.problems)
    for log in logs:
        for recipe in log.inputs:
            streams += _of_registers(recipe, begin_ns, states)
    return streams, states


def script_lines(recording: TrafficRecording) -> list[ScriptLines]:
    """Motion commands that were sent as scripts of a single line, by port and command."""
    begin_ns = _begin_ns(recording)
    times: dict[tuple[int, str], list[int]] = {}
    for one in recording.on_port(*_SCRIPT_PORTS):
        for piece in one.pieces:
            if piece.from_server or b"def " in piece.data:
                continue
            for match in _LINE.finditer(piece.data):
                times.setdefault((one.port, match[1].decode()), []).append(piece.time_ns)
    return [ScriptLines(port, command, _seconds(sent, begin_ns)) for (port, command), sent in sorted(times.items())]


def _begin_ns(recording: TrafficRecording) -> int:
    return min(one.begin_ns for one in recording.conversations)


def _seconds(times_ns: Iterable[int], begin_ns: int) -> Array:
    return np.array([(time_ns - begin_ns) / 1e9 for time_ns in times_ns])


def interpolated(at_s: Array, time_s: Array, values: Array) -> Array:
    """Values (n, joints) at other times, on straight lines between those known."""
    return np.stack([np.interp(at_s, time_s, column) for column in values.T], axis=1)


def _sent_states(logs: Iterable[RTDELog], begin_ns: int) -> SentStates | None:
    needed = {"timestamp", "actual_q"}
    all_outputs = (outputs for log in logs for outputs in log.outputs)
    found = [outputs for outputs in all_outputs if needed <= {*outputs.names} and len(outputs.rows) > 1]
    if not found:
        return None
    # Targets tell more than any number of states.
    outputs = max(found, key=lambda outputs: ("target_q" in outputs.names, len(outputs.rows)))
    values = _columns([outputs.unpack(row.data) for row in outputs.rows], outputs.names)
    arrived_s = _seconds((row.time_ns for row in outputs.rows), begin_ns)
    time_s = values["timestamp"] + np.min(arrived_s - values["timestamp"])
    return SentStates(time_s, arrived_s, values)


def _columns(rows: Sequence[Mapping[str, Any]], names: Iterable[str]) -> dict[str, Array]:
    return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}


def _of_external_control(one: Conversation, begin_ns: int, problems: list[str]) -> Iterator[SetpointStream]:
    """The setpoints of a driver, which is the client of nobody here: the robot connects to it."""
    sent: dict[ControlMode, tuple[list[int], list[tuple[float, ...]]]] = {}
    unread = b""
    try:
        for piece in one.pieces:
            unread += piece.data if piece.from_server else b""
            while len(unread) >= ReverseMessage.SIZE:
                message = ReverseMessage.decode(unread[: ReverseMessage.SIZE])
                unread = unread[ReverseMessage.SIZE :]
                if message.mode in _MODES:
                    times_ns, values = sent.setdefault(message.mode, ([], []))
                    times_ns.append(piece.time_ns)
                    values.append(message.values)
    except RemoteProtocolError as error:
        problems.append(f"External Control: {error}")
    for mode, (times_ns, values) in sent.items():
        if len(times_ns) >= _FEWEST:
            source = f"External Control, {_MODES[mode]}"
            yield SetpointStream(source, mode is ControlMode.SERVOJ, _seconds(times_ns, begin_ns), np.array(values))


def _of_registers(recipe: RecordedRecipe, begin_ns: int, states: SentStates | None) -> Iterator[SetpointStream]:
    """Setpoints in six consecutive input registers; ur_rtde's and other programs' alike."""
    first = _first_of_six(recipe.names)
    if first is None or len(recipe.rows) < _FEWEST:
        return
    rows = [recipe.unpack(row.data) for row in recipe.rows]
    command, lookahead, gain = (
        f"input_int_register_{first}",
        *(f"input_double_register_{first + number}" for number in (_URRTDE_LOOKAHEAD, _URRTDE_GAIN)),
    )
    is_urrtde = {command, lookahead, gain} <= {*recipe.names} and any(row[command] == _URRTDE_SERVOJ for row in rows)
    chosen = [number for number, row in enumerate(rows) if not is_urrtde or row[command] == _URRTDE_SERVOJ]
    if len(chosen) < _FEWEST:
        return
    registers = [f"input_double_register_{first + number}" for number in range(6)]
    values = np.array([[rows[number][name] for name in registers] for number in chosen])
    time_s = _seconds((recipe.rows[number].time_ns for number in chosen), begin_ns)
    joints = is_urrtde or (states is not None and _is_near(values, time_s, states))
    last = rows[chosen[-1]]
    yield SetpointStream(
        "ur_rtde, servoJ"
        if is_urrtde
        else f"RTDE registers {first} to {first + 5}, {_POSITIONS if joints else _UNKNOWN}",
        joints,
        time_s,
        values,
        (last[lookahead], last[gain]) if is_urrtde else None,
    )


def _first_of_six(names: Iterable[str]) -> int | None:
    """The first of six consecutive registers of a recipe."""
    numbers = {int(match[1]) for name in names if (match := _REGISTER.fullmatch(name))}
    return next((number for number in sorted(numbers) if numbers >= {*range(number, number + 6)}), None)


def _is_near(values: Array, time_s: Array, states: SentStates) -> bool:
    there = interpolated(time_s, states.time_s, states.values["actual_q"])
    return bool(np.median(np.max(np.abs(values - there), axis=1)) < _NEAR_RAD)
