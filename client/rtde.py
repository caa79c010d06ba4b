"""Data exchange with a robot: receive its state at a fixed rate, write its inputs.

    async with RTDEClient("192.168.56.101", ["timestamp", "actual_q"], frequency_hz=125) as rtde:
        state = await rtde.receive()          # {"timestamp": 41.2, "actual_q": (0.0, ...)}

Variables and their types are those of urproto.rtde.fields. A recipe the robot refuses is a
RobotRefused that names the variables.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Self, TypeVar

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Flow
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe
from urproto.rtde.types import IN_USE, NOT_FOUND
from urproto.versions import PolyscopeVersion

__all__ = ["PORT", "BlockingRTDEClient", "RTDEClient", "RTDECore"]

PORT = 30004
_KEPT_MESSAGES = 100  # text messages kept for the caller; older ones are dropped

ReplyKind = TypeVar("ReplyKind", bound=codec.Reply)
State = Mapping[str, Any]


class RTDECore:
    """One client's side of an RTDE connection, without I/O.

    outputs are the variables to receive, inputs the recipes to write, each a list of
    variables. Without a frequency the robot's full rate is asked for.
    """

    def __init__(
        self, outputs: Sequence[str], inputs: Sequence[Sequence[str]] = (), frequency_hz: float | None = None
    ) -> None:
        self.version: PolyscopeVersion | None = None
        self.messages: deque[codec.TextMessage] = deque(maxlen=_KEPT_MESSAGES)
        self._outputs = Recipe.of(outputs, OUTPUT_FIELDS)
        self._inputs = [Recipe.of(names, INPUT_FIELDS) for names in inputs]
        self._input_ids: dict[frozenset[str], tuple[int, Recipe]] = {}
        self._frequency_hz = frequency_hz
        self._protocol = 1
        self._decoder = codec.RTDEDecoder()
        self._replies: deque[codec.Reply] = deque()

    def start(self) -> Flow[None]:
        """Agree on protocol and recipes, and let the data flow."""
        version = codec.KNOWN_PROTOCOLS[-1]
        if (yield from self._request(codec.RequestProtocol(version), codec.ProtocolReply)).accepted:
            self._protocol = version
        self.version = (yield from self._request(codec.GetVersion(), codec.VersionReply)).version
        yield from self._set_up_outputs(self.version)
        for recipe in self._inputs:
            yield from self._set_up_inputs(recipe)
        if not (yield from self._request(codec.Start(), codec.StartReply)).accepted:
            raise RobotRefused("start of the data exchange", "not accepted")

    def receive(self) -> Flow[State]:
        """The next state, by variable name."""
        reply = yield from self._next_reply(codec.OutputData)
        return dict(zip(self._outputs.names, self._outputs.unpack(reply.data), strict=True))

    def send(self, values: State) -> Flow[None]:
        """Write inputs; ``values`` must name exactly the variables of one input recipe."""
        found = self._input_ids.get(frozenset(values))
        if found is None:
            raise LocalProtocolError(f"no input recipe has exactly the variables {', '.join(sorted(values))}")
        recipe_id, recipe = found
        data = recipe.pack([values[name] for name in recipe.names])
        yield codec.InputData(recipe_id, data).encode(self._protocol)

    def _set_up_outputs(self, version: PolyscopeVersion) -> Flow[None]:
        frequency_hz = self._frequency_hz or float(version.series.frequency_hz)
        request = codec.SetupOutputs(self._outputs.names, frequency_hz)
        reply = yield from self._request(request, codec.SetupOutputsReply)
        _check(self._outputs, reply.types)

    def _set_up_inputs(self, recipe: Recipe) -> Flow[None]:
        reply = yield from self._request(codec.SetupInputs(recipe.names), codec.SetupInputsReply)
        _check(recipe, reply.types)
        self._input_ids[frozenset(recipe.names)] = reply.recipe_id, recipe

    def _request(self, request: codec.Request, kind: type[ReplyKind]) -> Flow[ReplyKind]:
        yield request.encode(self._protocol)
        return (yield from self._next_reply(kind))

    def _next_reply(self, kind: type[ReplyKind]) -> Flow[ReplyKind]:
        """The next reply of a kind. Data of an earlier start is skipped, texts are kept."""
        while True:
            while not self._replies:
                packages = self._decoder.feed((yield None))
                self._replies.extend(codec.decode_reply(package, self._protocol) for package in packages)
            reply = self._replies.popleft()
            if isinstance(reply, kind):
                return reply
            if isinstance(reply, codec.TextMessage):
                self.messages.append(reply)
            elif not isinstance(reply, codec.OutputData):
                raise RemoteProtocolError(f"a {kind.__name__} was due, a {type(reply).__name__} came")


def _check(recipe: Recipe, types: tuple[str, ...]) -> None:
    if types == recipe.types:
        return
    if len(types) != len(recipe.types):
        raise RemoteProtocolError(f"{len(types)} types came for {len(recipe.types)} variables")
    pairs = list(zip(recipe.names, types, strict=True))
    refused = [f"{name}: {kind}" for name, kind in pairs if kind in (NOT_FOUND, IN_USE)]
    if refused:
        raise RobotRefused("RTDE recipe", ", ".join(refused))
    wrong = [f"{name} is {kind}" for (name, kind), known in zip(pairs, recipe.types, strict=True) if kind != known]
    raise RemoteProtocolError(f"the robot's types differ from the known ones: {', '.join(wrong)}")


class RTDEClient(AsyncConnection):
    """RTDE for asyncio programs. Entering connects, agrees on the recipes and starts."""

    def __init__(
        self,
        host: str,
        outputs: Sequence[str],
        inputs: Sequence[Sequence[str]] = (),
        *,
        frequency_hz: float | None = None,
        port: int = PORT,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RTDECore(outputs, inputs, frequency_hz)

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        try:
            await self.run(self.core.start())
        except BaseException:
            await self.close()
            raise
        return self

    async def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return await self.run(self.core.receive())

    async def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        await self.run(self.core.send(values))


class BlockingRTDEClient(BlockingConnection):
    """RTDE for scripts, notebooks and control loops."""

    def __init__(
        self,
        host: str,
        outputs: Sequence[str],
        inputs: Sequence[Sequence[str]] = (),
        *,
        frequency_hz: float | None = None,
        port: int = PORT,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RTDECore(outputs, inputs, frequency_hz)

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            self.run(self.core.start())
        except BaseException:
            self.close()
            raise
        return self

    def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return self.run(self.core.receive())

    def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        self.run(self.core.send(values))
