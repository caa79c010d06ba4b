"""Functions that see, and may change, what passes through a port: faults, and whoever listens.

A hook that keeps bytes back says how many (``Connection.keep``) and passes them on later (``Connection.pass_on``), to
the hooks after it; meanwhile they count as bytes that wait for the client.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Generic, TypeAlias, TypeVar

from emulator.snapshot import Snapshot

ConnectionT = TypeVar("ConnectionT")


class Direction(Enum):
    """Which way something travels, as the controller sees it."""

    RECEIVED = "received"
    SENT = "sent"


BytesHook: TypeAlias = Callable[[ConnectionT, Direction, bytes], bytes]


@dataclass
class Hooks(Generic[ConnectionT]):
    """Functions that see, and may change, what passes through a port. Called in order.

    on_connect: False turns the client away. on_bytes: returns the bytes that pass instead,
    possibly none. on_message: as on_bytes for one decoded request or encoded-to-be answer;
    None drops it. State broadcasts pass on_bytes only. on_state: what the state ports show
    instead of a period's snapshot.
    """

    on_connect: list[Callable[[ConnectionT], bool]] = field(default_factory=list)
    on_bytes: list[BytesHook[ConnectionT]] = field(default_factory=list)
    on_message: list[Callable[[ConnectionT, Direction, Any], Any]] = field(default_factory=list)
    on_state: list[Callable[[Snapshot], Snapshot]] = field(default_factory=list)

    def admits(self, connection: ConnectionT) -> bool:
        """True when no hook turns the client away."""
        return all(hook(connection) for hook in self.on_connect)

    def bytes(
        self, connection: ConnectionT, direction: Direction, data: bytes, after: BytesHook[ConnectionT] | None = None
    ) -> bytes:
        """The bytes that pass, of all hooks or of those after one."""
        hooks = self.on_bytes
        for hook in hooks if after is None else hooks[_place_after(hooks, after) :]:
            if not data:
                break
            data = hook(connection, direction, data)
        return data

    def state(self, snapshot: Snapshot) -> Snapshot:
        """The snapshot that is shown."""
        for hook in self.on_state:
            snapshot = hook(snapshot)
        return snapshot

    def message(self, connection: ConnectionT, direction: Direction, message: Any) -> Any:
        """The message that passes, None when one of the hooks dropped it."""
        for hook in self.on_message:
            if message is not None:
                message = hook(connection, direction, message)
        return message


def _place_after(hooks: list[BytesHook[ConnectionT]], hook: BytesHook[ConnectionT]) -> int:
    return hooks.index(hook) + 1 if hook in hooks else len(hooks)
