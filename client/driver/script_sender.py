"""The port from which the URCap fetches the control program."""

import logging
from collections.abc import Callable
from typing import Final

from client.driver.endpoint import Endpoint, Peer
from urproto.external_control import REQUEST_PROGRAM
from urproto.text import to_bytes

SENDER_PORT: Final = 50002
_MAX_REQUEST: Final = 1024  # bytes without a line end (guess)

_logger = logging.getLogger(__name__)


class ScriptSender(Endpoint):
    """Answers every request with the program; any number of robots may request it at the same time.

    program: returns the text, bare statements between the URCap's anchors. The connection stays open and the program
    has no end marker, as the protocol demands.
    """

    requests: int
    """Number of requests so far."""

    def __init__(self, program: Callable[[], str], port: int = SENDER_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self.requests = 0
        self._program = program
        self._unread: dict[Peer, bytes] = {}

    def _on_accepted(self, peer: Peer) -> None:
        self._peers.add(peer)
        self._unread[peer] = b""

    def _received(self, peer: Peer, data: bytes) -> None:
        *lines, rest = (self._unread[peer] + data).split(b"\n")
        self._unread[peer] = rest
        for line in lines:
            self._answer(peer, line)
        if len(rest) > _MAX_REQUEST:
            _logger.warning("%s sent %d bytes without a request: disconnected", peer.address, len(rest))
            peer.abort()

    def _answer(self, peer: Peer, line: bytes) -> None:
        if line.rstrip(b"\r") != REQUEST_PROGRAM.rstrip(b"\n"):
            _logger.warning("%s requested %r: this port only serves the control program", peer.address, line[:80])
            return
        self.requests += 1
        peer.transport.write(to_bytes(self._program()) + b"\n")

    def _on_closed(self, peer: Peer) -> None:
        self._peers.discard(peer)
        self._unread.pop(peer, None)
