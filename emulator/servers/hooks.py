"""Functions that see and may change the data that passes through a port, such as faults and observers.

A hook that holds bytes back reports their number (``Connection.keep``) and passes them on later
(``Connection.pass_on``) to the hooks after it; meanwhile they count as bytes that wait for the client.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Generic, TypeAlias, TypeVar

from emulator.snapshot import Snapshot

ConnectionT = TypeVar("ConnectionT")


class Direction(Enum):
    """Direction of data, as seen by the controller."""

    RECEIVED = "received"
    SENT = "sent"


BytesHook: TypeAlias = Callable[[ConnectionT, Direction, bytes], bytes]


@dataclass
class Hooks(Generic[ConnectionT]):
    """Functions that see and may change the data that passes through a port. They are called in order.

    on_connect: returns False to reject the client. on_bytes: returns the bytes to pass on instead, possibly none.
    on_message: the same for one decoded request, or for an answer before it is encoded; None drops it. Broadcast
    states pass through on_bytes only. on_state: returns the snapshot that the state ports show instead of a period's.
    """

    on_connect: list[Callable[[ConnectionT], bool]] = field(default_factory=list)
    on_bytes: list[BytesHook[ConnectionT]] = field(default_factory=list)
    on_message: list[Callable[[ConnectionT, Direction, Any], Any]] = field(default_factory=list)
    on_state: list[Callable[[Snapshot], Snapshot]] = field(default_factory=list)

    def admits(self, connection: ConnectionT) -> bool:
        return all(hook(connection) for hook in self.on_connect)

    def bytes(
        self, connection: ConnectionT, direction: Direction, data: bytes, after: BytesHook[ConnectionT] | None = None
    ) -> bytes:
        """Return the bytes that pass through all hooks, or through those after ``after``."""
        hooks = self.on_bytes
        for hook in hooks if after is None else hooks[_place_after(hooks, after) :]:
            if not data:
                break
            data = hook(connection, direction, data)
        return data

    def state(self, snapshot: Snapshot) -> Snapshot:
        for hook in self.on_state:
            snapshot = hook(snapshot)
        return snapshot

    def message(self, connection: ConnectionT, direction: Direction, message: Any) -> Any:
        """Return the message that passes through all hooks, None if one of them dropped it."""
        for hook in self.on_message:
            if message is not None:
                message = hook(connection, direction, message)
        return message


def _place_after(hooks: list[BytesHook[ConnectionT]], hook: BytesHook[ConnectionT]) -> int:
    return hooks.index(hook) + 1 if hook in hooks else len(hooks)
