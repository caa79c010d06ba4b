"""Peers of a program whose data arrive late, garbled or not at all, although they themselves do their best."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from emulator.services.sockets import ScriptSocket, ScriptSocketBackend, SocketState

Address = tuple[str, int]


def address_of(text: str) -> Address:
    """The address ``HOST:PORT``. Raises ValueError."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal():
        raise ValueError(f"{text!r} is not HOST:PORT")
    return host, int(port)


@dataclass
class _Disturbance:
    until_s: float
    late_s: float
    garbled: bool
    silent: bool


class PeerDisturbance:
    """Opens sockets with another backend, and disturbs what arrives. now: robot time [s]."""

    def __init__(self, backend: ScriptSocketBackend, now: Callable[[], float]) -> None:
        self.now = now
        self._backend = backend
        self._disturbed: dict[Address, _Disturbance] = {}

    def begin(
        self,
        address: Address,
        *,
        late: float = 0.0,
        garbled: bool = False,
        silent: bool = False,
        lasting: float = math.inf,
    ) -> None:
        """Disturb what arrives from an address from now on."""
        self._disturbed[address] = _Disturbance(self.now() + lasting, late, garbled, silent)

    def open(self, address: str, port: int) -> ScriptSocket:
        return _DisturbedSocket(self._backend.open(address, port), self, (address, port))

    def on(self, address: Address) -> _Disturbance | None:
        """What is in force for an address."""
        found = self._disturbed.get(address)
        return found if found is not None and self.now() < found.until_s else None


class _DisturbedSocket:
    def __init__(self, socket: ScriptSocket, peers: PeerDisturbance, address: Address) -> None:
        self.inbox = bytearray()
        self._socket = socket
        self._peers = peers
        self._address = address
        self._due: deque[tuple[float, bytes]] = deque()

    @property
    def state(self) -> SocketState:
        """Also takes what has arrived: a script asks every control period."""
        state = self._socket.state
        self._take()
        return "open" if state == "closed" and self._due else state

    @property
    def failure(self) -> str:
        return self._socket.failure

    def send(self, data: bytes) -> bool:
        sent = self._socket.send(data)
        self._take()
        return sent

    def close(self) -> None:
        self._due.clear()
        self._socket.close()

    def _take(self) -> None:
        now_s = self._peers.now()
        if data := bytes(self._socket.inbox):
            self._socket.inbox.clear()
            disturbance = self._peers.on(self._address)
            if disturbance is None:
                self._due.append((now_s, data))
            elif not disturbance.silent:
                data = bytes(byte ^ 1 for byte in data) if disturbance.garbled else data
                self._due.append((now_s + disturbance.late_s, data))
        while self._due and self._due[0][0] <= now_s:
            self.inbox += self._due.popleft()[1]
