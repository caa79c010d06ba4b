"""What a script sent to a peer, and what it was expected to send."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

_SHOWN: Final = 12  # of the messages sent, in the report of one that was expected


class PeersError(ValueError):
    """A description of peers is invalid."""


@dataclass(frozen=True)
class Pattern:
    """A pattern of messages: text in which ``*`` and ``?`` are wildcards, or a regular expression between slashes."""

    text: str
    expression: re.Pattern[str]

    @classmethod
    def parse(cls, text: str) -> "Pattern":
        """Raises PeersError for an invalid regular expression."""
        if len(text) > 1 and text.startswith("/") and text.endswith("/"):
            try:
                return cls(text, re.compile(text[1:-1], re.DOTALL))
            except re.error as error:
                raise PeersError(f"{text} is not a regular expression: {error}") from error
        wild = re.escape(text).replace(r"\*", ".*").replace(r"\?", ".")
        return cls(text, re.compile(wild, re.DOTALL))

    def match(self, message: str) -> re.Match[str] | None:
        return self.expression.fullmatch(message)


@dataclass
class PeerLog:
    """The messages that a script sent to one peer: robot time [s] and text. now: the robot time."""

    name: str
    expected: Sequence[Pattern] = ()
    sent: list[tuple[float, str]] = field(default_factory=list)
    now: Callable[[], float] = lambda: 0.0

    def add(self, text: str) -> None:
        self.sent.append((self.now(), text))

    def contains(self, pattern: Pattern) -> bool:
        return any(pattern.match(text) for _, text in self.sent)

    def unmet(self) -> str:
        """The first expected message that was not sent after those before it, with what was sent; empty if none."""
        messages = iter(self.sent)
        for pattern in self.expected:
            if not any(pattern.match(text) for _, text in messages):
                return f"{self.name} was not sent {pattern.text!r}{self.summary()}"
        return ""

    def summary(self) -> str:
        """What was sent, for a report: the last messages."""
        texts = [repr(text) for _, text in self.sent[-_SHOWN:]]
        omitted = "..., " if len(self.sent) > _SHOWN else ""
        return f"; it was sent {omitted}{', '.join(texts)}" if texts else "; it was sent nothing"
