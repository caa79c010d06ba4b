"""Detect resources that a test leaves behind in its process: threads and listening ports."""

import os
import socket
import threading
import time
from dataclasses import dataclass, field
from typing import Final

from urproto.compat import Self

_DESCRIPTORS: Final = "/proc/self/fd"
_INTERNET: Final = (socket.AF_INET, socket.AF_INET6)
_GRACE_S: Final = 1.0  # guess: how long a thread may take to finish after a stop request, or a port to close
_POLL_S: Final = 0.01


@dataclass
class Resources:
    """An inventory of threads and listening ports, which are allowed to exist."""

    threads: set[threading.Thread] = field(default_factory=set)
    ports: set[str] = field(default_factory=set)

    @classmethod
    def now(cls) -> Self:
        """The current threads and ports."""
        return cls(set(threading.enumerate()), listening_sockets())

    def add(self, other: "Resources") -> None:
        """Also allow those of another inventory."""
        self.threads |= other.threads
        self.ports |= other.ports

    def new(self) -> "Resources":
        """The current threads and ports that are not in the inventory."""
        return Resources(set(threading.enumerate()) - self.threads, listening_sockets() - self.ports)

    def leaks(self) -> list[str]:
        """One line for each kind of leaked resource; waits a moment for those that are closing."""
        end = time.monotonic() + _GRACE_S
        for thread in set(threading.enumerate()) - self.threads:
            if thread is not threading.current_thread():
                thread.join(max(end - time.monotonic(), 0.0))
        left = self.new()
        while left.ports and time.monotonic() < end:
            time.sleep(_POLL_S)
            left = self.new()
        threads = ", ".join(sorted(thread.name for thread in left.threads))
        ports = ", ".join(sorted(left.ports))
        return [f"{kind}: {names}" for kind, names in (("threads", threads), ("listening ports", ports)) if names]


def listening_sockets() -> set[str]:
    """TCP ports this process listens on, with the kernel's socket numbers: "port 8080 (socket:[1234])".

    Linux only; empty on other systems. This runs twice for every test, so it inspects the process's descriptors: the
    kernel takes a hundred times as long for its table of all connections on the machine.
    """
    found = set()
    for descriptor in os.listdir(_DESCRIPTORS) if os.path.exists(_DESCRIPTORS) else ():
        try:
            link = os.readlink(f"{_DESCRIPTORS}/{descriptor}")
            port = _listening_port(int(descriptor)) if link.startswith("socket:") else None
        except OSError:  # closed in the meantime, like the descriptor of the listing itself
            continue
        if port is not None:
            found.add(f"port {port} ({link})")
    return found


def _listening_port(descriptor: int) -> int | None:
    """The port of a listening TCP socket; None for another socket. Raises OSError if it is not a socket, or closed."""
    borrowed = socket.socket(fileno=descriptor)
    try:
        is_tcp = borrowed.family in _INTERNET and borrowed.type == socket.SOCK_STREAM
        if not is_tcp or not borrowed.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return None
        port: int = borrowed.getsockname()[1]
        return port
    finally:
        borrowed.detach()
