"""Queue of commands posted to a controller: each waits for the next tick and is applied there, in order.

Commands from the ports are paid for from the budget of the period (`emulator.workshare`), in the order in which they
arrived. A command's ``apply`` returns its answer immediately, or is a generator that yields once for
every control period it waits and returns the answer. ``failure`` is the answer if applying
it raised an exception.
"""

import logging
from collections import deque
from collections.abc import Callable, Generator
from typing import Any, ClassVar

from emulator.logs import ReportedErrors
from emulator.machine import Machine

Reply = Callable[[Any], None]
_Waiting = Generator[None, None, Any]

_logger = logging.getLogger(__name__)


class Command:
    """Base of everything that can be posted to the controller.

    price: its cost [units of `urscript.work`], which is paid before it is applied; it waits for a period that can
    afford it. The commands of control loops and of this process cost nothing, and never wait.
    """

    price: ClassVar[int] = 0

    def apply(self, controller: Any) -> Any:
        """Apply the command to an `emulator.controller.Controller`; returns the answer, or a generator that does."""
        raise NotImplementedError

    @property
    def failure(self) -> Any:
        """The answer if ``apply`` raised an exception."""
        return None


class Mailbox:
    """Posted commands that are not answered yet."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._posted: deque[tuple[Command, Reply | None]] = deque()
        self._waiting: list[tuple[_Waiting, Command, Reply | None]] = []
        self._reported = ReportedErrors()

    def __len__(self) -> int:
        return len(self._posted) + len(self._waiting)

    def post(self, command: Command, reply: Reply | None) -> None:
        """Queue a command. ``reply`` is called with its answer."""
        self._posted.append((command, reply))

    def carry_out(self) -> None:
        """Advance one control period: continue longer commands, then apply those posted since the last period."""
        if not (self._waiting or self._posted):
            return
        waiting, self._waiting = self._waiting, []
        for frames, command, reply in waiting:
            self._continue(frames, command, reply)
        deferred: list[tuple[Command, Reply | None]] = []
        for _ in range(len(self._posted)):
            command, reply = self._posted.popleft()
            if not self._machine.work.take(command.price):
                deferred.append((command, reply))
                continue
            try:
                answer = command.apply(self._machine)
            except Exception as error:
                self._failed(command, reply, error)
                continue
            if isinstance(answer, Generator):
                self._continue(answer, command, reply)
            else:
                self._answer(command, reply, answer)
        self._posted.extendleft(reversed(deferred))

    def _continue(self, frames: _Waiting, command: Command, reply: Reply | None) -> None:
        try:
            next(frames)
        except StopIteration as done:
            self._answer(command, reply, done.value)
        except Exception as error:
            self._failed(command, reply, error)
        else:
            self._waiting.append((frames, command, reply))

    def _failed(self, command: Command, reply: Reply | None, error: Exception) -> None:
        """Log the failure once: clients repeat failing commands, which must neither end the tick nor fill the log."""
        if self._reported.is_new(error):
            shown = f"{command!r:.200}"
            _logger.error("carrying out %s failed", shown, exc_info=error)
            self._machine.messages.note(f"carrying out {shown} failed: {type(error).__name__}: {error}")
        self._answer(command, reply, command.failure)

    def _answer(self, command: Command, reply: Reply | None, answer: Any) -> None:
        if isinstance(answer, str):
            self._machine.messages.trace("%.200r is answered with %.200r", command, answer)
        if reply is None:
            return
        try:
            reply(answer)
        except Exception as error:
            if self._reported.is_new(error, reply):
                _logger.error("the recipient of an answer failed", exc_info=error)


def deliver(callback: Callable[[Any], None], value: Any) -> None:
    """Call a listener; its failure is logged and has no other effect."""
    try:
        callback(value)
    except Exception:
        _logger.exception("a listener of the controller failed")
