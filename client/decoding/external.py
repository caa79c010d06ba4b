"""Messages on External Control's ports (50001, 50003, 50004) as text. The driver is the server there."""

from collections.abc import Callable, Iterator
from typing import Any

from client.decoding import formatting
from client.decoding.streams import FramedStream, Framing, Line, Stream
from urproto.external_control import (
    Answer,
    ControlMode,
    FreedriveAction,
    MotionType,
    Query,
    ReplyDecoder,
    ReverseMessage,
    ScriptCommand,
    ScriptCommandKind,
    SplineType,
    TrajectoryAction,
    TrajectoryPoint,
    TrajectoryResult,
    split_greeting,
)
from urproto.modes import mode_name

_LIKELY_TIMEOUT_MS = 60_000  # guess: a longer timeout is not from a message; drivers use 2 ms to a few seconds
_PARAMETERS = {  # number of words that a command uses
    ScriptCommandKind.ZERO_FTSENSOR: 0,
    ScriptCommandKind.SET_PAYLOAD: 4,
    ScriptCommandKind.SET_TOOL_VOLTAGE: 1,
    ScriptCommandKind.START_FORCE_MODE: 27,
    ScriptCommandKind.END_FORCE_MODE: 0,
    ScriptCommandKind.START_TOOL_CONTACT: 0,
    ScriptCommandKind.END_TOOL_CONTACT: 0,
    ScriptCommandKind.FT_RTDE_INPUT_ENABLE: 8,
    ScriptCommandKind.SET_GRAVITY: 3,
    ScriptCommandKind.SET_TCP_OFFSET: 6,
    ScriptCommandKind.SET_FRICTION_COMPENSATION: 1,
    ScriptCommandKind.SET_FRICTION_SCALES: 12,
    ScriptCommandKind.SET_TARGET_PAYLOAD: 11,
    ScriptCommandKind.ARGUMENT: 0,
    ScriptCommandKind.QUERY: 0,
    ScriptCommandKind.SET_STREAM_PARAMETERS: 4,
    ScriptCommandKind.SET_FREEDRIVE_AXES: 12,
    ScriptCommandKind.START_CONTACT_DETECTION: 6,
    ScriptCommandKind.STOP_CONTACT_DETECTION: 0,
    ScriptCommandKind.SET_FORCE_MODE_PARAMETERS: 2,
}
_FLAG_FIRST = (ScriptCommandKind.FT_RTDE_INPUT_ENABLE, ScriptCommandKind.SET_FRICTION_COMPENSATION)


def _fixed(name: str, size: int, decode: Callable[[bytes], Any], likely: Callable[[Any], bool]) -> Framing:
    """Framing for messages of a fixed size, which are recognised only by decoding them."""

    def check(data: bytes) -> int:
        decode(data)
        return size

    return Framing(name, size, check, lambda data: likely(decode(data)))


def _is_result(data: bytes) -> bool:
    ReplyDecoder.decode(data)
    return True


REVERSE = _fixed(
    "reverse interface",
    ReverseMessage.SIZE,
    ReverseMessage.decode,
    lambda message: 0 <= message.read_timeout_ms <= _LIKELY_TIMEOUT_MS,
)
TRAJECTORY = _fixed(
    "trajectory interface",
    TrajectoryPoint.SIZE,
    TrajectoryPoint.decode,
    lambda point: point.duration_s >= 0 and point.blend_radius_m >= 0,
)
COMMANDS = _fixed("script command interface", ScriptCommand.SIZE, ScriptCommand.decode, lambda command: True)
RESULTS = Framing("result", 4, ReplyDecoder.size, _is_result)


def reverse_stream() -> FramedStream:
    """Messages from the driver on the reverse interface."""
    return FramedStream(REVERSE, _reader(ReverseMessage.decode, _reverse))


def trajectory_stream() -> FramedStream:
    """Messages from the driver on the trajectory interface."""
    return FramedStream(TRAJECTORY, _reader(TrajectoryPoint.decode, _point))


def command_stream() -> FramedStream:
    """Messages from the driver on the script command interface."""
    return FramedStream(COMMANDS, _reader(ScriptCommand.decode, _command))


def result_stream() -> Stream:
    """Messages from the robot on the trajectory and script command interfaces."""
    return _GreetedStream(FramedStream(RESULTS, _reader(ReplyDecoder.decode, _reply)))


class _GreetedStream:
    """A stream that may start with the control program's greeting, which is text."""

    def __init__(self, rest: Stream) -> None:
        self._rest = rest
        self._unread: bytes | None = b""  # None once it has been shown, or if there is none

    def feed(self, data: bytes) -> Iterator[Line]:
        if self._unread is not None:
            data = self._unread + data
            if (greeting := split_greeting(data)) is None:
                self._unread = data
                return
            self._unread = None
            token, rest = greeting
            if token is not None:
                yield Line(f"greeting: {formatting.quoted(token)}")
            data = rest
        yield from self._rest.feed(data)

    def skip(self, size: int) -> None:
        self._unread = None
        self._rest.skip(size)

    def end(self) -> Iterator[Line]:
        if self._unread:
            unread, self._unread = self._unread, None
            yield from self._rest.feed(unread)
        yield from self._rest.end()


def _reader(decode: Callable[[bytes], Any], describe: Callable[[Any], str]) -> Callable[[bytes], Iterator[Line]]:
    def read(data: bytes) -> Iterator[Line]:
        yield Line(describe(decode(data)))

    return read


def _reverse(message: ReverseMessage) -> str:
    timeout = f"read_timeout_ms={message.read_timeout_ms}"
    if message.mode is ControlMode.FORWARD:
        action = mode_name(TrajectoryAction, message.words[0])
        return f"{message.mode.name} {action} points={message.words[1]} {timeout}"
    if message.mode is ControlMode.FREEDRIVE:
        return f"{message.mode.name} {mode_name(FreedriveAction, message.words[0])} {timeout}"
    if message.mode.real_time:
        return f"{message.mode.name} {formatting.value(message.values)} {timeout}"
    return f"{message.mode.name} {timeout}"  # its payload may be anything


def _point(point: TrajectoryPoint) -> str:
    how = [("target", point.target), ("second", point.via), ("third", point.parameters)]
    how.append(("duration_s", point.duration_s))  # type: ignore[arg-type]
    if point.type is MotionType.SPLINE:
        return f"{SplineType(point.spline_type or 0).name} SPLINE {formatting.pairs(how)}"
    return f"{point.type.name} {formatting.pairs(how)} blend_radius_m={formatting.value(point.blend_radius_m)}"


def _reply(reply: TrajectoryResult | Answer) -> str:
    return f"answer: {formatting.value(reply.values)}" if isinstance(reply, Answer) else f"result: {reply.name}"


def _command(command: ScriptCommand) -> str:
    if command.kind is ScriptCommandKind.QUERY:
        return f"QUERY {mode_name(Query, command.words[0])}"
    count = _PARAMETERS[command.kind]
    values: list[float] = list(command.values[:count])
    if count and command.kind in _FLAG_FIRST:
        values[0] = command.words[0]
    return f"{command.kind.name} {formatting.value(values)}" if count else command.kind.name
