"""Addresses of this machine."""

from ipaddress import IPv6Address, ip_address
from typing import Final

_LOOPBACK_OF: Final = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}


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
