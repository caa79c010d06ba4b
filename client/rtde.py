"""RTDE client (Real-Time Data Exchange): receive a robot's state at a fixed rate, and write its inputs.

    async with RTDEClient("192.168.56.101", ["timestamp", "actual_q"], frequency_hz=125) as rtde:
        state = await rtde.receive()          # {"timestamp": 41.2, "actual_q": (0.0, ...)}

    with BlockingRTDEClient("192.168.56.101", Path("outputs.txt"), [["input_int_register_24"]]) as rtde:
        state = rtde.latest()                 # the newest, however slow the loop is
        rtde.write(input_int_register_24=7)

Variables and their types are those of urproto.rtde.fields. A recipe that the robot refuses raises RobotRefused, which
names the variables. Options are those of RTDECore.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from client.connection import (
    DEFAULT_TIMEOUT_S,
    POLL,
    AsyncConnection,
    BlockingConnection,
    Connection,
    Flow,
    FlowMethod,
    Reconnect,
)
from client.errors import ConnectionLostError, NoAnswerError, RobotUnreachableError
from client.quantities import checked
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.rtde import codec
from urproto.rtde.fields import IN_USE, INPUT_FIELDS, NOT_FOUND, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe, RecipeValues
from urproto.text import quoted
from urproto.versions import PolyscopeVersion

Names = Sequence[str] | Path  # variables, or a file that lists them

_CLOSE_NAMES = 5  # suggestions for an unknown name
_MASK = "_mask"  # masks select what the same package changes, so their values are not kept between writes
_MAX_MESSAGES = 100  # text messages kept for the caller; older ones are dropped
_NEGOTIATION_ATTEMPTS = 10  # after a loss; guess: a booting controller closes its first connections
_RETRY_S = 0.5
_LOST = (ConnectionLostError, NoAnswerError, RobotUnreachableError)
PORT = 30004
_RECONNECT_S = 60.0  # guess: a controller boots in about a minute


def read_recipe(path: Path) -> tuple[str, ...]:
    """Read the variables from a file with one name per line. Blank lines and text after a ``#`` are ignored.

    Raises OSError if the file cannot be read, and LocalProtocolError if it is not a list of names.
    """
    lines = (line.partition("#")[0].strip() for line in path.read_text("utf-8-sig").splitlines())
    names = tuple(line for line in lines if line)
    invalid = [name for name in names if not name.isidentifier()]
    if invalid:
        raise LocalProtocolError(f"{path}: {invalid[0]!r} is not a variable: give one name per line")
    if not names:
        raise LocalProtocolError(f"{path} names no variable")
    return names


def variable_names(names: Names) -> tuple[str, ...]:
    """The variables, read from their file if a path is given."""
    if isinstance(names, Path):
        return read_recipe(names)
    if isinstance(names, str | bytes) or not isinstance(names, Iterable):
        raise LocalProtocolError(f"a recipe is a list of names or the Path of a file, not {quoted(names)}")
    listed = tuple(names)
    for name in listed:
        if not isinstance(name, str):
            raise LocalProtocolError(f"a recipe is a list of names, and {quoted(name)} is none")
    return listed


def unknown_fields(names: Iterable[str]) -> str | None:
    """Say which output name is unknown, and suggest similar ones; None if all are known."""
    for name in names:
        if name not in OUTPUT_FIELDS:
            close = get_close_matches(name, OUTPUT_FIELDS, _CLOSE_NAMES, 0.5)
            hint = f"did you mean {', '.join(close)}?" if close else "docs/reference/supported.md lists them"
            return f"no RTDE output is called {name!r}: {hint}"
    return None


class InputRecipes:
    """The input recipes of one connection, and the values last written to each variable.

    A variable that was never written counts as 0, false or zeros. Masks are 0 in every package that does not name
    them, so that it leaves the masked values unchanged.
    """

    def __init__(self, recipes: Iterable[Names]) -> None:
        if isinstance(recipes, str | bytes) or not isinstance(recipes, Iterable):
            raise LocalProtocolError(f"inputs are a list of recipes, not {quoted(recipes)}")
        self.recipes = [Recipe.of(variable_names(names), INPUT_FIELDS) for names in recipes]
        self._last: dict[str, Any] = {}

    def add(self, names: Names) -> Recipe:
        """Add a recipe."""
        self.recipes.append(Recipe.of(variable_names(names), INPUT_FIELDS))
        return self.recipes[-1]

    def index_of(self, names: Collection[str]) -> int:
        """Index of the recipe with exactly these variables. Raises LocalProtocolError if there is none."""
        for index, recipe in enumerate(self.recipes):
            if set(recipe.names) == set(names):
                return index
        raise LocalProtocolError(f"no input recipe has exactly the variables {', '.join(sorted(names))}")

    def covering(self, names: Collection[str]) -> list[int]:
        """Indices of as few recipes as possible that cover these variables. Raises LocalProtocolError if none do."""
        remaining, chosen = set(names), list[int]()
        while remaining:
            best = max(range(len(self.recipes)), key=lambda index: self._rank(index, remaining), default=0)
            if not self.recipes or remaining.isdisjoint(self.recipes[best].names):
                raise LocalProtocolError(f"no input recipe has {', '.join(sorted(remaining))}: add it when connecting")
            chosen.append(best)
            remaining -= set(self.recipes[best].names)
        return chosen

    def _rank(self, index: int, wanted: set[str]) -> tuple[int, int]:
        """Sort key: most of the wanted variables first, then the fewest others."""
        names = self.recipes[index].names
        return len(wanted.intersection(names)), -len(names)

    def pack(self, index: int, values: Mapping[str, Any]) -> bytes:
        """Pack the data of a recipe: these values, and the last values of its other variables.

        Raises LocalProtocolError for a value that does not fit its type; then no value is stored.
        """
        recipe = self.recipes[index]
        current = {field.name: self._value(field.name, field.type.count, values) for field in recipe.fields}
        data = recipe.pack([current[name] for name in recipe.names])
        self._last.update(current)
        return data

    def _value(self, name: str, count: int, values: Mapping[str, Any]) -> Any:
        nothing = 0 if count == 1 else (0,) * count
        return values.get(name, nothing if name.endswith(_MASK) else self._last.get(name, nothing))


ReplyKind = TypeVar("ReplyKind", bound=codec.Reply)
State = Mapping[str, Any]


class ReceivedState(RecipeValues):
    """A state by variable name, with an upper limit of its age.

    taken_after_s: the robot took the state after this time, by this machine's monotonic clock [s].
    """

    __slots__ = ("taken_after_s",)

    def __init__(self, values: RecipeValues, taken_after_s: float) -> None:
        super().__init__(values._flat, values._places)
        self.taken_after_s = taken_after_s

    @property
    def age_s(self) -> float:
        """The state is not older than this [s]."""
        return time.monotonic() - self.taken_after_s


@checked
class RTDECore:
    """The client's side of an RTDE connection, without I/O.

    Parameters:

    - outputs: the variables to receive; empty for a client that only writes.
    - inputs: the recipes to write, each a list of variables. Each recipe, and outputs, may also be the Path of a file
      with one name per line.
    - frequency_hz: rate of the states [Hz]; the robot's full rate by default.
    - ignore_unavailable: leave out outputs that this robot does not have; ``unavailable`` names them.
    - reconnect_s: how long to try to reconnect after a loss [s]; 0 disables it.

    Attributes:

    - state: the newest state received, empty before the first.
    - skipped: number of states that ``latest`` has skipped.
    - reconnects: number of successful reconnections.
    - messages: the robot's text messages.
    """

    def __init__(
        self,
        outputs: Names,
        inputs: Iterable[Names] = (),
        frequency_hz: float | None = None,
        *,
        ignore_unavailable: bool = False,
        reconnect_s: float = 0.0,
    ) -> None:
        self.version: PolyscopeVersion | None = None
        self.messages: deque[codec.TextMessage] = deque(maxlen=_MAX_MESSAGES)
        self.state: State = {}
        self.unavailable: frozenset[str] = frozenset()
        self.rate_hz = 0.0  # rate of the states, known once the outputs are set up
        self.skipped = 0
        self.reconnects = 0
        self.running = False
        self._wanted = variable_names(outputs)
        self._outputs = Recipe.of(self._wanted, OUTPUT_FIELDS)
        self._inputs = InputRecipes(inputs)
        self._input_ids: list[int] = []
        self._frequency_hz = frequency_hz
        self._ignore_unavailable = ignore_unavailable
        self._reconnect_s = reconnect_s
        self._paused = False  # by the caller
        self._reset()

    def _reset(self) -> None:
        """Reset the state of the last connection."""
        self._protocol = 1
        self._decoder = codec.RTDEDecoder()
        self._replies: deque[codec.Reply] = deque()
        self._arrived: deque[bytes] = deque()  # payloads of data packages
        self._marks_s: deque[float] = deque()  # times of the marks that the robot has not answered yet
        self._marked_s: float | None = None  # time of the last one that it has; None if it answers none
        self._newest: ReceivedState | None = None
        self._unconfirmed = 0  # writes that the robot has not answered yet
        self.running = False

    # operations of a client

    def start(self) -> Flow[None]:
        """Negotiate protocol and recipes on a new connection, and start the data exchange."""
        self._reset()
        version = codec.KNOWN_PROTOCOLS[-1]
        if (yield from self._request(codec.RequestProtocol(version), codec.ProtocolReply)).accepted:
            self._protocol = version
        self.version = (yield from self._request(codec.GetVersion(), codec.VersionReply)).version
        if self._wanted:
            yield from self._set_up_outputs(self.version)
        self._input_ids = []
        for recipe in self._inputs.recipes:
            yield from self._set_up_inputs(recipe)
        if self._wanted and not self._paused:
            yield from self._start()

    def pause(self) -> Flow[None]:
        """Stop the stream of states until ``resume``; states still on their way are dropped."""
        if not (yield from self._request(codec.Pause(), codec.PauseReply)).accepted:
            raise RobotRefused("pause of the data exchange", "not accepted")
        self._arrived.clear()
        self._paused, self.running = True, False

    def resume(self) -> Flow[None]:
        """Resume the stream of states."""
        self._paused = False
        yield from self._start()

    def receive(self) -> Flow[State]:
        """The next state, by variable name; states come in order, and none is skipped."""
        return (yield from self._with_reconnect(self._receive))

    def latest(self) -> Flow[State]:
        """The newest state that has arrived; older ones are skipped. Waits if none has arrived since the last call."""
        return (yield from self._with_reconnect(self._latest))

    def send(self, values: State) -> Flow[None]:
        """Write inputs; ``values`` must name exactly the variables of one input recipe."""
        yield self._input_package(self._inputs.index_of(values), values)

    def write(self, values: State) -> Flow[None]:
        """Write any inputs of the recipes; their other variables keep their last values (see InputRecipes)."""
        packages = [self._input_package(index, values) for index in self._inputs.covering(values)]
        yield b"".join(packages)

    def write_and_confirm(self, values: State, ahead: int = 0) -> Flow[None]:
        """Like `write`, but wait until the robot has read all writes but the last ``ahead``; without outputs only.

        A package of inputs has no answer, and gets lost with its connection. So a request follows it, and its
        answer shows that the package was read.
        """
        yield from self.write(values)
        yield codec.GetVersion().encode(self._protocol)
        self._unconfirmed += 1
        yield from self._confirm(ahead)

    def _confirm(self, ahead: int) -> Flow[None]:
        while ahead and (data := (yield POLL)):
            self._feed(data)
        while self._unconfirmed > len(self._replies) + ahead:
            self._feed((yield None))
        self._unconfirmed -= len(self._replies)
        self._replies.clear()

    def add_inputs(self, names: Names) -> Flow[None]:
        """Set up another input recipe; possible at any time on a connection without outputs."""
        yield from self._confirm(0)
        recipe = self._inputs.add(names)
        try:
            yield from self._set_up_inputs(recipe)
        except BaseException:
            self._inputs.recipes.remove(recipe)
            raise

    def send_message(
        self, text: str, source: str = "", level: codec.MessageLevel = codec.MessageLevel.INFO
    ) -> Flow[None]:
        """Write a line to the controller's log; text and source are truncated to 255 bytes."""
        yield codec.ClientMessage(text, source, level).encode(self._protocol)

    def reconnect(self, within_s: float) -> Flow[None]:
        """Reopen the connection and negotiate the same recipes. Raises the error of the last attempt."""
        after_s = 0.0
        for attempt in range(1, _NEGOTIATION_ATTEMPTS + 1):
            self.running = False
            try:
                yield Reconnect(within_s, after_s)
                yield from self.start()
            except (ConnectionLostError, NoAnswerError, RobotRefused):  # still booting, or our inputs not yet released
                if attempt == _NEGOTIATION_ATTEMPTS:
                    raise
                after_s = _RETRY_S
            else:
                self.reconnects += 1
                return

    # receiving

    def _with_reconnect(self, operation: Callable[[], Flow[State]]) -> Flow[State]:
        while True:
            try:
                return (yield from operation())
            except _LOST:
                if not self._reconnect_s:
                    raise
            yield from self.reconnect(self._reconnect_s)

    def _receive(self) -> Flow[State]:
        self._check_running()
        while not self._arrived:
            self._feed((yield None))
        return self._read(self._arrived.popleft())

    def _latest(self) -> Flow[State]:
        self._check_running()
        try:
            while data := (yield POLL):
                self._feed(data)
        except _LOST:
            if not self._arrived:  # otherwise return what arrived before; the next call raises
                raise
        while not self._arrived:
            self._feed((yield None))
        self.skipped += len(self._arrived) - 1
        newest = self._arrived.pop()
        self._arrived.clear()
        return self._read(newest)

    def _check_running(self) -> None:
        if not self._wanted:
            raise LocalProtocolError("this connection has no outputs to receive: give some when connecting")
        if self._paused:
            raise LocalProtocolError("the data exchange is paused: resume it to receive states")

    def _read(self, data: bytes) -> RecipeValues:
        values = self._outputs.values(data, 0 if self._protocol == 1 else 1)  # after the recipe id
        self.state = values
        return values

    def first_mark(self, now_s: float) -> Flow[None]:
        """Send the first `mark`, and wait for the answer. Without one, states count as taken when they arrive."""
        yield from self._request(codec.GetVersion(), codec.VersionReply)
        self._marked_s = now_s

    def mark(self, now_s: float) -> bytes:
        """Return a request that separates states taken before it from those taken after, which follow its answer.

        guess: a controller answers requests in order with the states, also while it sends them.
        """
        if self._marked_s is None:
            return b""
        self._marks_s.append(now_s)
        return codec.GetVersion().encode(self._protocol)

    def take(self, data: bytes, now_s: float) -> Iterator[ReceivedState]:
        """Yield the states that these bytes complete, for a caller that reads the connection itself."""
        yield from self._take_arrived(now_s)
        for package in self._decoder.feed(data):
            self._sort(package)
            while self._replies:
                self._replies.popleft()
                self._marked_s = self._marks_s.popleft() if self._marks_s else self._marked_s
            yield from self._take_arrived(now_s)

    def _take_arrived(self, now_s: float) -> Iterator[ReceivedState]:
        while self._arrived:
            values = self._read(self._arrived.popleft())
            taken_after_s, before = now_s if self._marked_s is None else self._marked_s, self._newest
            if before is not None and values.get("timestamp", math.nan) == before.get("timestamp"):
                taken_after_s = before.taken_after_s  # the same state again
            self.state = self._newest = ReceivedState(values, taken_after_s)
            yield self._newest

    # writing

    def _input_package(self, index: int, values: State) -> bytes:
        data = self._inputs.pack(index, values)
        if index >= len(self._input_ids):
            raise LocalProtocolError("the input recipes are not set up: connect first")
        return codec.InputData(self._input_ids[index], data).encode(self._protocol)

    # negotiation

    def _set_up_outputs(self, version: PolyscopeVersion) -> Flow[None]:
        most_hz = version.series.frequency_hz
        frequency_hz = self._frequency_hz or float(most_hz)
        if frequency_hz > most_hz:
            raise LocalProtocolError(
                f"a {version.series.value} sends at most {most_hz} states/s, not {frequency_hz:g}: request fewer"
            )
        available = self._wanted
        reply = yield from self._request(codec.SetupOutputs(available, frequency_hz), codec.SetupOutputsReply)
        if self._ignore_unavailable and NOT_FOUND in reply.types:
            available = _available(available, reply.types)
            reply = yield from self._request(codec.SetupOutputs(available, frequency_hz), codec.SetupOutputsReply)
        self._outputs = Recipe.of(available, OUTPUT_FIELDS)
        _check(self._outputs, reply.types)
        self.unavailable = frozenset(self._wanted) - frozenset(available)
        every = 1 if self._protocol == 1 else int(most_hz / frequency_hz + 1e-9)  # source: RTDE guide, whole periods
        self.rate_hz = most_hz / every

    def _set_up_inputs(self, recipe: Recipe) -> Flow[None]:
        reply = yield from self._request(codec.SetupInputs(recipe.names), codec.SetupInputsReply)
        _check(recipe, reply.types)
        self._input_ids.append(reply.recipe_id)

    def _start(self) -> Flow[None]:
        self._arrived.clear()  # states from before an earlier pause
        if not (yield from self._request(codec.Start(), codec.StartReply)).accepted:
            raise RobotRefused("start of the data exchange", "not accepted", "the robot's text messages may say why")
        self.running = True

    def _request(self, request: codec.Request, kind: type[ReplyKind]) -> Flow[ReplyKind]:
        yield request.encode(self._protocol)
        while not self._replies:
            self._feed((yield None))
        reply = self._replies.popleft()
        if not isinstance(reply, kind):
            raise RemoteProtocolError(f"expected a {kind.__name__}, received a {type(reply).__name__}")
        return reply

    def _feed(self, data: bytes) -> None:
        for package in self._decoder.feed(data):
            self._sort(package)

    def _sort(self, package: codec.Package) -> None:
        """Sort a received package into states, texts and replies."""
        if package.type == codec.PackageType.DATA_PACKAGE:  # hundreds per second: decoded only when read
            self._arrived.append(package.payload)
            return
        reply = codec.decode_reply(package, self._protocol)
        if isinstance(reply, codec.TextMessage):
            self.messages.append(reply)
        else:
            self._replies.append(reply)


