"""RTDE packages as text. The content of a data package is known from the set-up before it.

The two directions of a connection complete each other: a request names the variables, the
reply has their types and the recipe's number. With one direction only, values are shown
without names (replies alone), or under the names of the n-th request for recipe n
(requests alone); without either, as they came.
"""

import struct
from collections import deque
from collections.abc import Iterator
from enum import Enum

from client.decoding import formatting
from client.decoding.streams import FramedStream, Framing, Line
from urproto.errors import RemoteProtocolError
from urproto.modes import mode_name
from urproto.rtde import codec
from urproto.rtde.codec import PackageType
from urproto.rtde.fields import IN_USE, INPUT_FIELDS, NOT_FOUND, WIRE_TYPES
from urproto.rtde.recipes import Recipe, type_names

_HEADER = struct.Struct(">HB")
_MAX_RECIPES = 256  # range of a recipe's number
_MAX_UNANSWERED = 16  # requests remembered; guess: clients wait for each answer
_WORDS = {*WIRE_TYPES, NOT_FOUND, IN_USE}

# packages with fixed sizes: request, reply
_SIZES = {
    PackageType.REQUEST_PROTOCOL_VERSION: (5, 4),
    PackageType.GET_URCONTROL_VERSION: (3, 19),
    PackageType.START: (3, 4),
    PackageType.PAUSE: (3, 4),
}


class Sender(Enum):
    """The sender of a package."""

    ROBOT = "robot"
    CLIENT = "client"


def _size(header: bytes) -> int:
    size, kind = _HEADER.unpack_from(header)
    if kind not in list(PackageType):
        raise RemoteProtocolError(f"no package has type {kind}")
    if size < _HEADER.size:
        raise RemoteProtocolError(f"no package has size {size}")
    return int(size)


def _likely(header: bytes) -> bool:
    size, kind = _HEADER.unpack_from(header)
    return size in _SIZES.get(kind, (size,))


FRAMING = Framing("RTDE", _HEADER.size, _size, _likely)


def sender_of(data: bytes) -> Sender | None:
    """The sender that this package must have; None if both are possible."""
    size, kind = _HEADER.unpack_from(data)
    if kind in _SIZES:
        request, reply = _SIZES[PackageType(kind)]
        return {request: Sender.CLIENT, reply: Sender.ROBOT}.get(size)
    if kind in (PackageType.SETUP_INPUTS, PackageType.SETUP_OUTPUTS):
        last = data[_HEADER.size :].rpartition(b",")[2].decode("ascii", "replace")
        return Sender.ROBOT if any(last.endswith(word) for word in _WORDS) else Sender.CLIENT
    return None


class _Recipe:
    """The known parts of a recipe: types, and names if the request was captured."""

    def __init__(self, names: tuple[str, ...], types: tuple[str, ...], note: str = "") -> None:
        self._names = names if len(names) == len(types) else types
        self._note = note
        self._recipe = Recipe.of_reply(self._names, types)

    def format(self, data: bytes) -> str | None:
        """The values; None if the bytes do not match this recipe."""
        if self._recipe is None or len(data) != self._recipe.size:
            return None
        return formatting.pairs(zip(self._names, self._recipe.unpack(data), strict=True)) + self._note


class _RecipeSetups:
    """The recipes of one direction: unanswered requests, and recipes by number."""

    def __init__(self) -> None:
        self._requests: deque[tuple[str, ...]] = deque(maxlen=_MAX_UNANSWERED)
        self._count = 0
        self._recipes: dict[int, _Recipe] = {}

    def add_request(self, names: tuple[str, ...]) -> None:
        """Note a request; its recipe is assumed to get the next number until a reply arrives."""
        self._requests.append(names)
        self._count += 1
        types = type_names(names, INPUT_FIELDS)
        if self._count < _MAX_RECIPES:
            self._recipes.setdefault(self._count, _Recipe(names, types, " (recipe guessed, no reply was seen)"))

    def add_reply(self, number: int, types: tuple[str, ...]) -> None:
        """Note a reply to the oldest unanswered request."""
        names = self._requests.popleft() if self._requests else ()
        self._recipes[number] = _Recipe(names, types)

    def format(self, number: int, data: bytes) -> str:
        """A data package as text, as far as its recipe is known."""
        known = self._recipes.get(number)
        text = known.format(data) if known else None
        if text is not None:
            return text
        why = "it does not fit the recipe" if known else "the recipe's set-up was not seen"
        return f"{_raw(data)} ({why})"


