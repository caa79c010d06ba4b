"""Data exchange with a robot: receive its state at a fixed rate, write its inputs.

    async with RTDEClient("192.168.56.101", ["timestamp", "actual_q"], frequency_hz=125) as rtde:
        state = await rtde.receive()          # {"timestamp": 41.2, "actual_q": (0.0, ...)}

    with BlockingRTDEClient("192.168.56.101", Path("outputs.txt"), [["input_int_register_24"]]) as rtde:
        state = rtde.latest()                 # the newest, however slow the loop is
        rtde.write(input_int_register_24=7)

Variables and their types are those of urproto.rtde.fields. A recipe the robot refuses is a
RobotRefused that names the variables. Options are those of RTDECore.
"""

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from client.connection import DEFAULT_TIMEOUT_S, POLL, AsyncConnection, BlockingConnection, Connection, Flow, Reconnect
from client.errors import ConnectionLostError, NoAnswerError, RobotUnreachableError
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.rtde.types import IN_USE, NOT_FOUND
from urproto.versions import PolyscopeVersion

Names = Sequence[str] | Path  # variables, or a file that lists them

_CLOSE_NAMES = 5  # told to who wrote a wrong one
_MASK = "_mask"  # these choose what the same package changes, so they are not kept from one write to the next


def read_recipe(path: Path) -> tuple[str, ...]:
    """The variables of a file with one name a line. Blank lines and what follows a ``#`` do not count.

    Raises OSError when the file cannot be read and LocalProtocolError when it is not a list of names.
    """
    lines = (line.partition("#")[0].strip() for line in path.read_text("utf-8-sig").splitlines())
    names = tuple(line for line in lines if line)
    odd = [name for name in names if not name.isidentifier()]
    if odd:
        raise LocalProtocolError(f"{path}: {odd[0]!r} is not a variable: give one name a line")
    if not names:
        raise LocalProtocolError(f"{path} names no variable")
    return names


def variable_names(names: Names) -> tuple[str, ...]:
    """The variables, read from their file if need be."""
    if isinstance(names, str):
        raise LocalProtocolError(f"a recipe is a list of names or the Path of a file, not the text {names!r}")
    return read_recipe(names) if isinstance(names, Path) else tuple(names)


def unknown_fields(names: Iterable[str]) -> str | None:
    """What is wrong with the names of outputs, and what may have been meant; None when nothing is."""
    for name in names:
        if name not in OUTPUT_FIELDS:
            close = get_close_matches(name, OUTPUT_FIELDS, _CLOSE_NAMES, 0.5)
            hint = f"did you mean {', '.join(close)}?" if close else "docs/supported.md lists them"
            return f"no RTDE output is called {name!r}: {hint}"
    return None