def _available(names: tuple[str, ...], types: tuple[str, ...]) -> tuple[str, ...]:
    found = tuple(name for name, kind in zip(names, types, strict=False) if kind != NOT_FOUND)
    if not found:
        raise RobotRefused("RTDE recipe", f"it has none of {', '.join(names)}", "request other variables")
    return found


def _check(recipe: Recipe, types: tuple[str, ...]) -> None:
    if types == recipe.types:
        return
    if len(types) != len(recipe.types):
        raise RemoteProtocolError(f"received {len(types)} types for {len(recipe.types)} variables")
    pairs = list(zip(recipe.names, types, strict=True))
    refused = [f"{name}: {kind}" for name, kind in pairs if kind in (NOT_FOUND, IN_USE)]
    if refused:
        raise RobotRefused("RTDE recipe", ", ".join(refused), _advice(types))
    wrong = [f"{name} is {kind}" for (name, kind), known in zip(pairs, recipe.types, strict=True) if kind != known]
    raise RemoteProtocolError(f"the robot's types differ from the known ones: {', '.join(wrong)}")


def _advice(types: tuple[str, ...]) -> str:
    if IN_USE in types:
        return "another client (or fieldbus) writes it: disconnect that client, or use other registers"
    return "this controller's version does not have it: leave it out, or ignore unavailable outputs"