class RTDEConversation:
    """Both directions of one connection. unknown: a stream whose direction is recognised from its packages."""

    def __init__(self) -> None:
        self._protocol = 1
        self._protocol_known = False  # whether the protocol version is certain
        self._requested_protocol = codec.KNOWN_PROTOCOLS[-1]  # if only replies were captured
        self._outputs = _RecipeSetups()
        self._inputs = _RecipeSetups()
        self._unknown = Sender.ROBOT
        self.from_robot = FramedStream(FRAMING, self._from_robot)
        self.from_client = FramedStream(FRAMING, self._from_client)
        self.unknown = FramedStream(FRAMING, self._from_unknown)

    def _from_unknown(self, data: bytes) -> Iterator[Line]:
        self._unknown = sender_of(data) or self._unknown
        yield from (self._from_robot if self._unknown is Sender.ROBOT else self._from_client)(data)

    def _from_robot(self, data: bytes) -> Iterator[Line]:
        package = _package(data)
        if package.type == PackageType.SETUP_OUTPUTS and package.payload[:1] < b"A":
            self._protocol, self._protocol_known = 2, True  # a number comes first; types begin with a letter
        reply = codec.decode_reply(package, self._protocol)
        match reply:
            case codec.ProtocolReply():
                self._protocol, self._protocol_known = (self._requested_protocol if reply.accepted else 1), True
            case codec.SetupOutputsReply():
                self._protocol_known = True
                self._outputs.add_reply(reply.recipe_id, reply.types)
            case codec.SetupInputsReply():
                self._inputs.add_reply(reply.recipe_id, reply.types)
            case codec.OutputData() if not self._protocol_known:
                yield Line(f"data: {_raw(package.payload)} (the set-up was not seen)")
                return
            case codec.OutputData():
                yield Line(f"data {reply.recipe_id}: {self._outputs.format(reply.recipe_id, reply.data)}")
                return
        yield _describe("reply", package.type, reply)

    def _from_client(self, data: bytes) -> Iterator[Line]:
        package = _package(data)
        if package.type == PackageType.SETUP_OUTPUTS and package.payload[:1] in (b"?", b"@"):
            # a frequency from 2^-255 Hz up comes first, never the start of a name
            self._protocol, self._protocol_known = 2, True
        request = codec.decode_request(package, self._protocol)
        match request:
            case codec.RequestProtocol():
                self._requested_protocol = request.version
            case codec.SetupOutputs():
                self._outputs.add_request(request.names)
            case codec.SetupInputs():
                self._inputs.add_request(request.names)
            case codec.InputData():
                yield Line(f"input {request.recipe_id}: {self._inputs.format(request.recipe_id, request.data)}")
                return
        yield _describe("request", package.type, request)


def _raw(data: bytes) -> str:
    return f"{len(data)} bytes {formatting.value(data)}"


def _package(data: bytes) -> codec.Package:
    size, kind = _HEADER.unpack_from(data)
    return codec.Package(kind, data[_HEADER.size : size])


def _describe(what: str, kind: int, item: object) -> Line:
    name = PackageType(kind).name.lower()
    if isinstance(item, codec.TextMessage | codec.ClientMessage):
        level = mode_name(codec.MessageLevel, item.level)
        return Line(f"{name} {level}: {formatting.quoted(item.text)} from {formatting.quoted(item.source)}")
    if isinstance(item, codec.VersionReply):
        return Line(f"{what} {name}: {item.version}")
    return Line(f"{what} {name}: {formatting.message(item)}".removesuffix(": "))
