"""TCP connections that scripts open (``socket_open`` and its family)."""

import asyncio
import logging
from collections.abc import Callable
from typing import Final

from emulator.programs.sockets import SocketState

__all__ = ["NetworkSockets"]

_MOST_UNREAD: Final = 1024 * 1024  # bytes a peer may be ahead of the script (guess)
_MOST_UNSENT: Final = 1024 * 1024  # bytes the script may be ahead of a peer (guess)

_logger = logging.getLogger(__name__)


class NetworkSockets:
    """Opens connections in the running event loop; the script looks at them once per control period."""

    def __init__(self) -> None:
        self._open: set[_NetworkSocket] = set()

    def __len__(self) -> int:
        """Connections that are open or being opened."""
        return len(self._open)

    def open(self, address: str, port: int) -> "_NetworkSocket":
        """Begin to connect. A refused connection, or an impossible address, turns ``closed``."""
        opened = _NetworkSocket(self._open.discard)
        self._open.add(opened)
        opened.connect(address, port)
        return opened

    async def close(self) -> None:
        """Close every connection and wait until they are gone."""
        while self._open:
            for opened in tuple(self._open):
                opened.close()
            await asyncio.sleep(0)


class _NetworkSocket(asyncio.Protocol):
    def __init__(self, gone: Callable[["_NetworkSocket"], None]) -> None:
        self.inbox = bytearray()
        self._gone = gone
        self._transport: asyncio.Transport | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._state: SocketState = "connecting"

    @property
    def state(self) -> SocketState:
        self._read_on()
        return self._state

    def _read_on(self) -> None:
        """Read again once the script, which looks here every control period, has caught up."""
        transport = self._transport
        if transport is None or transport.is_reading() or transport.is_closing():
            return
        if len(self.inbox) < _MOST_UNREAD:
            transport.resume_reading()

    def connect(self, address: str, port: int) -> None:
        self._connecting = asyncio.get_running_loop().create_task(self._connect(address, port))
        self._connecting.add_done_callback(self._connected)

    def send(self, data: bytes) -> bool:
        transport = self._transport
        if transport is None or self._state != "open" or transport.get_write_buffer_size() > _MOST_UNSENT:
            return False
        transport.write(data)
        return True

    def close(self) -> None:
        self._state = "closed"
        if self._transport is not None:
            self._transport.close()
        elif self._connecting is not None:
            self._connecting.cancel()

    async def _connect(self, address: str, port: int) -> None:
        try:
            await asyncio.get_running_loop().create_connection(lambda: self, address, port)
        except (OSError, OverflowError, UnicodeError) as error:
            _logger.info("a script cannot connect to %s:%d: %s", address, port, error)

    def _connected(self, _: "asyncio.Task[None]") -> None:
        if self._transport is None:  # refused, or given up
            self._state = "closed"
            self._gone(self)

    # asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if self._state == "closed":  # by the script, while it was connecting
            transport.close()
        else:
            self._state = "open"

    def data_received(self, data: bytes) -> None:
        self.inbox += data
        if len(self.inbox) >= _MOST_UNREAD and self._transport is not None:
            self._transport.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        self._state = "closed"
        self._transport = None
        self._gone(self)
