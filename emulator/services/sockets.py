"""The TCP sockets of a script, as the interpreter sees them.

A backend opens connections. The interpreter never waits for one: it checks ``state`` and
``inbox`` once per control period.
"""

from typing import Final, Literal, Protocol

from urproto.compat import StrEnum

MAX_SOCKETS: Final = 64
"""Maximum number of connections of one program (a guess); each takes a file descriptor."""

SocketState = Literal["connecting", "open", "closed"]


class ScriptNetwork(StrEnum):
    """Which addresses the sockets and remote procedure calls of scripts may connect to.

    The control API and the pendant of an emulator on this machine are excluded unless explicitly included: a client of
    either can do anything, and anyone who can reach a script port can send a script.
    """

    ANY = "any"
    ANY_AND_CONTROL = "any-and-control"
    LOOPBACK = "loopback"
    NONE = "none"


class ScriptSocket(Protocol):
    """One connection. Received bytes are appended to ``inbox``; the reader removes them from its front."""

    inbox: bytearray

    @property
    def state(self) -> SocketState:
        """``closed`` is final; bytes already in ``inbox`` stay readable."""

    @property
    def failure(self) -> str:
        """The system's reason if neither side closed it; else empty."""

    def send(self, data: bytes) -> bool:
        """Queue bytes for the peer. Returns False if the connection is not open."""

    def close(self) -> None:
        """Close the connection; does nothing if it is already closed."""


class ScriptSocketBackend(Protocol):
    """Opens connections."""

    def open(self, address: str, port: int) -> ScriptSocket:
        """Begin to connect. Never fails: a refused connection turns ``closed``."""


class SocketTable:
    """The sockets of one program: those the script opened, by name, and those held by its RPC handles."""

    def __init__(self) -> None:
        self._sockets: dict[str, ScriptSocket] = {}
        self._held: list[ScriptSocket] = []

    def __len__(self) -> int:
        return len(self._sockets) + len(self._held)

    def hold(self, socket: ScriptSocket) -> None:
        """Add a socket without a name, to be closed with the others."""
        self._held.append(socket)

    def drop(self, socket: ScriptSocket) -> None:
        """Close and remove a socket added by `hold`."""
        socket.close()
        if socket in self._held:
            self._held.remove(socket)

    def get(self, name: str) -> ScriptSocket | None:
        """The socket of that name, or None if it was never opened or the script has closed it."""
        return self._sockets.get(name)

    def put(self, name: str, socket: ScriptSocket) -> None:
        """Keep a socket under a name; another one of that name is closed."""
        self.close(name)
        self._sockets[name] = socket

    def close(self, name: str) -> None:
        """Close and forget a socket; an unknown name is ignored."""
        socket = self._sockets.pop(name, None)
        if socket is not None:
            socket.close()

    def close_all(self) -> None:
        for name in list(self._sockets):
            self.close(name)
        for socket in list(self._held):
            self.drop(socket)


class RefusedSocket:
    """A connection that could not be opened."""

    state: Final[SocketState] = "closed"

    def __init__(self, failure: str) -> None:
        self.inbox = bytearray()
        self.failure = failure

    def send(self, data: bytes) -> bool:
        return False

    def close(self) -> None: ...


class NoNetwork:
    """Backend of a controller without servers: every connection is refused."""

    def open(self, address: str, port: int) -> RefusedSocket:
        return RefusedSocket("Network is unreachable")
