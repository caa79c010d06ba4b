"""What the person who started the server agreed to: the addresses, and whether anything may move."""

from dataclasses import dataclass

from client.errors import ClientError
from urproto.addresses import is_loopback


@dataclass(frozen=True)
class Consent:
    """addresses: robots beyond this machine. motion: whether tools may move arms and change robots."""

    addresses: frozenset[str] = frozenset()
    motion: bool = False

    def check(self, address: str) -> None:
        """Raise ClientError for the address of a robot to which the person did not agree."""
        if not is_loopback(address) and address not in self.addresses:
            known = ", ".join(sorted(self.addresses)) or "none"
            raise ClientError(
                f"{address!r} is not on this machine, and the person who started this server did not agree to it "
                f"(agreed: {known}): ask them to add --allow {address}"
            )