@checked
class _RTDE(Connection):
    """The operations of the asynchronous and the blocking client."""

    def __init__(
        self,
        host: str,
        outputs: Names,
        inputs: Iterable[Names] = (),
        *,
        frequency_hz: float | None = None,
        ignore_unavailable: bool = False,
        reconnect_s: float = 0.0,
        port: int = PORT,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RTDECore(
            outputs, inputs, frequency_hz, ignore_unavailable=ignore_unavailable, reconnect_s=reconnect_s
        )

    def _opening(self) -> Flow[None]:
        return self.core.start()

    @FlowMethod
    def receive(self) -> Flow[State]:
        """The next state, by variable name; states come in order, and none is skipped."""
        return self.core.receive()

    @FlowMethod
    def latest(self) -> Flow[State]:
        """The newest state that has arrived; older ones are skipped. Waits if none has arrived since the last call."""
        return self.core.latest()

    @FlowMethod
    def send(self, /, **values: Any) -> Flow[None]:
        """Write inputs; the names must be exactly the variables of one input recipe."""
        return self.core.send(values)

    @FlowMethod
    def write(self, /, **values: Any) -> Flow[None]:
        """Write some inputs; the other variables of their recipes keep their last values, and masks are 0."""
        return self.core.write(values)

    @FlowMethod
    def pause(self) -> Flow[None]:
        """Stop the stream of states until ``resume``."""
        return self.core.pause()

    @FlowMethod
    def resume(self) -> Flow[None]:
        """Resume the stream of states."""
        return self.core.resume()

    @FlowMethod
    def reconnect(self, within_s: float = _RECONNECT_S) -> Flow[None]:
        """Reconnect after a loss, with the same recipes; the stream stays paused if it was."""
        return self.core.reconnect(within_s)


class RTDEClient(_RTDE, AsyncConnection):
    """RTDE client for asyncio programs; use it with ``async with``.

    Entering the context connects, sets up the recipes and starts the stream of states. One task may receive while
    others write. Options are those of `RTDECore`.
    """


class BlockingRTDEClient(_RTDE, BlockingConnection):
    """Blocking counterpart of `RTDEClient`, for scripts, notebooks and control loops; use it with ``with``."""

    def states(self, silence_s: float) -> Iterator[ReceivedState]:
        """Yield every state from now on, with as little overhead as possible; meant for a dedicated thread.

        Raises NoAnswerError if nothing arrives for ``silence_s`` [s], and ConnectionLostError.
        """
        yield from self.core.take(b"", time.monotonic())
        for data in self.chunks(silence_s):
            yield from self.core.take(data, time.monotonic())
