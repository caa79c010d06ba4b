"""What a test leaves behind in its own process: threads and listening ports."""

import os
import socket
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from urproto.compat import Self

_DESCRIPTORS: Final = Path("/proc/self/fd")
_INTERNET: Final = (socket.AF_INET, socket.AF_INET6)
_PATIENCE_S: Final = 1.0  # guess: what a thread that was told to end may take to do so, or its port to be closed
_LOOK_S: Final = 0.01


@dataclass
class Belongings:
    """Threads and listening ports that may be there."""

    threads: set[threading.Thread] = field(default_factory=set)
    ports: set[str] = field(default_factory=set)

    @classmethod
    def now(cls) -> Self:
        """All that are there."""
        return cls(set(threading.enumerate()), listening_sockets())

    def add(self, other: "Belongings") -> None:
        """Those of another inventory may be there as well."""
        self.threads |= other.threads
        self.ports |= other.ports

    def new(self) -> "Belongings":
        """What is there and may not be."""
        return Belongings(set(threading.enumerate()) - self.threads, listening_sockets() - self.ports)

    def complaints(self) -> list[str]:
        """One line for each kind of thing that is there and may not be; what is ending gets a moment to."""
        end = time.monotonic() + _PATIENCE_S
        for thread in set(threading.enumerate()) - self.threads:
            if thread is not threading.current_thread():
                thread.join(max(end - time.monotonic(), 0.0))
        left = self.new()
        while left.ports and time.monotonic() < end:
            time.sleep(_LOOK_S)
            left = self.new()
        threads = ", ".join(sorted(thread.name for thread in left.threads))
        ports = ", ".join(sorted(left.ports))
        return [f"{kind}: {names}" for kind, names in (("threads", threads), ("listening ports", ports)) if names]


def listening_sockets() -> set[str]:
    """TCP ports this process listens on, as the kernel numbers its sockets: "port 8080 (socket:[1234])".

    Linux; empty elsewhere. Every test asks twice, so the descriptors are asked: the kernel's table of all connections
    of the machine takes it a hundred times as long to write.
    """
    found = set()
    for descriptor in os.listdir(_DESCRIPTORS) if _DESCRIPTORS.exists() else ():
        try:
            link = os.readlink(_DESCRIPTORS / descriptor)
            port = _listening_port(int(descriptor)) if link.startswith("socket:") else None
        except OSError:  # closed meanwhile, as the listing's own descriptor is
            continue
        if port is not None:
            found.add(f"port {port} ({link})")
    return found


def _listening_port(descriptor: int) -> int | None:
    """Of a TCP server; None of any other socket. Raises OSError if it is none, or no longer."""
    borrowed = socket.socket(fileno=descriptor)
    try:
        is_tcp = borrowed.family in _INTERNET and borrowed.type == socket.SOCK_STREAM
        if not is_tcp or not borrowed.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return None
        port: int = borrowed.getsockname()[1]
        return port
    finally:
        borrowed.detach()
