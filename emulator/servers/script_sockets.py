"""TCP connections that scripts open (``socket_open`` and related functions, remote procedure calls).

A host name is resolved first, then each address is checked, and the connection is opened to the address that was
checked: the name cannot resolve to something else in between. Connections to a control API or a teach pendant on this
machine, of this robot or another one, are refused unless the script network permits them.

The bytes of these connections pass through hooks like those of a port; the port does not listen (``ScriptPort``).
"""

import asyncio
import logging
import os
import socket
from collections.abc import Awaitable, Callable, Mapping
from ipaddress import ip_address
from typing import Final

from emulator.servers.connection import Connection
from emulator.servers.port import Port
from emulator.services.sockets import ScriptNetwork, SocketState
from urproto.addresses import is_backdoor, is_loopback, local_address

_LOOPBACK: Final = frozenset({"127.0.0.1", "::1", "localhost"})
_MAX_UNREAD: Final = 1024 * 1024  # received bytes that the script has not read; above that, reading pauses (guess)
_MAX_UNSENT: Final = 1024 * 1024  # bytes from the script that wait for the peer; above that, sends fail (guess)


class OwnPorts:
    """The controller's own ports by their usual numbers; empty until they are open."""

    def __init__(self) -> None:
        self._listening: Mapping[int, tuple[str, int]] = {}

    def opened(self, host: str, ports: Mapping[int, int]) -> None:
        """Set the address on which the controller listens, and its ports: usual number to real number."""
        address = local_address(host)
        self._listening = {usual: (address, real) for usual, real in ports.items()}

    def reach(self, address: str, port: int) -> tuple[str, int]:
        """Return the real address and port of one of the controller's own ports on loopback; others are unchanged."""
        return self._listening.get(port, (address, port)) if address in _LOOPBACK else (address, port)


_logger = logging.getLogger(__name__)


class ScriptPort(Port):
    """Holds the connections of scripts and their hooks. robot_time: returns the uptime [s] of the controller."""

    def __init__(self, robot_time: Callable[[], float] = lambda: 0.0) -> None:
        super().__init__("scripts")
        self._robot_time = robot_time

    @property
    def robot_time_s(self) -> float:
        return self._robot_time()


class NetworkSockets:
    """Opens connections in the running event loop; the script checks them once per control period.

    network: the permitted destinations. Other connections fail like a refused connection, and `note` is called with
    the reason. own_ports: the ports of the controller itself. port: holds the connections.
    """

    def __init__(
        self,
        network: ScriptNetwork = ScriptNetwork.ANY,
        note: Callable[[str], None] = lambda text: None,
        own_ports: OwnPorts | None = None,
        port: ScriptPort | None = None,
    ) -> None:
        self._port = port or ScriptPort()
        self._open: set[_NetworkSocket] = set()
        self._network = network
        self._note = note
        self._own_ports = own_ports or OwnPorts()

    def __len__(self) -> int:
        """Number of connections that are open or being opened."""
        return len(self._open)

    def open(self, address: str, port: int) -> "_NetworkSocket":
        """Start to connect. The state becomes ``closed`` if the connection is refused or the address is invalid."""
        opened = _NetworkSocket(self._port, self._permitted, self._open.discard)
        self._open.add(opened)
        opened.connect(address, port)
        return opened

    async def close(self) -> None:
        """Close all connections and wait until they are closed."""
        while self._open:
            for opened in tuple(self._open):
                opened.close()
            await asyncio.sleep(0)

    async def _permitted(self, address: str, port: int) -> list[tuple[str, int]]:
        """Return the numeric addresses and ports to try, in order. Raises OSError if none is found or permitted."""
        network = self._network
        found = [] if network is ScriptNetwork.NONE else await _resolve(address, port)
        near = (ScriptNetwork.LOOPBACK, ScriptNetwork.NONE)
        permitted = [numeric for numeric in found if network not in near or is_loopback(numeric)]
        reached = [self._own_ports.reach(numeric, port) for numeric in permitted]
        if network is not ScriptNetwork.ANY_AND_CONTROL:
            reached = [place for place in reached if not is_backdoor(*place)]
        if not reached and (found or network is ScriptNetwork.NONE):
            where = f"{address}:{port}" + (f" ({', '.join(found)})" if found and found != [address] else "")
            if permitted:
                permits = f"--script-network {ScriptNetwork.ANY_AND_CONTROL} permits it"
                why = f"the port belongs to a control API or a teach pendant of an emulator ({permits})"
            else:
                why = f"the script network is {network}"
            text = f"a script may not connect to {where}: {why}"
            self._note(text)
            raise PermissionError(text)
        return reached


