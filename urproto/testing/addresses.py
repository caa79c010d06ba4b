"""A loopback address for each emulator, so that many have the usual ports at the same time.

Every 127.x.y.z is this machine on Linux. Elsewhere only 127.0.0.1 is: emulators take free ports there.
"""

import errno
import itertools
import os
import socket
from dataclasses import dataclass
from typing import Final

__all__ = ["ClaimedAddress", "NoAddress", "claim_address"]

_FIRST: Final = 0x7F40_0000  # 127.64.0.0: away from addresses that people type
_COUNT: Final = 2**22
_STRIDE: Final = 61  # between two processes; prime, so that neighbours are soon apart
_TRIES: Final = 200
_LOCK_PORT: Final = 29999  # UDP, which controllers do not use
_DASHBOARD_PORT: Final = 29999
_ONLY_ADDRESS: Final = "127.0.0.1"

_next = itertools.count(os.getpid() * _STRIDE)


class NoAddress(OSError):  # noqa: N818 - named for what is the case
    """No loopback address has its usual ports free."""


@dataclass
class ClaimedAddress:
    """An address that nobody else claims until ``release``. shared: the only one there is; take free ports."""

    host: str
    shared: bool
    _lock: socket.socket | None = None

    def release(self) -> None:
        """Let others have it."""
        if self._lock is not None:
            self._lock.close()


def claim_address() -> ClaimedAddress:
    """An own address. Raises NoAddress when something on this machine has the usual ports of all addresses."""
    for number in itertools.islice(_next, _TRIES):
        host = socket.inet_ntoa((_FIRST + number % _COUNT).to_bytes(4))
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            lock.bind((host, _LOCK_PORT))
            _bind_once(host)
        except OSError as error:
            lock.close()
            if error.errno == errno.EADDRNOTAVAIL:
                return ClaimedAddress(_ONLY_ADDRESS, shared=True)
            continue
        return ClaimedAddress(host, shared=False, _lock=lock)
    raise NoAddress(
        f"port {_DASHBOARD_PORT} is taken on every loopback address: something listens on 0.0.0.0, perhaps another "
        "emulator or a container. Stop it, or let this emulator have free ports (ephemeral_ports=True)"
    )


def _bind_once(host: str) -> None:
    with socket.socket() as probe:
        probe.bind((host, _DASHBOARD_PORT))
