"""The TCP sockets of a script, as the interpreter sees them.

A backend opens connections; the interpreter never waits for one, it looks at ``state``
and ``inbox`` once per control period. ``MemorySockets`` is a backend without a network.
"""

from typing import Final, Literal, Protocol

from urproto.compat import StrEnum

MOST_SOCKETS: Final = 64
"""Connections of one program (a guess); a file descriptor each."""

SocketState = Literal["connecting", "open", "closed"]


class ScriptNetwork(StrEnum):
    """Which addresses the sockets and remote procedure calls of scripts may connect to.

    The control API and the pendant of an emulator on this machine are none of them, unless they are named: who reaches
    one can do anything, and anybody who reaches a script port can write a script.
    """

    ANY = "any"
    ANY_AND_CONTROL = "any-and-control"
    LOOPBACK = "loopback"
    NONE = "none"


class ScriptSocket(Protocol):
    """One connection. Bytes that arrive are appended to ``inbox``; the reader takes them off its front."""

    inbox: bytearray

    @property
    def state(self) -> SocketState:
        """``closed`` is final; bytes already in ``inbox`` stay readable."""
        ...

    @property
    def failure(self) -> str:
        """Why it is closed when neither side closed it, in the words of the system; else empty."""
        ...

    def send(self, data: bytes) -> bool:
        """Queue bytes for the peer. False when the connection is not open."""
        ...

    def close(self) -> None:
        """Close the connection; does nothing when it is closed already."""
        ...


class ScriptSocketBackend(Protocol):
    """Where connections come from."""

    def open(self, address: str, port: int) -> ScriptSocket:
        """Begin to connect. Never fails: a refused connection turns ``closed``."""
        ...


class SocketTable:
    """The sockets of one program: those the script opened, by their names, and those a handle of it holds."""

    def __init__(self) -> None:
        self._sockets: dict[str, ScriptSocket] = {}
        self._held: list[ScriptSocket] = []

    def __len__(self) -> int:
        return len(self._sockets) + len(self._held)

    def hold(self, socket: ScriptSocket) -> None:
        """Close this one, which no script knows by name, with the others."""
        self._held.append(socket)

    def drop(self, socket: ScriptSocket) -> None:
        """Close one that was held, and forget it."""
        socket.close()
        if socket in self._held:
            self._held.remove(socket)

    def get(self, name: str) -> ScriptSocket | None:
        """The socket of that name, or None when it was never opened or is closed by the script."""
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
        """Close and forget every socket."""
        for name in list(self._sockets):
            self.close(name)
        for socket in list(self._held):
            self.drop(socket)


class MemorySocket:
    """A connection without a network: ``sent`` holds what the script wrote, ``feed`` is the peer writing."""

    def __init__(self, state: SocketState, failure: str = "") -> None:
        self.inbox = bytearray()
        self.sent = bytearray()
        self.failure = failure
        self._state: SocketState = state

    @property
    def state(self) -> SocketState:
        return self._state

    def accept(self) -> None:
        """The peer takes the connection."""
        if self._state == "connecting":
            self._state = "open"

    def feed(self, data: bytes) -> None:
        """Bytes from the peer."""
        self.inbox += data

    def send(self, data: bytes) -> bool:
        if self._state != "open":
            return False
        self.sent += data
        return True

    def close(self) -> None:
        self._state = "closed"


class MemorySockets:
    """Backend for tests: connects at once to the addresses in ``listening``, refuses all others.

    ``opened`` lists the connections in order. Addresses in ``silent`` never answer.
    """

    def __init__(self, *listening: tuple[str, int]) -> None:
        self.listening = set(listening)
        self.silent: set[tuple[str, int]] = set()
        self.opened: list[MemorySocket] = []

    def open(self, address: str, port: int) -> MemorySocket:
        where = (address, port)
        state: SocketState = "connecting" if where in self.silent else "open" if where in self.listening else "closed"
        socket = MemorySocket(state, "Connection refused" if state == "closed" else "")
        self.opened.append(socket)
        return socket


class NoNetwork:
    """Backend of a controller without servers: every connection is refused."""

    def open(self, address: str, port: int) -> MemorySocket:
        return MemorySocket("closed", "Network is unreachable")
