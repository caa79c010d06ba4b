"""Where a connection leads that a program opens to the controller itself.

To a program, 127.0.0.1 is the controller it runs on. The emulated one may listen on another
address, and on other ports than the usual ones.
"""

from collections.abc import Mapping
from typing import Final

__all__ = ["OwnPorts"]

_ITSELF: Final = frozenset({"127.0.0.1", "::1", "localhost"})
_ANYWHERE: Final = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # listening everywhere, reached here


class OwnPorts:
    """The controller's ports by their usual numbers; none until they are open."""

    def __init__(self) -> None:
        self._listening: Mapping[int, tuple[str, int]] = {}

    def opened(self, host: str, ports: Mapping[int, int]) -> None:
        """The controller listens on this address; usual port to real port."""
        address = _ANYWHERE.get(host, host)
        self._listening = {usual: (address, real) for usual, real in ports.items()}

    def reach(self, address: str, port: int) -> tuple[str, int]:
        """Where to connect instead, for one of the controller's own ports on loopback; else the same again."""
        return self._listening.get(port, (address, port)) if address in _ITSELF else (address, port)
