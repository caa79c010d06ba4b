"""The negotiated recipes of a recorded RTDE connection, and their states."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from client.traffic.recording import Conversation
from urproto.errors import RemoteProtocolError
from urproto.rtde import codec
from urproto.rtde.codec import PackageType
from urproto.rtde.recipes import Recipe
from urproto.versions import PolyscopeVersion


@dataclass(frozen=True, slots=True)
class Row:
    """The data of one state, as it was sent. inputs: number of input packages that the client had sent before."""

    time_ns: int
    data: bytes
    inputs: int


@dataclass(slots=True)
class Outputs:
    """A recipe of outputs, and its states. recipe: None if a variable was refused, or if its type is unknown."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    frequency_hz: float | None
    rows: list[Row] = field(default_factory=list)
    recipe: Recipe | None = field(init=False)

    def __post_init__(self) -> None:
        self.recipe = Recipe.of_reply(self.names, self.types)

    @property
    def size(self) -> int:
        """Size of a state in bytes."""
        return 0 if self.recipe is None else self.recipe.size

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Values by name, vectors as tuples. Raises RemoteProtocolError for a wrong size."""
        assert self.recipe is not None
        return dict(self.recipe.values(data))


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request and its reply. protocol: version of the protocol of both."""

    request: codec.Request
    reply: codec.Reply
    protocol: int


class RTDELog:
    """One decoded connection. problem: why it could not be read to its end; None if it could."""

    def __init__(self, conversation: Conversation) -> None:
        self.exchanges: list[Exchange] = []
        self.outputs: list[Outputs] = []
        self.version: PolyscopeVersion | None = None
        self.problem: str | None = None
        self._recipes: dict[int, Outputs] = {}
        self._requests: deque[tuple[codec.Request, int]] = deque()
        self._protocol = 1
        self._inputs = 0
        self._unnamed = 0
        self._decoders = {True: codec.RTDEDecoder(), False: codec.RTDEDecoder()}
        self._read(conversation)

    def _read(self, conversation: Conversation) -> None:
        try:
            for piece in conversation.pieces:
                packages = self._decoders[piece.from_server].feed(piece.data)
                if piece.from_server:
                    self._from_robot(packages, piece.time_ns)
                else:
                    self._from_client(packages)
        except RemoteProtocolError as error:
            self.problem = str(error)
        if self._unnamed and self.problem is None:
            self.problem = f"{self._unnamed} states have no names: their set-up is not in the recording"

    def _from_client(self, packages: Iterable[codec.Package]) -> None:
        for package in packages:
            request = codec.decode_request(package, self._protocol)
            if isinstance(request, codec.InputData):
                self._inputs += 1
            elif not isinstance(request, codec.ClientMessage):
                self._requests.append((request, package.type))

    def _from_robot(self, packages: Iterable[codec.Package], time_ns: int) -> None:
        for package in packages:
            reply = codec.decode_reply(package, self._protocol)
            if isinstance(reply, codec.OutputData):
                self._state(reply, time_ns)
            elif package.type != PackageType.TEXT_MESSAGE:
                self._add_reply(reply, package.type)

    def _state(self, state: codec.OutputData, time_ns: int) -> None:
        recipe = self._recipes.get(state.recipe_id)
        if recipe is None:
            self._unnamed += 1
        elif len(state.data) != recipe.size:
            raise RemoteProtocolError(f"a state has {len(state.data)} bytes, its recipe {recipe.size}")
        else:
            recipe.rows.append(Row(time_ns, state.data, self._inputs))

    def _add_reply(self, reply: codec.Reply, kind: int) -> None:
        while self._requests:
            request, request_kind = self._requests.popleft()
            if request_kind == kind:
                self.exchanges.append(Exchange(request, reply, self._protocol))
                self._apply_reply(request, reply)
                return

    def _apply_reply(self, request: codec.Request, reply: codec.Reply) -> None:
        match request, reply:
            case codec.RequestProtocol(), codec.ProtocolReply(accepted=True):
                self._protocol = request.version
            case codec.GetVersion(), codec.VersionReply():
                self.version = reply.version
            case codec.SetupOutputs(), codec.SetupOutputsReply():
                self._add_recipe(Outputs(request.names, reply.types, request.frequency_hz), reply)

    def _add_recipe(self, outputs: Outputs, reply: codec.SetupOutputsReply) -> None:
        if outputs.recipe is not None:
            self.outputs.append(outputs)
            self._recipes[reply.recipe_id] = outputs
