"""The negotiated recipes of a recorded RTDE connection: the states that the robot sent, and what the client wrote."""

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
    """The data of one package, as it was sent. inputs: number of input packages that the client had sent before."""

    time_ns: int
    data: bytes
    inputs: int


@dataclass(slots=True)
class RecordedRecipe:
    """A recipe of outputs or inputs, and its packages. recipe: None if a variable was refused, or of unknown type."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    frequency_hz: float | None = None
    rows: list[Row] = field(default_factory=list)
    recipe: Recipe | None = field(init=False)

    def __post_init__(self) -> None:
        self.recipe = Recipe.of_reply(self.names, self.types)

    @property
    def size(self) -> int:
        """Size of a package in bytes."""
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
        self.outputs: list[RecordedRecipe] = []
        self.inputs: list[RecordedRecipe] = []
        self.version: PolyscopeVersion | None = None
        self.problem: str | None = None
        self._recipes: dict[int, RecordedRecipe] = {}  # of outputs, by id
        self._written: dict[int, RecordedRecipe] = {}  # of inputs
        self._requests: deque[tuple[codec.Request, int]] = deque()
        self._protocol = 1
        self._input_count = 0
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
                    self._from_client(packages, piece.time_ns)
        except RemoteProtocolError as error:
            self.problem = str(error)
        if self._unnamed and self.problem is None:
            self.problem = f"{self._unnamed} states have no names: their set-up is not in the recording"

    def _from_client(self, packages: Iterable[codec.Package], time_ns: int) -> None:
        for package in packages:
            request = codec.decode_request(package, self._protocol)
            if isinstance(request, codec.InputData):
                self._input_count += 1
                recipe = self._written.get(request.recipe_id)
                if recipe is not None and len(request.data) == recipe.size:  # the robot ignores others
                    recipe.rows.append(Row(time_ns, request.data, self._input_count))
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
            recipe.rows.append(Row(time_ns, state.data, self._input_count))

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
                outputs = RecordedRecipe(request.names, reply.types, request.frequency_hz)
                _add(outputs, self.outputs, self._recipes, reply.recipe_id)
            case codec.SetupInputs(), codec.SetupInputsReply():
                _add(RecordedRecipe(request.names, reply.types), self.inputs, self._written, reply.recipe_id)


def _add(
    recorded: RecordedRecipe, all_: list[RecordedRecipe], by_id: dict[int, RecordedRecipe], recipe_id: int
) -> None:
    if recorded.recipe is not None:
        all_.append(recorded)
        by_id[recipe_id] = recorded
