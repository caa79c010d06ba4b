"""The script sender (50002): the program for a robot whose External Control URCap asks for it."""

import logging
from collections.abc import Callable
from typing import Final

from client.driver.endpoint import Endpoint, Peer
from urproto.external_control import REQUEST_PROGRAM
from urproto.text import to_bytes

__all__ = ["SENDER_PORT", "ScriptSender"]

SENDER_PORT: Final = 50002
_LONGEST_REQUEST: Final = 1024  # bytes without a line end (guess)

_logger = logging.getLogger(__name__)


class ScriptSender(Endpoint):
    """Answers every request with the program; any number of robots may ask at the same time.

    program: gives the text, bare statements between the URCap's anchors. requests: how many
    there were. The connection stays open, and the program has no end mark: so does the protocol.
    """

    def __init__(self, program: Callable[[], str], port: int = SENDER_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self.requests = 0
        self._program = program
        self._unread: dict[Peer, bytes] = {}

    def _arrived(self, peer: Peer) -> None:
        self._peers.add(peer)
        self._unread[peer] = b""

    def _received(self, peer: Peer, data: bytes) -> None:
        *lines, rest = (self._unread[peer] + data).split(b"\n")
        self._unread[peer] = rest
        for line in lines:
            self._answer(peer, line)
        if len(rest) > _LONGEST_REQUEST:
            _logger.warning("%s sends no request but %d bytes", peer.address, len(rest))
            peer.abort()

    def _answer(self, peer: Peer, line: bytes) -> None:
        if line.rstrip(b"\r") != REQUEST_PROGRAM.rstrip(b"\n"):
            _logger.warning("%s asks for %r; only the program can be had here", peer.address, line[:80])
            return
        self.requests += 1
        peer.transport.write(to_bytes(self._program()) + b"\n")

    def _left(self, peer: Peer) -> None:
        self._peers.discard(peer)
        self._unread.pop(peer, None)
