"""The protocol of one RTDE connection, without its socket.

States of the output side:

    NO_RECIPE  no valid output recipe: a start is refused
    PAUSED     a valid output recipe, but no data is sent
    STARTED    data is sent

Inputs do not depend on this state: a public client sends them without ever starting. A controller does not start
without a variable in the output recipe (RTDE_Python_Client_Library issue 13, 5.22), so an empty one is not valid.
Undocumented and therefore guesses: after a new output recipe in the state STARTED, data continues with that recipe; a
frequency that is not a positive number is refused.

An input variable has one writer at a time: another connection that requests it gets IN_USE until the first one has
closed.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from enum import Enum
from functools import lru_cache
from typing import Any, Final

from emulator.snapshot import Snapshot
from urproto.errors import RemoteProtocolError
from urproto.facts import release_of, rows
from urproto.rtde import codec
from urproto.rtde.fields import IN_USE, INPUT_FIELDS, NOT_FOUND, OUTPUT_FIELDS, Field, available_fields
from urproto.rtde.recipes import Recipe, type_names
from urproto.versions import PolyscopeVersion

Packer = Callable[[Snapshot], bytes]

# The RTDE guide allows 2048; the official client's tests request 9 kB in one recipe from PolyScope 3.14, 5.9 and later.
_MAX_NAME_BYTES: Final = 12 * 1024  # guess: the variables that so many names can stand for fit into a package of 64 kB
_MAX_NAMES: Final = _MAX_NAME_BYTES // 2
_MAX_INPUT_RECIPES: Final = 255  # the id is one byte, 0 means refused
_OUTPUT_RECIPE: Final = 1
_REFUSED: Final = 0
_UNCONFIRMED: Final = rows("safety_setup.unconfirmed")[0].value
_SOURCE: Final = "RTDE"  # of the controller's text messages (guess)


class SessionState(Enum):
    """State of the output side."""

    NO_RECIPE = "no recipe"
    PAUSED = "paused"
    STARTED = "started"


class SessionEvent(Enum):
    """An event that changes the state of the output side."""

    VALID_RECIPE = "valid recipe"
    INVALID_RECIPE = "invalid recipe"
    START = "start"
    PAUSE = "pause"


_S, _E = SessionState, SessionEvent
TRANSITIONS: Final[Mapping[tuple[SessionState, SessionEvent], SessionState]] = {
    (_S.NO_RECIPE, _E.VALID_RECIPE): _S.PAUSED,
    (_S.NO_RECIPE, _E.INVALID_RECIPE): _S.NO_RECIPE,
    (_S.NO_RECIPE, _E.START): _S.NO_RECIPE,
    (_S.NO_RECIPE, _E.PAUSE): _S.NO_RECIPE,
    (_S.PAUSED, _E.VALID_RECIPE): _S.PAUSED,
    (_S.PAUSED, _E.INVALID_RECIPE): _S.NO_RECIPE,
    (_S.PAUSED, _E.START): _S.STARTED,
    (_S.PAUSED, _E.PAUSE): _S.PAUSED,
    (_S.STARTED, _E.VALID_RECIPE): _S.STARTED,
    (_S.STARTED, _E.INVALID_RECIPE): _S.NO_RECIPE,
    (_S.STARTED, _E.START): _S.STARTED,
    (_S.STARTED, _E.PAUSE): _S.PAUSED,
}


class Reservations:
    """Records which connection writes which input variable."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}

    def taken(self, name: str, owner: object) -> bool:
        """Return whether another connection writes the variable."""
        return self._owners.get(name, owner) is not owner

    def take(self, names: tuple[str, ...], owner: object) -> None:
        """Reserve variables, none of which is taken."""
        self._owners.update(dict.fromkeys(names, owner))

    def release(self, owner: object) -> None:
        self._owners = {name: holder for name, holder in self._owners.items() if holder is not owner}


class RTDEHost:
    """The data that all sessions of one controller share: its variables, its protocol versions, and the reservations.

    snapshot: returns the last snapshot of the controller.
    """

    def __init__(self, version: PolyscopeVersion, snapshot: Callable[[], Snapshot] = Snapshot) -> None:
        self.version = version
        # with the build of URControl, as in the version message: 5.16.0.0 in a log of a public client
        self.control_version = replace(version, build=release_of(version).control_build.integer)
        self._snapshot = snapshot
        self.outputs = available_fields(OUTPUT_FIELDS, version)
        self.inputs = available_fields(INPUT_FIELDS, version)
        self.protocols: Collection[int] = codec.KNOWN_PROTOCOLS
        self.reservations = Reservations()
        self.packer = lru_cache(maxsize=256)(self._packer)  # equal recipes share a packer: encoded once per period
        self._hidden: set[str] = set()

    @property
    def unconfirmed(self) -> bool:
        """Whether the safety setup has not been confirmed: no data is sent until then."""
        return not self._snapshot().safety_confirmed

    @property
    def never_on(self) -> bool:
        """Whether PolyScope X warns of that because the arm has never been on (official C++ client); it sends data."""
        return self.version.is_polyscope_x and not self._snapshot().switched_on

    def hide(self, name: str, hidden: bool) -> None:
        """Make recipes with a variable fail as if it did not exist (``hidden``), or make it available again."""
        (self._hidden.add if hidden else self._hidden.discard)(name)
        self.outputs = _without(available_fields(OUTPUT_FIELDS, self.version), self._hidden)
        self.inputs = _without(available_fields(INPUT_FIELDS, self.version), self._hidden)

    def _packer(self, names: tuple[str, ...], protocol: int) -> Packer:
        return codec.output_packer(Recipe.of(names, self.outputs), protocol, _OUTPUT_RECIPE)


