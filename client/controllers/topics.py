"""What controllers tell whoever listens."""

from collections.abc import Callable
from typing import Generic, TypeVar

from client.driver.endpoint import tell

__all__ = ["Topic"]

Message = TypeVar("Message")


class Topic(Generic[Message]):
    """The newest message of a kind, and who wants to be called with each.

    name: as in ROS 2, where ~ stands for the controller.
    """

    __slots__ = ("_listeners", "latest", "name")

    def __init__(self, name: str) -> None:
        self.name = name
        self.latest: Message | None = None
        self._listeners: list[Callable[[Message], object]] = []

    def subscribe(self, listener: Callable[[Message], object]) -> Callable[[], None]:
        """Call back with each message, within the control cycle: briefly. Gives what ends it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def publish(self, message: Message) -> None:
        """Keep it, and tell everybody; a listener that raises is logged and harms nobody else."""
        self.latest = message
        if self._listeners:
            tell(self._listeners, message)