async def _resolve(address: str, port: int) -> list[str]:
    try:
        return [str(ip_address(address))]
    except ValueError:
        found = await asyncio.get_running_loop().getaddrinfo(address, port, type=socket.SOCK_STREAM)
        return [str(where[0]) for _, _, _, _, where in found]


def _reason(error: Exception) -> str:
    """Return the system's text for an error, without the description of the attempt that asyncio puts before it."""
    if isinstance(error, OSError) and error.errno and not isinstance(error, socket.gaierror):
        return os.strerror(error.errno)
    return str(getattr(error, "strerror", None) or error)


class _ScriptConnection(Connection):
    """The network connection of a script's socket, which it informs by ``opened``, ``received`` and ``lost``."""

    most_undelivered = 2 * _MAX_UNSENT  # not reached: sends of the script fail before
    for_browsers = True  # the script opened the connection: the peer may send anything, also what a browser sends

    def __init__(self, server: Port, owner: "_NetworkSocket") -> None:
        super().__init__(server)
        self._owner = owner

    def opened(self) -> None:
        self._owner.opened()

    def received(self, data: bytes) -> None:
        self._owner.received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._owner.lost(exc)


class _NetworkSocket:
    def __init__(
        self,
        port: Port,
        permitted: Callable[[str, int], Awaitable[list[tuple[str, int]]]],
        on_closed: Callable[["_NetworkSocket"], None],
    ) -> None:
        self.inbox = bytearray()
        self.failure = ""
        self._permitted = permitted
        self._on_closed = on_closed
        self._connection = _ScriptConnection(port, self)
        self._connected_once = False
        self._paused = False  # reading, because the script has not read what was received
        self._connecting: asyncio.Task[None] | None = None
        self._state: SocketState = "connecting"

    @property
    def state(self) -> SocketState:
        if self._paused and len(self.inbox) < _MAX_UNREAD:  # the script, which checks every period, has caught up
            self._paused = False
            self._connection.read_on(True)
        return self._state

    def connect(self, address: str, port: int) -> None:
        self._connecting = asyncio.get_running_loop().create_task(self._connect(address, port))
        self._connecting.add_done_callback(self._connected)

    def send(self, data: bytes) -> bool:
        if self._state != "open" or self._connection.undelivered > _MAX_UNSENT:
            return False
        self._connection.send(data)
        return True

    def close(self) -> None:
        self._state = "closed"
        if self._connected_once:
            self._connection.close()
        elif self._connecting is not None:
            self._connecting.cancel()

    async def _connect(self, address: str, port: int) -> None:
        try:
            for numeric, real_port in await self._permitted(address, port):
                if await self._try_connect(numeric, real_port):
                    return
        except (OSError, OverflowError, ValueError) as error:  # ValueError: a NUL in the name
            self.failure = self.failure or _reason(error)
            _logger.info("a script cannot connect to %s:%d: %s", address, port, error)

    async def _try_connect(self, numeric: str, port: int) -> bool:
        try:
            await asyncio.get_running_loop().create_connection(lambda: self._connection, numeric, port)
        except OSError as error:
            self.failure = _reason(error)
            _logger.info("a script cannot connect to %s:%d: %s", numeric, port, error)
            return False
        return True

    def _connected(self, _: "asyncio.Task[None]") -> None:
        if not self._connected_once:  # refused or cancelled
            self._state = "closed"
            self._on_closed(self)

    # called by the connection

    def opened(self) -> None:
        self._connected_once = True
        if self._state == "closed":  # the script closed it while it was connecting
            self._connection.close()
        else:
            self._state, self.failure = "open", ""

    def received(self, data: bytes) -> None:
        self.inbox += data
        if len(self.inbox) >= _MAX_UNREAD:
            self._paused = True
            self._connection.read_on(False)

    def lost(self, exc: Exception | None) -> None:
        self.failure = _reason(exc) if exc is not None else ""
        self._state = "closed"
        self._on_closed(self)
