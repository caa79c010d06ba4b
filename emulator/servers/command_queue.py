"""The commands of one connection, carried out one after the other."""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from emulator.mailbox import Command
from emulator.servers.port import Reply, ServedController

_MOST_WAITING: Final = 64  # requests of one connection before it is not read further (guess)


class CommandQueue:
    """Hands one connection's commands to the controller in order, ``at_once`` of them unanswered.

    ``read_on`` is called with False when too many wait and with True when they are done.
    The queue outlives its connection: a script sent just before closing still runs.
    """

    def __init__(self, controller: ServedController, read_on: Callable[[bool], None], at_once: int = 1) -> None:
        self._controller = controller
        self._read_on = read_on
        self._at_once = at_once
        self._waiting: deque[tuple[Command, Reply | None]] = deque()
        self._unanswered = 0

    @property
    def full(self) -> bool:
        """True when no more should be put into it for now."""
        return len(self._waiting) > _MOST_WAITING

    @property
    def idle(self) -> bool:
        """True when everything has been answered."""
        return not self._waiting and not self._unanswered

    def put(self, command: Command, reply: Reply | None = None) -> None:
        """Carry out a command after those before it."""
        self._waiting.append((command, reply))
        self._post()
        if self.full:
            self._read_on(False)

    def clear(self) -> None:
        """Forget what was not yet handed over."""
        self._waiting.clear()

    def _post(self) -> None:
        while self._waiting and self._unanswered < self._at_once:
            command, reply = self._waiting.popleft()
            self._unanswered += 1
            self._controller.post(command, partial(self._answered, reply))

    def _answered(self, reply: Reply | None, answer: Any) -> None:
        self._unanswered -= 1
        try:
            if reply is not None:
                reply(answer)
        finally:
            self._post()
            if not self._waiting:
                self._read_on(True)
