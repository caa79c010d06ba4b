"""Simulated peers of a script: what ``urscript run --peers`` answers on its sockets and XML-RPC calls.

The file lists each peer with its address and its answers:

    sockets:
      192.168.1.10:5000:              # or "*:5000" for any address
        greeting: "ready\\n"           # sent when the script connects
        answers:                      # to what the script sends at one time; * and ? are wildcards
          "GET POS": "POS 3\\n"
          "SET *": ack
          "*": ["1\\n", "2\\n"]         # one after the other, then the last one repeatedly
    xmlrpc:
      http://192.168.1.20:8080:
        get_pose: {x: 0.1, y: 0.2, z: 0.3, rx: 0, ry: 0, rz: 0}
        grip: true

Data on a socket without a matching answer is not answered; an XML-RPC method that is not listed returns a fault.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, TypeAlias
from urllib.parse import urlsplit
from xmlrpc.client import Fault, dumps, loads

from emulator.services.sockets import ScriptSocket, ScriptSocketBackend, SocketState
from urproto.text import from_bytes, strip, to_bytes
from urproto.yamltext import InvalidYamlError, load_yaml

_ANY: Final = "*"
_HTTP_PORT: Final = 80

Answer = Callable[[bytes], tuple[bytes, bytes]]
"""Takes data that was sent and not answered; returns the answer, and the data that remains."""


class PeersError(ValueError):
    """The file of peers is invalid."""


@dataclass(frozen=True)
class _Peer:
    greeting: bytes
    answer: Answer


Peers: TypeAlias = Mapping[tuple[str, int], _Peer]


class StubPeers:
    """Connects a script to the peers of the file, and otherwise to `network`."""

    def __init__(self, peers: Peers, network: ScriptSocketBackend) -> None:
        self._peers = peers
        self._network = network

    def open(self, address: str, port: int) -> ScriptSocket:
        """Begin to connect; a peer of the file accepts every connection immediately."""
        peer = self._peers.get((address, port)) or self._peers.get((_ANY, port))
        return self._network.open(address, port) if peer is None else _StubSocket(peer)


@dataclass
class _StubSocket:
    peer: _Peer
    failure: str = ""
    inbox: bytearray = field(default_factory=bytearray)
    _state: SocketState = "open"
    _unanswered: bytes = b""

    def __post_init__(self) -> None:
        self.inbox += self.peer.greeting

    @property
    def state(self) -> SocketState:
        return self._state

    def send(self, data: bytes) -> bool:
        if self._state != "open":
            return False
        answer, self._unanswered = self.peer.answer(self._unanswered + data)
        self.inbox += answer
        return True

    def close(self) -> None:
        self._state = "closed"


# the file


def read_peers(path: Path) -> dict[tuple[str, int], _Peer]:
    """The peers that a file describes, by address and port. Raises PeersError or OSError."""
    try:
        content = load_yaml(path.read_bytes())
    except InvalidYamlError as error:
        raise PeersError(f"{path} is not YAML: {error}") from error
    whole = _mapping(content, str(path))
    unknown = sorted(set(whole) - {"sockets", "xmlrpc"})
    if unknown:
        raise PeersError(f"{path}: unknown key '{unknown[0]}': peers are listed under 'sockets' and 'xmlrpc'")
    peers: dict[tuple[str, int], _Peer] = {}
    for name, entry in _mapping(whole.get("sockets", {}), f"{path}: sockets").items():
        peers[_address(str(name), path)] = _socket_peer(entry, f"{path}: {name}")
    for url, methods in _mapping(whole.get("xmlrpc", {}), f"{path}: xmlrpc").items():
        answers = {str(name): value for name, value in _mapping(methods, f"{path}: {url}").items()}
        peers[_url(str(url), path)] = _Peer(b"", _Xmlrpc(answers))
    return peers


def _mapping(value: Any, what: str) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise PeersError(f"{what} must be a mapping, not {value!r}")
    return value


def _address(text: str, path: Path) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or re.fullmatch("[0-9]{1,5}", port) is None or not 0 < int(port) < 65536:
        raise PeersError(f"{path}: {text!r} is not an address: give host:port, for example 192.168.1.10:5000")
    return host.strip("[]"), int(port)


def _url(text: str, path: Path) -> tuple[str, int]:
    parts = urlsplit(text)
    if parts.scheme != "http" or not parts.hostname:
        raise PeersError(f"{path}: {text!r} is not an XML-RPC address: give http://host:port")
    return parts.hostname, parts.port or _HTTP_PORT


def _socket_peer(entry: Any, what: str) -> _Peer:
    fields = _mapping(entry, what)
    unknown = sorted(set(fields) - {"greeting", "answers"})
    if unknown:
        raise PeersError(f"{what}: unknown key '{unknown[0]}': a peer has 'greeting' and 'answers'")
    answers = _mapping(fields.get("answers", {}), f"{what}: answers")
    return _Peer(
        _bytes(fields.get("greeting", ""), what), _Lines({str(key): _sequence(v, what) for key, v in answers.items()})
    )


def _sequence(value: Any, what: str) -> Iterator[bytes]:
    """The answers one after the other, then the last one repeatedly."""
    values = [_bytes(item, what) for item in (value if isinstance(value, list) else [value])]
    if not values:
        raise PeersError(f"{what}: a list of answers must not be empty")
    return _repeat_last(values)


def _repeat_last(values: list[bytes]) -> Iterator[bytes]:
    yield from values
    while True:
        yield values[-1]


def _bytes(value: Any, what: str) -> bytes:
    if isinstance(value, bytes):
        return value
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return to_bytes(str(value))
    raise PeersError(f"{what}: an answer must be text, not {value!r}")


# answers


@dataclass
class _Lines:
    """Answers to what is sent at one time."""

    answers: Mapping[str, Iterator[bytes]]

    def __call__(self, data: bytes) -> tuple[bytes, bytes]:
        text = strip(from_bytes(data))
        found = self.answers.get(text) or next((a for key, a in self.answers.items() if fnmatchcase(text, key)), None)
        return (b"" if found is None else next(found)), b""


@dataclass
class _Xmlrpc:
    """Answers to the methods of XML-RPC calls over HTTP."""

    values: Mapping[str, Any]

    def __call__(self, data: bytes) -> tuple[bytes, bytes]:
        head, found, rest = data.partition(b"\r\n\r\n")
        length = _content_length(head)
        if not found or len(rest) < length:
            return b"", data
        _, method = loads(rest[:length])
        if method is not None and method in self.values:
            body = dumps((self.values[method],), methodresponse=True)
        else:
            body = dumps(Fault(1, f"the file of peers has no method {method}"))
        encoded = body.encode()
        answer = b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n" % len(encoded)
        return answer + encoded, rest[length:]


def _content_length(head: bytes) -> int:
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            return int(value)
    return 0