class InputRecipes:
    """The input recipes of one connection, and the values last written to each variable.

    A variable that was never written counts as 0, false or zeros. Masks are 0 in every
    package that does not name them: it leaves alone what they guard.
    """

    def __init__(self, recipes: Iterable[Names]) -> None:
        self.recipes = [Recipe.of(variable_names(names), INPUT_FIELDS) for names in recipes]
        self._last: dict[str, Any] = {}

    def add(self, names: Names) -> Recipe:
        """One more."""
        self.recipes.append(Recipe.of(variable_names(names), INPUT_FIELDS))
        return self.recipes[-1]

    def exactly(self, names: Collection[str]) -> int:
        """Index of the recipe that has exactly these variables. Raises LocalProtocolError."""
        for index, recipe in enumerate(self.recipes):
            if set(recipe.names) == set(names):
                return index
        raise LocalProtocolError(f"no input recipe has exactly the variables {', '.join(sorted(names))}")

    def covering(self, names: Collection[str]) -> list[int]:
        """Indices of few recipes that have all these variables: one if possible. Raises LocalProtocolError."""
        left, chosen = set(names), list[int]()
        while left:
            best = max(range(len(self.recipes)), key=lambda index: self._worth(index, left), default=0)
            if not self.recipes or left.isdisjoint(self.recipes[best].names):
                raise LocalProtocolError(f"no input recipe has {', '.join(sorted(left))}: name it when connecting")
            chosen.append(best)
            left -= set(self.recipes[best].names)
        return chosen

    def _worth(self, index: int, wanted: set[str]) -> tuple[int, int]:
        """Most of the wanted variables first, then the fewest others."""
        names = self.recipes[index].names
        return len(wanted.intersection(names)), -len(names)

    def pack(self, index: int, values: Mapping[str, Any]) -> bytes:
        """The data of a recipe: these values, and the last ones of its other variables.

        Raises LocalProtocolError for a value that does not fit; then nothing is remembered.
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

_KEPT_MESSAGES = 100  # text messages kept for the caller; older ones are dropped
_AGREEING_ATTEMPTS = 10  # after a loss; guess: a booting controller closes its first connections
_BETWEEN_ATTEMPTS_S = 0.5
_LOST = (ConnectionLostError, NoAnswerError, RobotUnreachableError)


class RTDECore:
    """Flows of one connection, and what is known about it.

    outputs: the variables to receive, none for a client that only writes. inputs: the
    recipes to write, each a list of variables. Either may be the Path of a file with one
    name a line. frequency_hz: how often to receive, the robot's full rate by default.
    ignore_unavailable: go without the outputs this robot does not have; ``unavailable``
    names them. reconnect_s: how long to try to come back after a loss [s]; 0 is not at all.

    state: the newest state received, empty before the first. skipped: states ``latest`` has
    passed over. reconnects: how often the connection came back. messages: the robot's texts.
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
        if frequency_hz is not None and not 0.0 < frequency_hz < math.inf:
            raise LocalProtocolError(f"a robot cannot send {frequency_hz} times a second: give a positive number")
        self.version: PolyscopeVersion | None = None
        self.messages: deque[codec.TextMessage] = deque(maxlen=_KEPT_MESSAGES)
        self.state: State = {}
        self.unavailable: frozenset[str] = frozenset()
        self.rate_hz = 0.0  # at which states come, once that is agreed on
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
        self._forget()

    def _forget(self) -> None:
        """What belonged to the last connection is over."""
        self._protocol = 1
        self._decoder = codec.RTDEDecoder()
        self._replies: deque[codec.Reply] = deque()
        self._arrived: deque[bytes] = deque()  # payloads of data packages
        self.running = False

    # what a client does

    def start(self) -> Flow[None]:
        """Agree on protocol and recipes over a new connection, and let the data flow."""
        self._forget()
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
        """Let no more states come until ``resume``; those on their way are dropped."""
        if not (yield from self._request(codec.Pause(), codec.PauseReply)).accepted:
            raise RobotRefused("pause of the data exchange", "not accepted")
        self._arrived.clear()
        self._paused, self.running = True, False

    def resume(self) -> Flow[None]:
        """Let states come again."""
        self._paused = False
        yield from self._start()

    def receive(self) -> Flow[State]:
        """The next state, by variable name; in order, none skipped."""
        return (yield from self._surviving(self._receive))

    def latest(self) -> Flow[State]:
        """The newest state that has arrived, older ones are skipped; waits when none came since the last."""
        return (yield from self._surviving(self._latest))

    def send(self, values: State) -> Flow[None]:
        """Write inputs; ``values`` must name exactly the variables of one input recipe."""
        yield self._input_package(self._inputs.exactly(values), values)

    def write(self, values: State) -> Flow[None]:
        """Write any inputs of the recipes; their other variables keep the last value (see InputRecipes)."""
        packages = [self._input_package(index, values) for index in self._inputs.covering(values)]
        yield b"".join(packages)

    def add_inputs(self, names: Names) -> Flow[None]:
        """Agree on another input recipe; a connection without outputs may do so at any time."""
        recipe = self._inputs.add(names)
        try:
            yield from self._set_up_inputs(recipe)
        except BaseException:
            self._inputs.recipes.remove(recipe)
            raise

    def say(self, text: str, source: str = "", level: codec.MessageLevel = codec.MessageLevel.INFO) -> Flow[None]:
        """Write a line to the controller's log; text and source are cut at 255 bytes."""
        yield codec.ClientMessage(text, source, level).encode(self._protocol)

    def reconnect(self, within_s: float) -> Flow[None]:
        """Open the connection again and agree on the same things. Raises the last attempt's error."""
        after_s = 0.0
        for attempt in range(1, _AGREEING_ATTEMPTS + 1):
            self.running = False
            try:
                yield Reconnect(within_s, after_s)
                yield from self.start()
            except (ConnectionLostError, NoAnswerError, RobotRefused):  # still booting, or our inputs not yet released
                if attempt == _AGREEING_ATTEMPTS:
                    raise
                after_s = _BETWEEN_ATTEMPTS_S
            else:
                self.reconnects += 1
                return

    # receiving

    def _surviving(self, what: Callable[[], Flow[State]]) -> Flow[State]:
        while True:
            try:
                return (yield from what())
            except _LOST:
                if not self._reconnect_s:
                    raise
            yield from self.reconnect(self._reconnect_s)

    def _receive(self) -> Flow[State]:
        self._check_running()
        while not self._arrived:
            self._take((yield None))
        return self._read(self._arrived.popleft())

    def _latest(self) -> Flow[State]:
        self._check_running()
        try:
            while data := (yield POLL):
                self._take(data)
        except _LOST:
            if not self._arrived:  # else what came before the loss counts; the next call notices again
                raise
        while not self._arrived:
            self._take((yield None))
        self.skipped += len(self._arrived) - 1
        newest = self._arrived.pop()
        self._arrived.clear()
        return self._read(newest)

    def _check_running(self) -> None:
        if not self._wanted:
            raise LocalProtocolError("this connection has no outputs to receive: name some when connecting")
        if self._paused:
            raise LocalProtocolError("the data exchange is paused: resume it to receive states")

    def _read(self, data: bytes) -> State:
        self.state = self._outputs.values(data, 0 if self._protocol == 1 else 1)  # after the recipe id
        return self.state

    def take(self, data: bytes) -> list[State]:
        """The states that these bytes from the robot complete, for who reads the connection himself."""
        self._take(data)
        states = [self._read(arrived) for arrived in self._arrived]
        self._arrived.clear()
        return states

    # writing

    def _input_package(self, index: int, values: State) -> bytes:
        data = self._inputs.pack(index, values)
        if index >= len(self._input_ids):
            raise LocalProtocolError("the input recipes are not agreed on: connect first")
        return codec.InputData(self._input_ids[index], data).encode(self._protocol)

    # agreeing

    def _set_up_outputs(self, version: PolyscopeVersion) -> Flow[None]:
        most_hz = version.series.frequency_hz
        frequency_hz = self._frequency_hz or float(most_hz)
        if frequency_hz > most_hz:
            raise LocalProtocolError(
                f"a {version.series.value} sends at most {most_hz} times a second, not {frequency_hz:g}: ask for less"
            )
        available = self._wanted
        reply = yield from self._request(codec.SetupOutputs(available, frequency_hz), codec.SetupOutputsReply)
        if self._ignore_unavailable and NOT_FOUND in reply.types:
            available = _found(available, reply.types)
            reply = yield from self._request(codec.SetupOutputs(available, frequency_hz), codec.SetupOutputsReply)
        self._outputs = Recipe.of(available, OUTPUT_FIELDS)
        _check(self._outputs, reply.types)
        self.unavailable = frozenset(self._wanted) - frozenset(available)
        every = 1 if self._protocol == 1 else int(most_hz / frequency_hz + 1e-9)  # the guide: whole periods
        self.rate_hz = most_hz / every

    def _set_up_inputs(self, recipe: Recipe) -> Flow[None]:
        reply = yield from self._request(codec.SetupInputs(recipe.names), codec.SetupInputsReply)
        _check(recipe, reply.types)
        self._input_ids.append(reply.recipe_id)

    def _start(self) -> Flow[None]:
        self._arrived.clear()  # of an earlier start
        if not (yield from self._request(codec.Start(), codec.StartReply)).accepted:
            raise RobotRefused("start of the data exchange", "not accepted", "the robot's text messages may say why")
        self.running = True

    def _request(self, request: codec.Request, kind: type[ReplyKind]) -> Flow[ReplyKind]:
        yield request.encode(self._protocol)
        while not self._replies:
            self._take((yield None))
        reply = self._replies.popleft()
        if not isinstance(reply, kind):
            raise RemoteProtocolError(f"a {kind.__name__} was due, a {type(reply).__name__} came")
        return reply

    def _take(self, data: bytes) -> None:
        """Sort what arrived: states, texts, replies."""
        for package in self._decoder.feed(data):
            if package.type == codec.PackageType.DATA_PACKAGE:  # hundreds a second, so it is left as it is until read
                self._arrived.append(package.payload)
                continue
            reply = codec.decode_reply(package, self._protocol)
            if isinstance(reply, codec.TextMessage):
                self.messages.append(reply)
            else:
                self._replies.append(reply)


