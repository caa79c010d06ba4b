"""Connections of scripts for remote calls, over their sockets: nothing blocks, every wait is a bare ``yield``.

HTTP: a POST for each call. The connection is kept for the next call, as the documented ``closeXMLRPCClientConnection``
implies. A connection that the server has closed meanwhile is replaced: a call on a reused connection is retried once
if the connection ends before the first byte of the answer (libcurl, on which the controller's RPC is built, does so).

Packet streams, xmlrpc-c's protocol without HTTP: each call and each answer is one packet on a plain TCP connection.
ESC and three letters form a control word: PKT begins a packet, END ends it, ESC stands for an ESC byte in it, NOP is
ignored (xmlrpc-c, packetsocket.cpp).
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

import h11

from emulator.builtins.host import Frames, ProgramHost
from emulator.services.sockets import MAX_SOCKETS, ScriptSocket
from urproto.text import from_bytes
from urscript.meter import pay

_CONNECT_S: Final = 300.0  # libcurl's default; what the controller sets is not known
_CHUNK: Final = 1024  # bytes processed between two checks of the time budget
_EVENT_COST: Final = 300  # meter units: h11 takes about 15 us for each piece of a reply
_AGENT: Final = "ur-emulator"  # the controller's own is not known
_OK: Final = 200
_ESC: Final = b"\x1b"
_WORD_BYTES: Final = 4
_WORD_COST: Final = 10  # meter units per byte of data that consists of control words only


class RemoteError(Exception):
    """The server did not answer as expected; the text says why."""


class RemoteConnection(ABC):
    """A persistent connection that sends XML and receives the answer; it is closed with the program's sockets."""

    def __init__(self, host: ProgramHost, address: str, port: int) -> None:
        self._host = host
        self._address, self._port = address, port
        self._socket: ScriptSocket | None = None

    @abstractmethod
    def __str__(self) -> str:
        """The URL, for messages."""

    @abstractmethod
    def post(self, body: bytes, take: Callable[[bytes], None]) -> Frames[None]:
        """Send a body and pass the answer's body to `take`, piece by piece.

        Raises RemoteError for everything but a complete answer. An early end, even of a killed
        thread, closes the connection, because half an answer may still be on its way.
        """

    def close(self) -> None:
        """End the connection; the next call opens another."""
        socket, self._socket = self._socket, None
        if socket is not None:
            self._host.sockets.drop(socket)

    def _connect(self) -> Frames[ScriptSocket]:
        """Open a connection. Raises RemoteError."""
        sockets = self._host.sockets
        if len(sockets) >= MAX_SOCKETS:
            raise RemoteError(f"the program has {MAX_SOCKETS} connections open already: reuse a handle")
        socket = self._host.programs.socket_backend.open(self._address, self._port)
        sockets.hold(socket)
        try:
            for _ in range(self._host.frames(_CONNECT_S)):
                if socket.state != "connecting":
                    break
                yield
            place = _authority(self._address, self._port)
            if socket.state == "connecting":
                raise RemoteError(f"{place} did not answer within {_CONNECT_S:g} s")
            if socket.state != "open":
                raise RemoteError(f"cannot connect to {place}: is the server running?")
        except BaseException:  # a killed thread too
            sockets.drop(socket)
            raise
        self._socket = socket
        return socket


def _authority(address: str, port: int) -> str:
    """``address:port``, an IPv6 address in brackets."""
    return f"[{address}]:{port}" if ":" in address else f"{address}:{port}"


class _NoAnswerError(RemoteError):
    """The connection ended before a byte of the answer."""


@dataclass(frozen=True)
class HttpUrl:
    """Address of the server that receives the calls."""

    host: str
    port: int
    target: str  # path and query

    @classmethod
    def parse(cls, text: str) -> "HttpUrl":
        """Parse ``http://host[:port][/path]``. Raises ValueError with the reason."""
        parts = urlsplit(text)
        if parts.scheme != "http" or not parts.hostname:
            raise ValueError("it must look like http://address:port/path")
        if parts.username is not None:
            raise ValueError("user names and passwords in a URL are not emulated")
        port = 80 if parts.port is None else parts.port
        if not port:
            raise ValueError("there is no port 0")
        url = cls(parts.hostname, port, (parts.path or "/") + (f"?{parts.query}" if parts.query else ""))
        try:
            url.request(b"")
        except (h11.LocalProtocolError, UnicodeError) as error:
            raise ValueError(f"it is not valid in HTTP: {error}") from None
        return url

    def __str__(self) -> str:
        return f"http://{_authority(self.host, self.port)}{self.target}"

    def request(self, body: bytes) -> h11.Request:
        """The head of a POST of this body."""
        headers = {
            "Host": _authority(self.host, self.port),
            "User-Agent": _AGENT,
            "Accept": "*/*",
            "Content-Type": "text/xml",
            "Content-Length": str(len(body)),
        }
        return h11.Request(method="POST", target=self.target, headers=list(headers.items()))


