"""What a test leaves behind in its own process: threads and listening ports."""

import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

__all__ = ["Belongings", "listening_sockets"]

_TABLES: Final = ("/proc/net/tcp", "/proc/net/tcp6")
_DESCRIPTORS: Final = Path("/proc/self/fd")
_LISTENS: Final = "0A"  # state of a socket in these tables (proc_net_tcp)
_PATIENCE_S: Final = 1.0  # guess: what a thread that was told to end may take to do so


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
        """One line for each kind of thing that is there and may not be; threads that are ending get a moment to."""
        end = time.monotonic() + _PATIENCE_S
        for thread in set(threading.enumerate()) - self.threads:
            if thread is not threading.current_thread():
                thread.join(max(end - time.monotonic(), 0.0))
        left = self.new()
        threads = ", ".join(sorted(thread.name for thread in left.threads))
        ports = ", ".join(sorted(left.ports))
        return [f"{kind}: {names}" for kind, names in (("threads", threads), ("listening ports", ports)) if names]


def listening_sockets() -> set[str]:
    """TCP ports this process listens on, as the kernel numbers its sockets: "port 8080 (socket:[1234])".

    Linux; empty elsewhere.
    """
    listening: dict[str, int] = {}
    for table in map(Path, _TABLES):
        rows = (line.split() for line in table.read_text().splitlines()[1:]) if table.exists() else ()
        listening |= {f"socket:[{row[9]}]": int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == _LISTENS}
    return {f"port {listening[link]} ({link})" for link in _open_descriptors() if link in listening}


def _open_descriptors() -> set[str]:
    links = set()
    for descriptor in os.listdir(_DESCRIPTORS) if _DESCRIPTORS.exists() else ():
        try:
            links.add(os.readlink(_DESCRIPTORS / descriptor))
        except OSError:  # closed meanwhile, as the listing's own descriptor is
            continue
    return links
