"""XML-RPC without HTTP: xmlrpc-c's packet stream, the other protocol of ``rpc_factory``.

Each call and each answer is one packet on a plain TCP connection. ESC and three letters form a
control word: PKT begins a packet, END ends it, ESC stands for an ESC byte in it, NOP is ignored
(xmlrpc-c, packetsocket.cpp).
"""

import re
from collections.abc import Callable
from typing import Final

from emulator.builtins.host import Frames, ProgramHost
from emulator.builtins.remote.httpclient import RemoteError, authority, connect
from emulator.services.sockets import ScriptSocket
from urscript.meter import pay

_ESC: Final = b"\x1b"
_WORD_BYTES: Final = 4
_CHUNK: Final = 1024  # bytes processed between two checks of the time budget
_WORD_COST: Final = 10  # meter units per byte of data that consists of control words only


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


class PacketConnection:
    """A persistent packet stream to a server; it is closed with the program's sockets."""

    def __init__(self, host: ProgramHost, address: str, port: int) -> None:
        self._host = host
        self._address, self._port = address, port
        self._socket: ScriptSocket | None = None

    @classmethod
    def parse(cls, host: ProgramHost, url: str) -> "PacketConnection | None":
        """Parse ``address:port``, without connecting; None if the text has another form."""
        match = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([\w.-]+)):(\d{1,5})", url, re.ASCII)
        if match is None or not 0 < int(match[3]) < 65536:
            return None
        return cls(host, match[1] or match[2], int(match[3]))

    def __str__(self) -> str:
        return authority(self._address, self._port)

    def close(self) -> None:
        socket, self._socket = self._socket, None
        if socket is not None:
            self._host.sockets.drop(socket)

    def open(self) -> Frames[None]:
        """Connect unless connected already. Raises RemoteError."""
        if self._socket is not None and self._socket.state != "open":
            self.close()
        if self._socket is None:
            self._socket = yield from connect(self._host, self._address, self._port)

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