class HttpConnection(RemoteConnection):
    """A connection for HTTP; answers must have the status 200."""

    def __init__(self, host: ProgramHost, url: HttpUrl) -> None:
        super().__init__(host, url.host, url.port)
        self.url = url
        self._http = h11.Connection(h11.CLIENT)

    def __str__(self) -> str:
        return str(self.url)

    def post(self, body: bytes, take: Callable[[bytes], None]) -> Frames[None]:
        complete = False
        try:
            complete = yield from self._post(body, take)
        except h11.RemoteProtocolError as error:
            raise RemoteError(f"the answer is not HTTP: {error}") from None
        finally:
            if not complete:
                self.close()

    def _post(self, body: bytes, take: Callable[[bytes], None]) -> Frames[bool]:
        used = self._socket
        if used is not None and used.state == "open" and not used.inbox:
            try:
                return (yield from self._exchange(used, body, take))
            except _NoAnswerError:
                pass
        self.close()
        socket = yield from self._connect()
        self._http = h11.Connection(h11.CLIENT)
        return (yield from self._exchange(socket, body, take))

    def _exchange(self, socket: ScriptSocket, body: bytes, take: Callable[[bytes], None]) -> Frames[bool]:
        """One request and its answer; True when the connection may serve another."""
        http = self._http
        events = (self.url.request(body), h11.Data(data=body), h11.EndOfMessage())
        if not socket.send(b"".join(http.send(event) or b"" for event in events)):
            raise _NoAnswerError("the connection was closed before the call was sent")
        silent = True
        while True:
            event = http.next_event()
            if event is h11.NEED_DATA:
                yield from self._receive(socket, silent)
                silent = False
            elif isinstance(event, h11.Response):
                _check_status(event)
            elif isinstance(event, h11.Data):
                take(event.data)
            elif isinstance(event, h11.EndOfMessage):
                return self._start_over()
            elif not isinstance(event, h11.InformationalResponse):
                raise RemoteError("the connection was closed before the answer was complete")
            yield from pay(_EVENT_COST)

    def _receive(self, socket: ScriptSocket, silent: bool) -> Frames[None]:
        while not socket.inbox and socket.state == "open":
            yield
        data = bytes(socket.inbox[:_CHUNK])
        del socket.inbox[:_CHUNK]
        if not data and silent:
            raise _NoAnswerError("the connection was closed without an answer")
        self._http.receive_data(data)

    def _start_over(self) -> bool:
        http = self._http
        if http.their_state is not h11.DONE or http.trailing_data[0]:
            return False
        http.start_next_cycle()
        return True


def _check_status(response: h11.Response) -> None:
    if response.status_code != _OK:
        reason = from_bytes(response.reason)
        raise RemoteError(f"the server answered with HTTP {response.status_code} {reason}".rstrip())


class PacketReader:
    """Passes the contents of one packet to `take` as its bytes arrive."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self.complete = False
        self._take = take
        self._begun = False
        self._pending = bytearray()  # the beginning of a control word

    def feed(self, data: bytes) -> None:
        """Process the next bytes. Raises RemoteError if they are not part of a single packet."""
        self._pending += data
        while self._pending:
            at = self._pending.find(_ESC)
            plain = bytes(self._pending if at < 0 else self._pending[:at])
            del self._pending[: len(plain)]
            if plain:
                self._text(plain)
            if len(self._pending) < _WORD_BYTES:
                return
            word = bytes(self._pending[1:_WORD_BYTES])
            del self._pending[:_WORD_BYTES]
            self._word(word)

    def _text(self, plain: bytes) -> None:
        if not self._begun or self.complete:
            raise RemoteError("the answer is not a packet: it has bytes outside of one")
        self._take(plain)

    def _word(self, word: bytes) -> None:
        inside = self._begun and not self.complete
        if word == b"PKT" and not self._begun:
            self._begun = True
        elif word == b"END" and inside:
            self.complete = True
        elif word == b"ESC" and inside:
            self._take(_ESC)
        elif word != b"NOP":
            raise RemoteError(f"the answer is not a packet: it has the control word {word!r}")


class PacketConnection(RemoteConnection):
    """A packet stream."""

    @classmethod
    def parse(cls, host: ProgramHost, url: str) -> "PacketConnection | None":
        """Parse ``address:port``, without connecting; None if the text has another form."""
        match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+)):(\d{1,5})", url, re.ASCII)
        if match is None or not 0 < int(match[3]) < 65536:
            return None
        return cls(host, match[1] or match[2], int(match[3]))

    def __str__(self) -> str:
        return _authority(self._address, self._port)

    def open(self) -> Frames[None]:
        """Connect unless connected already. Raises RemoteError."""
        if self._socket is not None and self._socket.state != "open":
            self.close()
        if self._socket is None:
            yield from self._connect()

    def post(self, body: bytes, take: Callable[[bytes], None]) -> Frames[None]:
        reader = PacketReader(take)
        try:
            yield from self.open()
            assert self._socket is not None
            self._socket.send(b"\x1bPKT" + body.replace(_ESC, b"\x1bESC") + b"\x1bEND")
            while not reader.complete:
                yield from self._receive(self._socket, reader)
        finally:
            if not reader.complete:
                self.close()

    def _receive(self, socket: ScriptSocket, reader: PacketReader) -> Frames[None]:
        while not socket.inbox:
            if socket.state != "open":
                raise RemoteError("the connection was closed before the answer was complete")
            yield
        data = bytes(socket.inbox[:_CHUNK])
        del socket.inbox[:_CHUNK]
        reader.feed(data)
        yield from pay(_WORD_COST * len(data))
