"""Addresses of this machine, and marks for ports that bypass a robot's access control.

Control APIs and teach pendants announce where they listen. Otherwise, a client that may only send a script to a robot
could have the script connect to these ports from the machine that the robot runs on, and do anything there. The mark is
the name of an abstract Unix socket, which every process on the machine can see and which disappears with its process
(Linux; on other systems, only marks of the same process are known).
"""

import socket
import sys
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

_LOOPBACK_OF: Final = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}

_marked: set[str] = set()  # by this process


def local_address(host: str) -> str:
    """The address at which this machine reaches a server that listens on ``host``, which may mean all addresses."""
    return _LOOPBACK_OF.get(host, host)


def is_loopback(host: str) -> bool:
    """Whether a server that listens on this address can be reached from this machine only; False for other names."""
    try:
        address = ip_address(host)
    except ValueError:
        return host == "localhost"
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return (mapped or address).is_loopback


class BackdoorMark:
    """Announces a control API or a pendant at an address and port, until ``close``. Raises OSError on failure.

    address: numeric.
    """

    def __init__(self, address: str, port: int) -> None:
        self._name = _name_of(address, port)
        self._socket: socket.socket | None = None
        if sys.platform == "linux":
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                self._socket.bind(self._name)
            except OSError:
                self._socket.close()
                raise
        _marked.add(self._name)

    def close(self) -> None:
        """Remove the mark."""
        _marked.discard(self._name)
        if self._socket is not None:
            self._socket.close()


def is_backdoor(address: str, port: int) -> bool:
    """Whether a connection to this numeric address leads to a control API or a pendant on this machine.

    Raises OSError when this cannot be determined.
    """
    scope_free = ip_address(address.partition("%")[0])
    mapped = scope_free.ipv4_mapped if isinstance(scope_free, IPv6Address) else None
    target: IPv4Address | IPv6Address = mapped or scope_free
    numeric = local_address(str(target))
    anywhere = "0.0.0.0" if target.version == 4 else "::"
    return _is_marked(_name_of(numeric, port)) or (
        _is_marked(_name_of(anywhere, port)) and _is_local(numeric, target.version)
    )


def _is_local(address: str, version: int) -> bool:
    """Whether the address belongs to this machine."""
    family = socket.AF_INET if version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as local:
            local.bind((address, 0))
    except OSError:
        return False
    return True


def _is_marked(name: str) -> bool:
    if name in _marked or sys.platform != "linux":
        return name in _marked
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(name)
        except ConnectionRefusedError:
            return False
    return True


def _name_of(address: str, port: int) -> str:
    return f"\0ur-emulator behind a robot {address} {port}"
