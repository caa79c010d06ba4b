"""Peers on sockets: what one does on each connection of a script, in robot time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from emulator.controller import Controller
from emulator.peers.answers import Answerer, GripperPeer, Reply
from emulator.peers.log import PeerLog
from emulator.peers.modbus import PeerModbus, UnitPeer
from emulator.services.sockets import NoNetwork, RefusedSocket, ScriptSocket, ScriptSocketBackend, SocketState
from urproto import robotiq

ANY = "*"


@dataclass(frozen=True)
class Announcement:
    """What a peer sends unasked: at `reply.delay_s` after the connection and, with `every_s`, repeatedly after that."""

    reply: Reply
    every_s: float = math.inf


@dataclass
class SocketPeer:
    """A peer. delay_s: before each answer. refusals: the number of connections that it refuses first."""

    log: PeerLog
    answerer: Answerer
    announcements: Sequence[Announcement] = ()
    delay_s: float = 0.0
    refusals: float = 0


@dataclass
class Peers:
    """The peers of a run by their addresses: sockets by host or ``*`` and port, Modbus units by host."""

    sockets: dict[tuple[str, int], SocketPeer]
    units: dict[str, UnitPeer]
    _network: ScriptSocketBackend = field(default_factory=NoNetwork)

    @property
    def logs(self) -> list[PeerLog]:
        return [*(peer.log for peer in self.sockets.values()), *(unit.log for unit in self.units.values())]

    def attach(self, controller: Controller, network: ScriptSocketBackend) -> None:
        """Connect the scripts of a controller to these peers and its own gripper, and otherwise to `network`."""
        if controller.gripper is not None:
            log = PeerLog(f"{ANY}:{robotiq.PORT}")
            self.sockets.setdefault((ANY, robotiq.PORT), SocketPeer(log, GripperPeer(log, controller.gripper)))
        for log in self.logs:
            log.now = lambda: controller.time_s
        self._network = network
        programs = controller.programs
        programs.socket_backend = self
        programs.modbus.backend = PeerModbus(self.units, programs.modbus.backend)

    def open(self, address: str, port: int) -> ScriptSocket:
        """Begin to connect; a peer of the file decides immediately."""
        peer = self.sockets.get((address, port)) or self.sockets.get((ANY, port))
        if peer is None:
            return self._network.open(address, port)
        if peer.refusals > 0:
            peer.refusals -= 1
            return RefusedSocket("Connection refused")
        return PeerSocket(peer)


class PeerSocket:
    """One connection to a peer."""

    def __init__(self, peer: SocketPeer) -> None:
        self.failure = ""
        self.inbox = bytearray()
        self._peer = peer
        self._state: SocketState = "open"
        self._unread = bytearray()  # by the peer: the beginning of a message
        self._sent_s = self._busy_until_s = now_s = peer.log.now()
        self._due: list[tuple[float, Reply, float]] = [
            (now_s + one.reply.delay_s, one.reply, one.every_s) for one in peer.announcements
        ]
        self._advance()

    @property
    def state(self) -> SocketState:
        self._advance()
        return self._state

    def send(self, data: bytes) -> bool:
        if self.state != "open":
            return False
        self._unread += data
        self._sent_s = self._peer.log.now()
        self._answer(idle=False)
        self._advance()
        return True

    def close(self) -> None:
        self._state = "closed"

    def _advance(self) -> None:
        """Do what is due: a script checks the state of its connection every control period."""
        now_s = self._peer.log.now()
        if self._unread and now_s > self._sent_s:
            self._answer(idle=True)
        while self._state == "open" and (due := min(self._due, key=lambda one: one[0], default=None)):
            at_s, reply, every_s = due
            if at_s > now_s:
                break
            self._due.remove(due)
            if every_s < math.inf:
                self._due.append((at_s + every_s, reply, every_s))
            self.inbox += reply.data
            if reply.close:
                self._state = "closed"

    def _answer(self, *, idle: bool) -> None:
        """Answer the complete messages: one after the other, so none overtakes a delayed one."""
        for message in self._peer.answerer.cut(self._unread, idle):
            reply = self._peer.answerer.answer(message)
            self._busy_until_s = max(self._busy_until_s, self._peer.log.now()) + self._peer.delay_s + reply.delay_s
            if reply.data or reply.close:
                self._due.append((self._busy_until_s, reply, math.inf))
