"""The statements of interpreter mode on their way: received, interpreted, executed, cleared.

A received line waits for its answer until it is interpreted, that is compiled and linked into
the program; then it has an id and waits to be executed. Lines behind one that clears or ends
interpreter mode stay received until that one has been executed (Script Manual).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeAlias, TypeVar

from urproto.interpreter import LAST_ID, Reason, ack, discard

__all__ = ["MOST_STATEMENTS", "Answer", "Interpreted", "Received", "StatementQueue"]

MOST_STATEMENTS: Final = 1000
"""Lines interpreted since the last clear, and as many that wait. The vendor's helper clears after 500; a guess."""

CodeT = TypeVar("CodeT")
Answer: TypeAlias = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Received:
    """A line and whom to answer."""

    line: str
    answer: Answer


@dataclass(frozen=True, slots=True, eq=False)
class Interpreted(Generic[CodeT]):
    """A line that is part of the program."""

    id: int
    line: str
    code: CodeT
    holds: bool  # lines behind it wait until it has been executed


class StatementQueue(Generic[CodeT]):
    """The lines of one program. Ids are 0 where there is none yet."""

    def __init__(self) -> None:
        self.last_interpreted = 0
        self.last_executed = 0  # or being executed
        self.last_cleared = 0
        self.executing: Interpreted[CodeT] | None = None
        self.kept: list[Interpreted[CodeT]] = []  # part of the program, oldest first
        self._waiting: deque[Received] = deque()
        self._ready: deque[Interpreted[CodeT]] = deque()
        self._holder: Interpreted[CodeT] | None = None

    @property
    def unexecuted(self) -> int:
        """Lines that `skip` would skip."""
        return len(self._waiting) + len(self._ready)

    @property
    def full(self) -> bool:
        """True when no more lines should be interpreted before a clear."""
        return len(self.kept) >= MOST_STATEMENTS

    @property
    def next_received(self) -> Received | None:
        """The line to be interpreted next; None also while lines have to wait."""
        return self._waiting[0] if self._waiting and self._holder is None else None

    def receive(self, line: str, answer: Answer) -> None:
        """Take a line in; answered at once when too many wait."""
        if len(self._waiting) >= MOST_STATEMENTS:
            answer(discard(Reason.TOO_MANY, line))
        else:
            self._waiting.append(Received(line, answer))

    def accept(self, code: CodeT, *, holds: bool) -> None:
        """The next received line is interpreted."""
        received = self._waiting.popleft()
        self.last_interpreted = self.last_interpreted % LAST_ID + 1
        statement = Interpreted(self.last_interpreted, received.line, code, holds)
        self.kept.append(statement)
        self._ready.append(statement)
        if holds:
            self._holder = statement
        received.answer(ack(statement.id, received.line))

    def refuse(self, reason: Reason) -> None:
        """The next received line is not accepted."""
        received = self._waiting.popleft()
        received.answer(discard(reason, received.line))

    def start(self) -> Interpreted[CodeT] | None:
        """The statement to be executed now, if any."""
        if not self._ready:
            return None
        self.executing = self._ready.popleft()
        self.last_executed = self.executing.id
        return self.executing

    def finish(self) -> None:
        """The statement that was started is over."""
        if self.executing is not None and self.executing is self._holder:
            self._holder = None
        self.executing = None

    def skip(self) -> None:
        """Forget what is not being executed; what was interpreted stays part of the program."""
        self._ready.clear()
        if self._holder is not self.executing:
            self._holder = None
        self.discard_received(Reason.CLEANED_UP)

    def discard_received(self, reason: Reason) -> None:
        """Refuse all lines that are not interpreted."""
        while self._waiting:
            self.refuse(reason)

    def clear(self) -> list[Interpreted[CodeT]]:
        """Take what was interpreted, up to the statement being executed, out of the program; newest first."""
        number = self.kept.index(self.executing) + 1 if self.executing in self.kept else len(self.kept)
        cleared, self.kept = self.kept[:number], self.kept[number:]
        if cleared:
            self.last_cleared = cleared[-1].id
        return cleared[::-1]

    def end(self) -> None:
        """Interpreter mode is over: what is interpreted will not be executed any more."""
        self._ready.clear()
        self._holder = self.executing = None
