"""Where a connection leads that a program opens on this machine: to its own controller, or to a control API.

To a program, 127.0.0.1 is the controller it runs on. The emulated one may listen on another
address, and on other ports than the usual ones.

No program may use the control API unless it is told so, and there may be many of them on a machine: of a fleet, whose
robots are in several processes, or of tests. So each marks the address and port it listens on by a name that this
machine's processes see, and that is gone with its process: an abstract Unix socket, where there are such (Linux; the
names belong to a network namespace, as loopback addresses do). Elsewhere only those of the same process are known.
"""

import socket
import sys
from collections.abc import Mapping
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

__all__ = ["ControlMark", "OwnPorts", "leads_to_control"]

_ITSELF: Final = frozenset({"127.0.0.1", "::1", "localhost"})
_ANYWHERE: Final = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # listening everywhere, reached here
_HAS_NAMES: Final = sys.platform == "linux"

_marked: set[str] = set()  # by this process


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


class ControlMark:
    """Says that a control API listens there, until ``close``. Raises OSError when that cannot be said."""

    def __init__(self, address: str, port: int) -> None:
        self._name = _name_of(address, port)
        self._socket: socket.socket | None = None
        if _HAS_NAMES:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.bind(self._name)
        _marked.add(self._name)

    def close(self) -> None:
        """It listens no longer."""
        _marked.discard(self._name)
        if self._socket is not None:
            self._socket.close()


def leads_to_control(address: str, port: int) -> bool:
    """Whether a connection to this numeric address ends at the control API of an emulator on this machine.

    Raises OSError when that cannot be found out.
    """
    scope_free = ip_address(address.partition("%")[0])
    mapped = scope_free.ipv4_mapped if isinstance(scope_free, IPv6Address) else None
    wanted: IPv4Address | IPv6Address = mapped or scope_free
    numeric = _ANYWHERE.get(str(wanted), str(wanted))  # systems connect to this machine there
    anywhere = "0.0.0.0" if wanted.version == 4 else "::"
    return _is_marked(_name_of(numeric, port)) or (
        _is_marked(_name_of(anywhere, port)) and _is_here(numeric, wanted.version)
    )


def _is_here(address: str, version: int) -> bool:
    """Whether this machine has the address: others cannot listen on it."""
    family = socket.AF_INET if version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as local:
            local.bind((address, 0))
    except OSError:
        return False
    return True


def _is_marked(name: str) -> bool:
    if name in _marked or not _HAS_NAMES:
        return name in _marked
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(name)
        except ConnectionRefusedError:
            return False
    return True


def _name_of(address: str, port: int) -> str:
    return f"\0ur-emulator control API {address} {port}"
