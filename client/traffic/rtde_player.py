"""Replay of RTDE: recorded states, for any recipe that consists of recorded variables.

A connection gets the states of a recorded recipe: those of the next connection that requested the same variables, or
else of the next one that requested these and others, whose values are then packed again. A state that was sent after
input packages waits for the same number from this client, but only for a limited time, because another client may
have nothing to write.
"""

from collections.abc import Callable, Iterable
from typing import Final

from client.traffic.players import PlaybackOptions, Player, UnansweredError
from client.traffic.rtde_log import RecordedRecipe, Row, RTDELog
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, NOT_FOUND, OUTPUT_FIELDS, WIRE_TYPES
from urproto.rtde.recipes import Recipe, type_names
from urproto.versions import PolyscopeVersion

_INPUT_TIMEOUT_S: Final = 0.5  # longest wait for the inputs before a state (guess)


class RTDELibrary:
    """All RTDE connections of a recording, shared by all clients, including which recipes have been played.

    version: the controller's version, used if no client requested it by RTDE. report: called with a message about
    requested variables that were not recorded.
    """

    def __init__(
        self,
        logs: Iterable[RTDELog],
        version: PolyscopeVersion | None = None,
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.report = report
        logs = list(logs)
        self.version = next((log.version for log in logs if log.version is not None), version)
        self._exchanges = [exchange for log in logs for exchange in log.exchanges]
        self._outputs = [outputs for log in logs for outputs in log.outputs if outputs.rows]
        self._played: set[int] = set()

    @property
    def has_states(self) -> bool:
        """Whether there is anything to stream."""
        return bool(self._outputs)

    def reply(self, request: codec.Request, protocol: int) -> codec.Reply | None:
        """The recorded reply to the same request in this protocol version; None if there is none."""
        same = (one.reply for one in self._exchanges if one.request == request and one.protocol == protocol)
        return next(same, None)

    def outputs(self, names: tuple[str, ...]) -> RecordedRecipe | None:
        """Recorded states with these variables; recipes take turns."""
        exact = [one for one in self._outputs if one.names == names]
        fitting = exact or [one for one in self._outputs if set(names) <= set(one.names)]
        if not fitting:
            return None
        fresh = [one for one in fitting if id(one) not in self._played]
        if not fresh:
            self._played -= {id(one) for one in fitting}
        chosen = (fresh or fitting)[0]
        self._played.add(id(chosen))
        return chosen

    def missing(self, names: tuple[str, ...]) -> list[str]:
        """The variables missing from the recorded recipe that has most of them."""
        best = max(self._outputs, key=lambda one: len(set(names) & set(one.names)), default=None)
        return [name for name in names if best is None or name not in best.names]


class RTDEPlayer(Player):
    """One RTDE connection."""

    def __init__(self, library: RTDELibrary, timing: PlaybackOptions) -> None:
        self._library = library
        self._timing = timing
        self._decoder = codec.RTDEDecoder()
        self._protocol = 1
        self._streams: list[_Stream] = []
        self._input_recipes = 0
        self._inputs = 0
        self._running = False
        self._streamed = False

    def take(self, data: bytes, now_s: float) -> bytes:
        replies = b""
        for package in self._decoder.feed(data):
            request = codec.decode_request(package, self._protocol)
            protocol = self._protocol
            reply = self._reply(request, now_s)
            if reply is not None:
                replies += reply.encode(protocol)
        return replies

    def due(self, now_s: float) -> bytes:
        if not self._running:
            return b""
        return b"".join(stream.due(now_s, self._inputs, self._protocol) for stream in self._streams)

    @property
    def next_s(self) -> float | None:
        times = [stream.next_s for stream in self._streams if stream.next_s is not None]
        return min(times, default=None) if self._running else None

    @property
    def finished(self) -> bool:
        return self._streamed and all(stream.finished for stream in self._streams)

    def _reply(self, request: codec.Request, now_s: float) -> codec.Reply | None:
        match request:
            case codec.RequestProtocol():
                return self._switch(request)
            case codec.GetVersion():
                return self._version()
            case codec.SetupOutputs():
                return self._set_up(request)
            case codec.SetupInputs():
                return self._set_up_inputs(request)
            case codec.Start():
                return self._start(now_s)
            case codec.Pause():
                return self._pause(now_s)
            case codec.InputData():
                self._inputs += 1
        return None

    def _switch(self, request: codec.RequestProtocol) -> codec.Reply:
        recorded = self._library.reply(request, self._protocol)
        known = isinstance(recorded, codec.ProtocolReply)
        accepted = recorded.accepted if isinstance(recorded, codec.ProtocolReply) else False
        accepted = accepted if known else request.version in codec.KNOWN_PROTOCOLS
        if accepted:
            self._protocol = request.version
        return codec.ProtocolReply(accepted)

    def _version(self) -> codec.Reply:
        if self._library.version is None:
            raise UnansweredError("the question for the controller's version")
        return codec.VersionReply(self._library.version)

    def _set_up(self, request: codec.SetupOutputs) -> codec.Reply:
        outputs = self._library.outputs(request.names)
        if outputs is None:
            recorded = self._library.reply(request, self._protocol)
            if isinstance(recorded, codec.SetupOutputsReply) and NOT_FOUND in recorded.types:
                return recorded
            missing = self._library.missing(request.names)
            self._library.report(f"rtde: not in the recording, so NOT_FOUND: {', '.join(missing)}")
            types = type_names(request.names, {k: v for k, v in OUTPUT_FIELDS.items() if k not in missing})
            return codec.SetupOutputsReply(types, 0)
        if self._protocol == 1:  # one recipe, the last
            self._streams.clear()
        self._streams.append(_Stream(outputs, request, len(self._streams) + 1, self._timing))
        return codec.SetupOutputsReply(self._streams[-1].types, len(self._streams))

    def _set_up_inputs(self, request: codec.SetupInputs) -> codec.Reply:
        recorded = self._library.reply(request, self._protocol)
        if isinstance(recorded, codec.SetupInputsReply):
            types = recorded.types
        else:
            types = type_names(request.names, INPUT_FIELDS)
        if not WIRE_TYPES.keys() >= set(types):
            return codec.SetupInputsReply(types, 0)
        self._input_recipes += 1
        return codec.SetupInputsReply(types, self._input_recipes)

    def _start(self, now_s: float) -> codec.Reply:
        self._running = True
        self._streamed = bool(self._streams)
        for stream in self._streams:
            stream.start(now_s, waits=bool(self._input_recipes))
        return codec.StartReply(bool(self._streams) or not self._library.has_states)

    def _pause(self, now_s: float) -> codec.Reply:
        self._running = False
        for stream in self._streams:
            stream.pause(now_s)
        return codec.PauseReply(True)


class _Stream:
    """A client's recipe, filled from recorded states."""

    def __init__(
        self, outputs: RecordedRecipe, request: codec.SetupOutputs, number: int, timing: PlaybackOptions
    ) -> None:
        self._outputs = outputs
        self._names = request.names
        self._number = number
        self._timing = timing
        self._waits = False
        self._position_s = 0.0  # in the recording, when it began to run
        self._began_s = 0.0
        self._next = 0
        self._wait_until_s: float | None = None
        self._rows = _thinned(outputs, request.frequency_hz)
        self.types = tuple(outputs.types[outputs.names.index(name)] for name in request.names)
        self._recipe = Recipe.of_reply(self._names, self.types)

    def start(self, now_s: float, *, waits: bool) -> None:
        self._began_s, self._waits = now_s, waits

    def pause(self, now_s: float) -> None:
        self._position_s += (now_s - self._began_s) * self._timing.speed

    @property
    def finished(self) -> bool:
        return self._next == len(self._rows)

    @property
    def next_s(self) -> float | None:
        if self.finished:
            return None
        if self._wait_until_s is not None:
            return self._wait_until_s
        return self._due_s(self._rows[self._next])

    def due(self, now_s: float, inputs: int, protocol: int) -> bytes:
        packages = b""
        while not self.finished and self._due_s(row := self._rows[self._next]) <= now_s:
            if self._must_wait(row, now_s, inputs):
                break
            packages += codec.OutputData(self._packed(row), self._number).encode(protocol)
            self._next += 1
            if self.finished and self._timing.loop:
                self._next, self._position_s, self._began_s = 0, -self._period_s(), now_s
        return packages

    def _due_s(self, row: Row) -> float:
        recorded_s = (row.time_ns - self._rows[0].time_ns) / 1e9
        return self._began_s + (recorded_s - self._position_s) / self._timing.speed

    def _period_s(self) -> float:
        steps = len(self._rows) - 1
        return (self._rows[-1].time_ns - self._rows[0].time_ns) / 1e9 / steps if steps else 1.0

    def _must_wait(self, row: Row, now_s: float, inputs: int) -> bool:
        """Whether to wait for inputs of the client; the recording's time is paused meanwhile."""
        if not self._waits or row.inputs <= inputs:
            self._resume(now_s, row)
            return False
        if self._wait_until_s is None:
            self._wait_until_s = now_s + _INPUT_TIMEOUT_S
        if now_s < self._wait_until_s:
            return True
        self._waits = False
        self._resume(now_s, row)
        return False

    def _resume(self, now_s: float, row: Row) -> None:
        if self._wait_until_s is not None:
            self._wait_until_s = None
            self._began_s += now_s - self._due_s(row)

    def _packed(self, row: Row) -> bytes:
        if self._names == self._outputs.names or self._recipe is None:
            return row.data
        values = self._outputs.unpack(row.data)
        return self._recipe.pack([values[name] for name in self._names])


def _thinned(outputs: RecordedRecipe, frequency_hz: float | None) -> list[Row]:
    """Reduce the states to the rate that the client requests, if that is lower than the recorded one."""
    rows = outputs.rows
    if frequency_hz is None or outputs.frequency_hz is None or not 0 < frequency_hz < outputs.frequency_hz:
        return rows
    return rows[:: max(1, int(outputs.frequency_hz / frequency_hz + 1e-9))]