def _without(fields: Mapping[str, Field], hidden: Collection[str]) -> Mapping[str, Field]:
    return {name: field for name, field in fields.items() if name not in hidden}


class RTDESession:
    """Answers the requests of one client.

    write_inputs: called with the values of each input package, by variable name. note: called with lines for the
    controller's log.
    """

    def __init__(
        self, host: RTDEHost, write_inputs: Callable[[dict[str, Any]], None], note: Callable[[str], None]
    ) -> None:
        self.state = SessionState.NO_RECIPE
        self.protocol = 1
        self._host = host
        self._write_inputs = write_inputs
        self._note = note
        self._outputs: tuple[str, ...] = ()
        self._packer: Packer | None = None
        self._every = 1  # a package is sent every so many control periods
        self._periods_left = 0
        self._inputs: dict[int, Recipe] = {}
        self._warned: set[str] = set()  # warnings that were sent

    def due(self) -> Packer | None:
        """Return the packer for this period's package, None if none is due. Call it once per control period."""
        if self.state is not SessionState.STARTED:
            return None
        self._periods_left -= 1
        if self._periods_left > 0:
            return None
        self._periods_left = self._every
        return self._packer

    def close(self) -> None:
        """Call when the client has disconnected: others may then write its inputs."""
        self._host.reservations.release(self)

    def read(self, package: codec.Package) -> codec.Request | codec.TextMessage:
        """Decode a request; for an invalid one, return the answer to it."""
        try:
            return codec.decode_request(package, self.protocol)
        except RemoteProtocolError as error:
            return _warning(f"ignored: {error}")

    def greeting(self) -> list[codec.Reply]:
        """What a client gets before it has sent anything: a warning until the safety setup is confirmed.

        The official driver received it instead of its first answer, in the form of protocol 1 (Universal_Robots_ROS2_
        Driver issue 349); clients that take it for that answer believe that the controller has version 0.
        """
        return [_warning(_UNCONFIRMED)] if self._host.unconfirmed or self._host.never_on else []

    def answer(self, request: codec.Request) -> list[codec.Reply]:
        """Carry out a request and return the answers in order."""
        return _HANDLERS[type(request)](self, request)

    # one method for each kind of request

    def _request_protocol(self, request: codec.RequestProtocol) -> list[codec.Reply]:
        accepted = request.version in self._host.protocols
        if accepted and request.version != self.protocol:
            self.protocol = request.version
            self._renew_packer()
        return [codec.ProtocolReply(accepted)]

    def _get_version(self, request: codec.GetVersion) -> list[codec.Reply]:
        return [codec.VersionReply(self._host.control_version)]

    def _setup_outputs(self, request: codec.SetupOutputs) -> list[codec.Reply]:
        types = self._types(request.names, self._host.outputs)
        problem = _problem(request.names, types) or self._set_frequency(request.frequency_hz)
        if problem:
            self._event(SessionEvent.INVALID_RECIPE)
            self._outputs, self._packer = (), None
            return [codec.SetupOutputsReply(types, _REFUSED), _error(f"the output recipe is not valid: {problem}")]
        self._outputs = request.names
        self._renew_packer()
        self._event(SessionEvent.VALID_RECIPE)
        return [codec.SetupOutputsReply(types, _OUTPUT_RECIPE)]

    def _setup_inputs(self, request: codec.SetupInputs) -> list[codec.Reply]:
        reservations = self._host.reservations
        types = tuple(
            IN_USE if reservations.taken(name, self) else kind
            for name, kind in zip(request.names, self._types(request.names, self._host.inputs), strict=False)
        )
        problem = _problem(request.names, types)
        if len(self._inputs) >= _MAX_INPUT_RECIPES:
            problem = f"this connection has {_MAX_INPUT_RECIPES} input recipes already, the maximum"
        if problem:
            return [codec.SetupInputsReply(types, _REFUSED), _error(f"the input recipe is not valid: {problem}")]
        recipe_id = len(self._inputs) + 1
        self._inputs[recipe_id] = Recipe.of(request.names, self._host.inputs)
        reservations.take(request.names, self)
        return [codec.SetupInputsReply(types, recipe_id)]

    def _start(self, request: codec.Start) -> list[codec.Reply]:
        if self._host.unconfirmed:
            return [_warning(_UNCONFIRMED), codec.StartReply(False)]
        self._event(SessionEvent.START)
        # the first package is sent one period of the requested rate later than the answer, so that a client that reads
        # the answer immediately does not receive data in the same read
        self._periods_left = self._every + 1
        if self.state is SessionState.STARTED:
            return [codec.StartReply(True)]
        return [codec.StartReply(False), _error("cannot start: set up a valid output recipe first")]

    def _pause(self, request: codec.Pause) -> list[codec.Reply]:
        self._event(SessionEvent.PAUSE)
        return [codec.PauseReply(True)]

    def _input_data(self, request: codec.InputData) -> list[codec.Reply]:
        """Of a package that is too long, the bytes of its recipe are used: ur_rtde sends such packages."""
        recipe = self._inputs.get(request.recipe_id)
        if recipe is None:
            return self._warn_once(f"input data ignored: this connection has no input recipe {request.recipe_id}")
        data, size = request.data, recipe.size
        if len(data) >= size:
            self._write_inputs(dict(zip(recipe.names, recipe.unpack(data[:size]), strict=True)))
        if len(data) == size:
            return []
        result = f"only the first {size} are used" if len(data) > size else "ignored"
        return self._warn_once(f"input data of recipe {request.recipe_id} has {len(data)} bytes, not {size}: {result}")

    def _client_message(self, request: codec.ClientMessage) -> list[codec.Reply]:
        level = (
            codec.MessageLevel(request.level).name if request.level in list(codec.MessageLevel) else str(request.level)
        )
        self._note(f"RTDE client {request.source}: {level}: {request.text}")
        return []

    # helpers

    def _event(self, event: SessionEvent) -> None:
        self.state = TRANSITIONS[self.state, event]

    def _types(self, names: tuple[str, ...], fields: Mapping[str, Field]) -> tuple[str, ...]:
        """Return the types for the answer. The names of a list that is too long are not looked up: all are NOT_FOUND.

        Such an answer has at most as many types as a list of the maximum size could have names, because it has to fit
        into its package.
        """
        return (NOT_FOUND,) * min(len(names), _MAX_NAMES) if _too_long(names) else type_names(names, fields)

    def _set_frequency(self, frequency_hz: float | None) -> str:
        """Set the number of control periods per package; return the problem of an invalid frequency, else ""."""
        most_hz = self._host.version.series.frequency_hz
        if frequency_hz is None:
            frequency_hz = most_hz
        if not 0.0 < frequency_hz < float("inf"):
            return f"its frequency is {frequency_hz} Hz: it must be positive and finite"
        # whole periods, rounded down as the guide says; the addend compensates for rounding of binary fractions
        self._every = max(1, int(min(most_hz / frequency_hz + 1e-9, 2.0**31)))
        # if data is being sent, the next package follows at the new rate, not after what is left of a longer period
        self._periods_left = min(self._periods_left, self._every + 1)
        return ""

    def _renew_packer(self) -> None:
        self._packer = self._host.packer(self._outputs, self.protocol) if self._outputs else None

    def _warn_once(self, text: str) -> list[codec.Reply]:
        """Return a warning the first time only: it would otherwise be repeated for every package."""
        if text in self._warned or len(self._warned) > _MAX_INPUT_RECIPES:
            return []
        self._warned.add(text)
        return [_warning(text)]


