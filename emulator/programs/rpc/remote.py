"""Connections that built-ins make on their own, to servers a script names."""

from collections.abc import Callable
from typing import Final, Protocol

from emulator.programs.host import Frames, ProgramHost
from emulator.programs.sockets import MOST_SOCKETS, ScriptSocket

__all__ = ["RemoteConnection", "RemoteError", "authority", "connect"]

_CONNECT_S: Final = 300.0  # libcurl's default; what the controller sets is not known


class RemoteError(Exception):
    """The server did not answer as it should; the text says why."""


class RemoteConnection(Protocol):
    """A way to have XML answered."""

    def __str__(self) -> str:
        """The URL, for messages."""

    def close(self) -> None:
        """End the connection; the next call opens another."""

    def post(self, body: bytes, take: Callable[[bytes], None]) -> Frames[None]:
        """Send a body and give the answer's to `take`, piece by piece.

        Raises RemoteError for everything but a complete answer. However it ends early (a killed
        thread too), the connection ends with it: what is left on it is half an answer.
        """


def authority(address: str, port: int) -> str:
    """``address:port``, an IPv6 address in brackets."""
    return f"[{address}]:{port}" if ":" in address else f"{address}:{port}"


def connect(host: ProgramHost, address: str, port: int) -> Frames[ScriptSocket]:
    """An open connection, which ends with the program. Raises RemoteError when there is none to be had."""
    if len(host.sockets) >= MOST_SOCKETS:
        raise RemoteError(f"the program has {MOST_SOCKETS} connections open already: it can use a handle again")
    socket = host.programs.socket_backend.open(address, port)
    host.sockets.hold(socket)
    try:
        for _ in range(host.frames(_CONNECT_S)):
            if socket.state != "connecting":
                break
            yield
        if socket.state == "connecting":
            raise RemoteError(f"{authority(address, port)} did not answer within {_CONNECT_S:g} s")
        if socket.state != "open":
            raise RemoteError(f"cannot connect to {authority(address, port)}: is the server running?")
    except BaseException:  # a killed thread too
        host.sockets.drop(socket)
        raise
    return socket