def _found(names: tuple[str, ...], types: tuple[str, ...]) -> tuple[str, ...]:
    found = tuple(name for name, kind in zip(names, types, strict=False) if kind != NOT_FOUND)
    if not found:
        raise RobotRefused("RTDE recipe", f"it has none of {', '.join(names)}", "ask for other variables")
    return found


def _check(recipe: Recipe, types: tuple[str, ...]) -> None:
    if types == recipe.types:
        return
    if len(types) != len(recipe.types):
        raise RemoteProtocolError(f"{len(types)} types came for {len(recipe.types)} variables")
    pairs = list(zip(recipe.names, types, strict=True))
    refused = [f"{name}: {kind}" for name, kind in pairs if kind in (NOT_FOUND, IN_USE)]
    if refused:
        raise RobotRefused("RTDE recipe", ", ".join(refused), _advice(types))
    wrong = [f"{name} is {kind}" for (name, kind), known in zip(pairs, recipe.types, strict=True) if kind != known]
    raise RemoteProtocolError(f"the robot's types differ from the known ones: {', '.join(wrong)}")


def _advice(types: tuple[str, ...]) -> str:
    if IN_USE in types:
        return "another client (or fieldbus) writes it: close that one, or use other registers"
    return "this controller's version does not have it: leave it out, or ignore unavailable outputs"