def _problem(names: tuple[str, ...], types: tuple[str, ...]) -> str:
    """Return the reason why a recipe is invalid, "" for a valid one."""
    if _too_long(names):
        return f"its names take more than {_MAX_NAME_BYTES} bytes"
    for bad in (NOT_FOUND, IN_USE):
        refused = [name for name, kind in zip(names, types, strict=True) if kind == bad]
        if refused:
            return f"{bad} {', '.join(refused)}"
    return "" if names else "it has no variables"


def _too_long(names: tuple[str, ...]) -> bool:
    return len(",".join(names)) > _MAX_NAME_BYTES


def _warning(text: str) -> codec.TextMessage:
    return codec.TextMessage(text, _SOURCE, codec.MessageLevel.WARNING)


def _error(text: str) -> codec.TextMessage:
    return codec.TextMessage(text, _SOURCE, codec.MessageLevel.ERROR)


_HANDLERS: Final[Mapping[type, Callable[[RTDESession, Any], list[codec.Reply]]]] = {
    codec.RequestProtocol: RTDESession._request_protocol,
    codec.GetVersion: RTDESession._get_version,
    codec.SetupOutputs: RTDESession._setup_outputs,
    codec.SetupInputs: RTDESession._setup_inputs,
    codec.Start: RTDESession._start,
    codec.Pause: RTDESession._pause,
    codec.InputData: RTDESession._input_data,
    codec.ClientMessage: RTDESession._client_message,
}
