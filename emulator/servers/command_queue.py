"""The queue of commands of one connection."""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from emulator.mailbox import Command
from emulator.servers.connection import Connection
from emulator.servers.port import Reply, ServedController

_MAX_WAITING: Final = 64  # requests of one connection; above that, reading from it pauses (guess)


class CommandQueue:
    """Passes the commands of one connection to the controller in order, at most ``max_unanswered`` at a time.

    ``read_on`` is called with False when too many are waiting, and with True when none is waiting any more.
    The queue outlives its connection: a script that was sent just before closing still runs.
    """

    def __init__(
        self,
        controller: ServedController,
        read_on: Callable[[bool], None],
        max_unanswered: int = 1,
        *,
        client: Connection | None = None,
    ) -> None:
        self._client = client
        self._controller = controller
        self._read_on = read_on
        self._max_unanswered = max_unanswered
        self._waiting: deque[tuple[Command, Reply | None]] = deque()
        self._unanswered = 0

    @property
    def full(self) -> bool:
        """Whether no more commands should be added for now."""
        return len(self._waiting) > _MAX_WAITING

    @property
    def idle(self) -> bool:
        """Whether all commands have been answered."""
        return not self._waiting and not self._unanswered

    def put(self, command: Command, reply: Reply | None = None) -> None:
        """Add a command; ``reply`` is called with its answer."""
        self._waiting.append((command, reply))
        self._post()
        if self.full:
            self._read_on(False)

    def clear(self) -> None:
        """Drop the commands that have not been passed to the controller yet."""
        self._waiting.clear()

    def keep(self, count: int) -> None:
        """Drop the commands that have not been passed to the controller yet, except for the first ones."""
        while len(self._waiting) > count:
            self._waiting.pop()

    def _post(self) -> None:
        while self._waiting and self._unanswered < self._max_unanswered:
            command, reply = self._waiting.popleft()
            self._unanswered += 1
            client = "" if self._client is None else self._client.peer
            self._controller.post(command, partial(self._answered, reply), client)

    def _answered(self, reply: Reply | None, answer: Any) -> None:
        self._unanswered -= 1
        try:
            if reply is not None:
                reply(answer)
        finally:
            self._post()
            if not self._waiting:
                self._read_on(True)
