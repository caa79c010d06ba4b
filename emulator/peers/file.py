"""Read peers from YAML: the format is described in docs/peers.md."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit
from xmlrpc.client import Fault

from emulator.peers.answers import (
    Answerer,
    Computed,
    Dialogue,
    Reply,
    ReplyTemplate,
    TextCode,
    cut_all,
    cut_at,
    cut_size,
)
from emulator.peers.connection import Announcement, Peers, SocketPeer
from emulator.peers.log import Pattern, PeerLog, PeersError
from emulator.peers.modbus import UnitPeer, Values
from emulator.peers.xmlrpc import Method, XmlRpcMethods
from urproto.yamltext import InvalidYamlError, load_yaml

_HTTP_PORT: Final = 80
_PYTHON: Final = re.compile(r"(.+\.py):([A-Za-z_]\w*)")
_COMMON: Final = ("expect", "delay", "refuse")
_SOCKET: Final = ("greeting", "answers", "state", "delimiter", "size", "binary", "sends", *_COMMON)
_REPLY: Final = ("reply", "delay", "close", "set")
_ItemT = TypeVar("_ItemT")


def read_peers(path: Path) -> Peers:
    """The peers that a file describes. Raises PeersError or OSError."""
    try:
        content = load_yaml(path.read_bytes())
    except InvalidYamlError as error:
        raise PeersError(f"{path} is not YAML: {error}") from error
    return parse_peers(content, str(path), path.parent)


def parse_peers(content: Any, where: str, folder: Path) -> Peers:
    """The peers that data describes. where: for messages. folder: of the Python files it names. Raises PeersError."""
    whole = _fields(content, where, ("sockets", "xmlrpc", "modbus"))
    python = _Python(folder)
    sockets, units = {}, {}
    for name, entry in _mapping(whole.get("sockets", {}), f"{where}: sockets").items():
        sockets[_address(str(name), where)] = _socket_peer(str(name), entry, f"{where}: {name}", python)
    for url, entry in _mapping(whole.get("xmlrpc", {}), f"{where}: xmlrpc").items():
        sockets[_url(str(url), where)] = _xmlrpc_peer(str(url), entry, f"{where}: {url}", python)
    for host, entry in _mapping(whole.get("modbus", {}), f"{where}: modbus").items():
        units[str(host)] = _unit(str(host), entry, f"{where}: {host}", python)
    return Peers(sockets, units)


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
    fields = _fields(entry, where, _SOCKET)
    code = TextCode(bool(fields.get("binary", False)))
    log = _log(name, fields, where)
    state = {str(key): _text(value, where) for key, value in _mapping(fields.get("state", {}), where).items()}
    announcements = [_announcement(one, code, state, where) for one in _list(fields.get("sends", []))]
    if "greeting" in fields:
        announcements.insert(0, Announcement(_template(fields["greeting"], where).fill(dict(state), code)))
    answerer = _answerer(fields, log, code, state, where, python)
    return SocketPeer(log, answerer, announcements, _seconds(fields, "delay", where), _refusals(fields, where))


def _answerer(
    fields: Mapping[str, Any], log: PeerLog, code: TextCode, state: dict[str, str], where: str, python: _Python
) -> Answerer:
    cutter = _cutter(fields, code, where)
    answers = fields.get("answers", {})
    if isinstance(answers, str):
        return Computed(log, code, cutter, _function(python.object(answers, where), where))
    rows, known = [], set(state)
    for key, value in _mapping(answers, f"{where}: answers").items():
        pattern = Pattern.parse(str(key))
        replies = [_template(one, where) for one in _list(value)]
        if not replies:
            raise PeersError(f"{where}: a list of answers must not be empty")
        rows.append((pattern, replies))
        known |= {*pattern.expression.groupindex, *(name for reply in replies for name in reply.changes)}
    for _, replies in rows:
        for unknown in sorted(name for reply in replies for name in reply.variables - known):
            raise PeersError(
                f"{where}: there is no variable {unknown}: add it to 'state', or name a group of a pattern"
            )
    state.update(dict.fromkeys(known - state.keys(), ""))
    for _, replies in rows:
        for reply in replies:
            _written(reply, state, code, where)
    return Dialogue(log, code, cutter, state, [(pattern, _repeat_last(replies)) for pattern, replies in rows])


def _cutter(fields: Mapping[str, Any], code: TextCode, where: str) -> Callable[[bytearray, bool], Iterator[bytes]]:
    """By size, at a delimiter or, without either, at line feeds and after a control period without further data."""
    if "size" in fields:
        size = _whole(fields["size"], f"{where}: size", least=1)
        return lambda buffer, idle: cut_size(size, buffer)
    if "delimiter" in fields:
        delimiter = code.write(_text(fields["delimiter"], where))
        if not delimiter:
            raise PeersError(f"{where}: a delimiter must not be empty")
        return lambda buffer, idle: cut_at(delimiter, buffer)
    return partial(_cut_lines, code)


def _cut_lines(code: TextCode, buffer: bytearray, idle: bool) -> Iterator[bytes]:
    if not code.binary:
        yield from cut_at(b"\n", buffer)
    if idle:
        yield from cut_all(buffer)


def _announcement(entry: Any, code: TextCode, state: Mapping[str, str], where: str) -> Announcement:
    fields = _fields(entry, f"{where}: sends", ("text", "after", "every", "close"))
    every_s = _seconds(fields, "every", where) or math.inf
    reply = ReplyTemplate(
        _text(fields.get("text", ""), where),
        _seconds(fields, "after", where) or (every_s if every_s < math.inf else 0.0),
        bool(fields.get("close", False)),
    )
    if unknown := reply.variables - state.keys():
        raise PeersError(f"{where}: there is no variable {min(unknown)}: add it to 'state'")
    return Announcement(_written(reply, state, code, where), every_s)


def _written(reply: ReplyTemplate, state: Mapping[str, str], code: TextCode, where: str) -> Reply:
    try:
        return reply.fill(dict(state), code)
    except ValueError as error:
        raise PeersError(f"{where}: {reply.text!r} is not hexadecimal: {error}") from error


def _template(value: Any, where: str) -> ReplyTemplate:
    if not isinstance(value, Mapping):
        return ReplyTemplate(_text(value, where))
    fields = _fields(value, where, _REPLY)
    changes = {str(name): _text(one, where) for name, one in _mapping(fields.get("set", {}), where).items()}
    delay_s = _seconds(fields, "delay", where)
    return ReplyTemplate(_text(fields.get("reply", ""), where), delay_s, bool(fields.get("close", False)), changes)


# XML-RPC and Modbus


def _xmlrpc_peer(name: str, entry: Any, where: str, python: _Python) -> SocketPeer:
    fields = entry if isinstance(entry, Mapping) and "methods" in entry else {"methods": entry}
    fields = _fields(fields, where, ("methods", *_COMMON))
    methods = fields["methods"]
    if isinstance(methods, str):
        methods = python.object(methods, where)
    else:
        methods = {str(key): _method(value) for key, value in _mapping(methods, where).items()}
    log = _log(name, fields, where)
    answerer = XmlRpcMethods(log, methods)
    return SocketPeer(log, answerer, (), _seconds(fields, "delay", where), _refusals(fields, where))


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
    fields = _fields(entry, where, ("coils", "registers", "device", "exception", "refuse", "expect"))
    device = python.object(_text(fields["device"], where), where) if "device" in fields else None
    coils, registers = (
        getattr(device, key, None) or _values(fields.get(key, {}), f"{where}: {key}") for key in ("coils", "registers")
    )
    return UnitPeer(
        _log(name, fields, where),
        coils,
        registers,
        refuse=bool(fields.get("refuse", False)),
        exception=_whole(fields.get("exception", 0), f"{where}: exception"),
        written=getattr(device, "written", lambda kind, address, value: None),
    )


def _values(entry: Any, where: str) -> Values:
    values = Values()
    for address, value in _mapping(entry, where).items():
        several = [_whole(one, where) for one in _list(value)]
        if not several:
            raise PeersError(f"{where}: a list of values must not be empty")
        values[_whole(address, where)] = several
    return values


# parts of entries


def _log(name: str, fields: Mapping[str, Any], where: str) -> PeerLog:
    return PeerLog(name, [Pattern.parse(_text(one, where)) for one in _list(fields.get("expect", []))])


def _refusals(fields: Mapping[str, Any], where: str) -> float:
    value = fields.get("refuse", False)
    return math.inf if value is True else _whole(int(value) if value is False else value, f"{where}: refuse")


def _repeat_last(values: list[_ItemT]) -> Iterator[_ItemT]:
    yield from values
    while True:
        yield values[-1]


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _fields(value: Any, where: str, names: tuple[str, ...]) -> dict[str, Any]:
    fields = _mapping(value, where)
    unknown = sorted(str(key) for key in set(fields) - set(names))
    if unknown:
        raise PeersError(f"{where}: unknown key '{unknown[0]}': use {', '.join(names)}")
    return fields


def _mapping(value: Any, where: str) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise PeersError(f"{where} must be a mapping, not {value!r}")
    return value


def _function(value: Any, where: str) -> Callable[[bytes], Any]:
    if not callable(value):
        raise PeersError(f"{where}: {value!r} cannot be called: give a function, or a class with __call__")
    return value  # type: ignore[no-any-return]


def _text(value: Any, where: str) -> str:
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    raise PeersError(f"{where}: an answer must be text, not {value!r}")


def _whole(value: Any, where: str, least: int = 0) -> int:
    if isinstance(value, int) and value >= least:
        return int(value)
    raise PeersError(f"{where} must be a whole number from {least}, not {value!r}")


def _seconds(fields: Mapping[str, Any], name: str, where: str) -> float:
    value = fields.get(name, 0.0)
    if isinstance(value, int | float) and 0 <= value < math.inf:
        return float(value)
    raise PeersError(f"{where}: {name} must be a time in seconds, not {value!r}")


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
