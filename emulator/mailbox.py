"""Commands on their way to the controller: posted between ticks, carried out in the next one, answered once."""

import logging
from collections import deque
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

from emulator.guard import Novelty

if TYPE_CHECKING:
    from emulator.commands import Command
    from emulator.controller import Controller

__all__ = ["Mailbox", "Reply", "deliver"]

Reply = Callable[[Any], None]
_Waiting = Generator[None, None, Any]

_logger = logging.getLogger(__name__)


class Mailbox:
    """What was posted to a controller and is not answered yet."""

    def __init__(self, controller: "Controller") -> None:
        self._controller = controller
        self._posted: deque[tuple[Command, Reply | None]] = deque()
        self._waiting: list[tuple[_Waiting, Command, Reply | None]] = []
        self._novelty = Novelty()

    def post(self, command: "Command", reply: Reply | None) -> None:
        """Queue a command. ``reply`` is called with its answer."""
        self._posted.append((command, reply))

    def carry_out(self) -> None:
        """One control period: what takes longer goes on, then what was posted since the last period."""
        waiting, self._waiting = self._waiting, []
        for frames, command, reply in waiting:
            self._continue(frames, command, reply)
        for _ in range(len(self._posted)):
            command, reply = self._posted.popleft()
            try:
                answer = command.apply(self._controller)
            except Exception as error:
                self._failed(command, reply, error)
                continue
            if isinstance(answer, Generator):
                self._continue(answer, command, reply)
            else:
                self._answer(reply, answer)

    def _continue(self, frames: _Waiting, command: "Command", reply: Reply | None) -> None:
        try:
            next(frames)
        except StopIteration as done:
            self._answer(reply, done.value)
        except Exception as error:
            self._failed(command, reply, error)
        else:
            self._waiting.append((frames, command, reply))

    def _failed(self, command: "Command", reply: Reply | None, error: Exception) -> None:
        """A command must never end the tick, nor fill the log: clients repeat what fails."""
        if self._novelty.of(error):
            shown = f"{command!r:.200}"
            _logger.error("carrying out %s failed", shown, exc_info=error)
            self._controller.messages.note(f"carrying out {shown} failed: {type(error).__name__}: {error}")
        self._answer(reply, command.failure)

    def _answer(self, reply: Reply | None, answer: Any) -> None:
        if reply is None:
            return
        try:
            reply(answer)
        except Exception as error:
            if self._novelty.of(error, reply):
                _logger.error("who asked could not take the answer", exc_info=error)


def deliver(callback: Callable[[Any], None], value: Any) -> None:
    """Call a listener back; its failure is logged and harms nothing here."""
    try:
        callback(value)
    except Exception:
        _logger.exception("a listener of the controller failed")
