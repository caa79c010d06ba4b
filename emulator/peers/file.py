"""Read peers from YAML: the format is described in docs/peers.md."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Final, TypeAlias, TypeVar
from urllib.parse import urlsplit
from xmlrpc.client import Fault

from msgspec import Meta, Struct

from emulator.peers.answers import (
    Computed,
    Dialogue,
    Method,
    Replies,
    Reply,
    ReplyTemplate,
    Seconds,
    Text,
    TextCode,
    XmlRpcMethods,
    cut_all,
    cut_at,
    cut_size,
)
from emulator.peers.connection import Announcement, Peers, SocketPeer
from emulator.peers.log import Pattern, PeerLog, PeersError
from emulator.peers.modbus import UnitPeer, Values
from urproto.structures import InvalidYamlError, converted, load_yaml

_HTTP_PORT: Final = 80
_PYTHON: Final = re.compile(r"(.+\.py):([A-Za-z_]\w*)")

_Word: TypeAlias = Annotated[int, Meta(ge=0, le=0xFFFF)]
_ReplyTemplate: TypeAlias = ReplyTemplate | Text
_Several: TypeAlias = Annotated[list[_ReplyTemplate], Meta(min_length=1)]
_Values: TypeAlias = dict[_Word, _Word | Annotated[list[_Word], Meta(min_length=1)]]
_ItemT = TypeVar("_ItemT")


class _File(Struct, forbid_unknown_fields=True):
    sockets: dict[str, Any] = {}
    xmlrpc: dict[str, Any] = {}
    modbus: dict[str, Any] = {}


class _Peer(Struct, forbid_unknown_fields=True):
    expect: list[Text] | Text = []
    delay: Seconds = 0.0
    refuse: bool | Annotated[int, Meta(ge=0)] = False

    def log(self, name: str) -> PeerLog:
        return PeerLog(name, [Pattern.parse(str(text)) for text in _list(self.expect)])

    @property
    def refusals(self) -> float:
        return math.inf if self.refuse is True else int(self.refuse)


class _Sending(Struct, forbid_unknown_fields=True):
    text: Text = ""
    after: Seconds | None = None
    every: Annotated[float, Meta(gt=0.0)] = math.inf
    close: bool = False


class _Socket(_Peer):
    greeting: Text = ""
    answers: str | dict[Text, _ReplyTemplate | _Several] = {}
    state: dict[str, Text] = {}
    delimiter: Annotated[str, Meta(min_length=1)] = ""
    size: Annotated[int, Meta(ge=1)] = 0
    binary: bool = False
    sends: list[_Sending] = []


class _Methods(_Peer):
    methods: str | dict[str, Any] = {}


class _Unit(_Peer):
    coils: _Values = {}
    registers: _Values = {}
    device: str = ""
    disconnect: Annotated[float, Meta(gt=0.0)] = math.inf
    exception: _Word = 0


def read_peers(path: Path) -> Peers:
    """The peers that a file describes. Raises PeersError or OSError."""
    try:
        content = load_yaml(path.read_bytes())
    except InvalidYamlError as error:
        raise PeersError(f"{path} is not YAML: {error}") from error
    return parse_peers(content, str(path), path.parent)


def parse_peers(content: Any, where: str, folder: Path) -> Peers:
    """The peers that data describes. where: for messages. folder: of the Python files it names. Raises PeersError."""
    whole = converted(content, _File, where, PeersError)
    python = _Python(folder)
    peers = Peers({}, {})
    for name, entry in whole.sockets.items():
        peers.sockets[_address(name, where)] = _socket_peer(name, entry, f"{where}: {name}", python)
    for url, entry in whole.xmlrpc.items():
        peers.sockets[_url(url, where)] = _xmlrpc_peer(url, entry, f"{where}: {url}", python)
    for host, entry in whole.modbus.items():
        peers.units[host] = _unit(host, entry, f"{where}: {host}", python)
    return peers


@dataclass
class _Python:
    """The Python files in a folder, each executed once for all peers of a run."""

    folder: Path
    modules: dict[str, ModuleType] = field(default_factory=dict)

    def object(self, text: str, where: str) -> Any:
        """The object ``file.py:name``; a class is called without arguments. Raises PeersError."""
        found = _PYTHON.fullmatch(text)
        if found is None:
            raise PeersError(f"{where}: {text!r} is not of the form file.py:name")
        try:
            if found[1] not in self.modules:
                path = self.folder / found[1]
                self.modules[found[1]] = module = ModuleType(path.stem)
                module.__file__ = str(path)
                exec(compile(path.read_bytes(), path, "exec"), module.__dict__)
            named = getattr(self.modules[found[1]], found[2])
            return named() if isinstance(named, type) else named
        except Exception as error:
            raise PeersError(f"{where}: {text}: {type(error).__name__}: {error}") from error


# sockets


def _socket_peer(name: str, entry: Any, where: str, python: _Python) -> SocketPeer:
    described = converted(entry, _Socket, where, PeersError)
    code, log, state = TextCode(described.binary), described.log(name), described.state
    if isinstance(described.answers, str):
        reply: Callable[[bytes, str], Reply] = Computed(python.object(described.answers, where))
    else:
        reply = _replies(described.answers, state, code, where)
    sendings = [_Sending(described.greeting), *described.sends] if described.greeting else described.sends
    announcements = [_announcement(one, state, code, where) for one in sendings]
    answerer = Dialogue(log, code, _cutter(described, code, where), reply)
    return SocketPeer(log, answerer, announcements, described.delay, described.refusals)


def _replies(
    answers: Mapping[Text, ReplyTemplate | Text | list[ReplyTemplate | Text]],
    state: dict[str, Text],
    code: TextCode,
    where: str,
) -> Replies:
    rows = [(Pattern.parse(str(key)), [*map(_template, _list(value))]) for key, value in answers.items()]
    for pattern, replies in rows:
        for name in (*pattern.expression.groupindex, *(name for reply in replies for name in reply.changes)):
            state.setdefault(name, "")
    for _, replies in rows:
        for reply in replies:
            _filled(reply, state, code, where)
    return Replies(code, state, [(pattern, _repeat_last(replies)) for pattern, replies in rows])


def _template(value: ReplyTemplate | Text) -> ReplyTemplate:
    return value if isinstance(value, ReplyTemplate) else ReplyTemplate(value)


def _filled(reply: ReplyTemplate, state: Mapping[str, Text], code: TextCode, where: str) -> Reply:
    """The reply as it is at first. Raises PeersError."""
    if unknown := reply.variables - state.keys():
        raise PeersError(f"{where}: there is no variable {min(unknown)}: add it to 'state', or name a group so")
    try:
        return reply.fill(dict(state), code)
    except ValueError as error:
        raise PeersError(f"{where}: {reply.reply!r} is not hexadecimal: {error}") from error


def _announcement(one: _Sending, state: Mapping[str, Text], code: TextCode, where: str) -> Announcement:
    first_s = one.after if one.after is not None else one.every if one.every < math.inf else 0.0
    return Announcement(_filled(ReplyTemplate(one.text, first_s, one.close), state, code, where), one.every)


def _cutter(described: _Socket, code: TextCode, where: str) -> Callable[[bytearray, bool], Iterator[bytes]]:
    """By size, at a delimiter or, without either, at line feeds and after a control period without further data."""
    if described.size:
        return lambda buffer, idle: cut_size(described.size, buffer)
    if described.delimiter:
        delimiter = _filled(ReplyTemplate(described.delimiter), {}, code, where).data
        return lambda buffer, idle: cut_at(delimiter, buffer)
    return partial(_cut_lines, code)


def _cut_lines(code: TextCode, buffer: bytearray, idle: bool) -> Iterator[bytes]:
    if not code.binary:
        yield from cut_at(b"\n", buffer)
    if idle:
        yield from cut_all(buffer)


# XML-RPC and Modbus


def _xmlrpc_peer(name: str, entry: Any, where: str, python: _Python) -> SocketPeer:
    simple = isinstance(entry, Mapping) and "methods" not in entry
    described = converted({"methods": entry} if simple else entry, _Methods, where, PeersError)
    if isinstance(described.methods, str):
        methods = python.object(described.methods, where)
    else:
        methods = {key: _method(value) for key, value in described.methods.items()}
    log = described.log(name)
    return SocketPeer(log, XmlRpcMethods(log, methods), (), described.delay, described.refusals)


def _method(value: Any) -> Method:
    """Returns the value; of ``{each: [...]}``, one after the other; for ``{fault: text}``, it raises a fault."""
    keys = set(value) if isinstance(value, Mapping) else set()
    values = _repeat_last(_list(value["each"]) if keys == {"each"} else [value])

    def call(*_arguments: Any) -> Any:
        result = next(values)
        if isinstance(result, Mapping) and set(result) == {"fault"}:
            raise Fault(1, str(result["fault"]))
        return result

    return call


def _unit(name: str, entry: Any, where: str, python: _Python) -> UnitPeer:
    described = converted(entry, _Unit, where, PeersError)
    device = python.object(described.device, where) if described.device else None
    return UnitPeer(
        described.log(name),
        getattr(device, "coils", None) or Values(described.coils),
        getattr(device, "registers", None) or Values(described.registers),
        refusals=described.refusals,
        delay_s=described.delay,
        lasts_s=described.disconnect,
        exception=described.exception,
        written=getattr(device, "written", lambda kind, address, value: None),
    )


# parts of entries


def _repeat_last(values: list[_ItemT]) -> Iterator[_ItemT]:
    yield from values
    while True:
        yield values[-1]


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _address(text: str, where: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or re.fullmatch("[0-9]{1,5}", port) is None or not 0 < int(port) < 65536:
        raise PeersError(f"{where}: {text!r} is not an address: give host:port, for example 192.168.1.10:5000")
    return host.strip("[]"), int(port)


def _url(text: str, where: str) -> tuple[str, int]:
    parts = urlsplit(text)
    if parts.scheme != "http" or not parts.hostname:
        raise PeersError(f"{where}: {text!r} is not an XML-RPC address: give http://host:port")
    return parts.hostname, parts.port or _HTTP_PORT