PORT = 30004
_RECONNECT_S = 60.0  # guess: a controller boots in about a minute


class _Recipes(Connection):
    """What both shells agree on with the robot."""

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


class RTDEClient(_Recipes, AsyncConnection):
    """RTDE for asyncio programs. Entering connects, agrees on the recipes and starts.

    One task may receive while others write.
    """

    async def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return await self.run(self.core.receive())

    async def latest(self) -> State:
        """The newest state that has arrived; waits when none came since the last one."""
        return await self.run(self.core.latest())

    async def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        await self.run(self.core.send(values))

    async def write(self, **values: Any) -> None:
        """Write some inputs; the others of their recipes keep their last values, masks are 0."""
        await self.run(self.core.write(values))

    async def pause(self) -> None:
        """Let no more states come until ``resume``."""
        await self.run(self.core.pause())

    async def resume(self) -> None:
        """Let states come again."""
        await self.run(self.core.resume())

    async def reconnect(self, within_s: float = _RECONNECT_S) -> None:
        """Come back after a loss, with the same recipes; paused if it was."""
        await self.run(self.core.reconnect(within_s))


class BlockingRTDEClient(_Recipes, BlockingConnection):
    """RTDE for scripts, notebooks and control loops."""

    def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return self.run(self.core.receive())

    def latest(self) -> State:
        """The newest state that has arrived; waits when none came since the last one."""
        return self.run(self.core.latest())

    def states(self, silence_s: float) -> Iterator[State]:
        """Every state from now on, with as little work for each as can be: for a thread that does nothing else.

        Raises NoAnswerError when nothing comes for ``silence_s``, ConnectionLostError.
        """
        yield from self.core.take(b"")
        for data in self.chunks(silence_s):
            yield from self.core.take(data)

    def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        self.run(self.core.send(values))

    def write(self, **values: Any) -> None:
        """Write some inputs; the others of their recipes keep their last values, masks are 0."""
        self.run(self.core.write(values))

    def pause(self) -> None:
        """Let no more states come until ``resume``."""
        self.run(self.core.pause())

    def resume(self) -> None:
        """Let states come again."""
        self.run(self.core.resume())

    def reconnect(self, within_s: float = _RECONNECT_S) -> None:
        """Come back after a loss, with the same recipes; paused if it was."""
        self.run(self.core.reconnect(within_s))
