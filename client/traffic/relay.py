"""One connection through a proxy: everything that one end does is passed on to the other."""

import asyncio
import os
import socket
import struct
from collections.abc import Callable
from typing import Final, cast

from client.decoding.packets import SocketAddress
from client.traffic.recording import ConnectionRecorder, ConversationRecorder
from urproto.compat_asyncio import pause_reading, timeout

DIAL_S: Final = 5.0  # how long a robot may take to accept a connection (guess)
_LINGER: Final = struct.pack("ii", 1, 0)  # closing sends a reset


class Relay:
    """Relays one client's connection to its server.

    finished: set at the end. refusal: why the server could not be reached. client: the protocol of the accepted
    connection. port: the port number under which the server is recorded.
    """

    def __init__(
        self, host: str, target: int, port: int, recorder: ConversationRecorder | None, ended: Callable[["Relay"], None]
    ) -> None:
        self.finished = asyncio.Event()
        self.refusal: str | None = None
        self.client = _End(self, from_client=True)
        self._server: _End | None = None
        self._where = (host, target)
        self._port = port
        self._recorder = recorder
        self._recorded: ConnectionRecorder | None = None
        self._ended = ended
        self._open = 0
        self._dialing: asyncio.Task[None] | None = None

    def close(self) -> None:
        """End both connections; data in transit is lost."""
        if self._dialing is not None:
            self._dialing.cancel()
        for end in (self.client, self._server):
            if end is not None and end.transport is not None:
                end.transport.abort()

    # events of the two ends

    def made(self, end: "_End") -> None:
        """An end is connected."""
        self._open += 1
        if end is self.client:
            assert end.transport is not None
            pause_reading(end.transport)
            self._dialing = asyncio.get_running_loop().create_task(self._dial())

    def data(self, end: "_End", data: bytes) -> None:
        """An end has sent bytes."""
        if self._recorded is not None:
            self._recorded.data(end.from_client, data)
        other = self._opposite(end)
        if other is not None and other.transport is not None and not other.transport.is_closing():
            other.transport.write(data)

    def on_half_closed(self, end: "_End") -> None:
        """An end has closed its sending direction."""
        if self._recorded is not None:
            self._recorded.end(end.from_client)
        other = self._opposite(end)
        if other is None or other.transport is None:
            return
        other.transport.write_eof()
        if other.ended:
            for each in (end, other):
                assert each.transport is not None
                each.transport.close()

    def on_paused(self, end: "_End", held: bool) -> None:
        """An end does not read (held), or reads again: reading from the other end is paused or resumed."""
        other = self._opposite(end)
        if other is None or other.transport is None:
            return
        if held:
            other.transport.pause_reading()
        else:
            other.transport.resume_reading()

    def on_lost(self, end: "_End", error: Exception | None) -> None:
        """An end's connection is over."""
        self._open -= 1
        other = self._opposite(end)
        if other is not None and other.transport is not None and not other.transport.is_closing():
            if self._recorded is not None:
                self._recorded.reset(end.from_client)
            _reset(other.transport)
        if end is self.client and self._dialing is not None:
            self._dialing.cancel()
        self._finish_if_closed()

    def _opposite(self, end: "_End") -> "_End | None":
        return self._server if end is self.client else self.client

    def _finish_if_closed(self) -> None:
        if not self._open and not self.finished.is_set() and (self._dialing is None or self._dialing.done()):
            self.finished.set()
            self._ended(self)

    # the server's end

    async def _dial(self) -> None:
        try:
            await self._connect()
        except OSError as error:  # TimeoutError is one
            self.refusal = reason_of(error)
            assert self.client.transport is not None
            _reset(self.client.transport)
        finally:
            asyncio.get_running_loop().call_soon(self._finish_if_closed)

    async def _connect(self) -> None:
        server = _End(self, from_client=False)
        self._server = server
        try:
            async with timeout(DIAL_S):
                await asyncio.get_running_loop().create_connection(lambda: server, *self._where)
        except BaseException:
            self._server = None
            if server.transport is not None:
                server.transport.abort()
            raise
        assert self.client.transport is not None
        self.client.transport.resume_reading()

    def connected(self, server: "_End") -> None:
        """Both ends are connected: start recording."""
        if self._recorder is not None:
            client, address = self.client.peer, server.peer.address
            self._recorded = self._recorder.connection(client, SocketAddress(address, self._port))


class _End(asyncio.Protocol):
    """One end and its connection to the proxy. ended: it has closed its sending direction."""

    def __init__(self, relay: Relay, *, from_client: bool) -> None:
        self.transport: asyncio.Transport | None = None
        self.peer = SocketAddress("0.0.0.0", 0)
        self.from_client = from_client
        self.ended = False
        self._relay = relay

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)  # uvloop's transport is not a subclass
        address, port = transport.get_extra_info("peername")[:2]
        self.peer = SocketAddress(address, port)
        if not self.from_client:
            self._relay.connected(self)
        self._relay.made(self)

    def data_received(self, data: bytes) -> None:
        self._relay.data(self, data)

    def eof_received(self) -> bool:
        self.ended = True
        self._relay.on_half_closed(self)
        return True

    def pause_writing(self) -> None:
        self._relay.on_paused(self, True)

    def resume_writing(self) -> None:
        self._relay.on_paused(self, False)

    def connection_lost(self, exc: Exception | None) -> None:
        self._relay.on_lost(self, exc)
        self.transport = None


def _reset(transport: asyncio.Transport) -> None:
    """End a connection so that the other side sees a reset."""
    with_socket = transport.get_extra_info("socket")
    if with_socket is not None:
        with_socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER)
    transport.abort()


def reason_of(error: OSError) -> str:
    """The reason why a connection failed, in a few words."""
    if isinstance(error, TimeoutError):
        return f"no answer within {DIAL_S:g} s"
    if isinstance(error, socket.gaierror) or error.errno is None:
        return error.strerror or str(error)
    return os.strerror(error.errno)  # asyncio's own texts repeat the address
