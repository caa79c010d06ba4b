"""Prepares scripts for sending, and collects the controller's messages about them while they run.

Every script is sent as a named program, because a controller reports that name, and errors by line.
"""

import itertools
import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

from client.errors import ScriptFailedError
from urproto.errors import LocalProtocolError
from urproto.modes import ReportLevel, SafetyMode, mode_name
from urproto.primary.framing import PrimaryMessage
from urproto.primary.messages import ErrorCodeMessage, RuntimeExceptionMessage, SafetyModeMessage, TextMessage
from urproto.primary.state import RobotStateData

MAY_RUN: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.RECOVERY)
FATAL_LEVELS: Final = (ReportLevel.VIOLATION, ReportLevel.FAULT, ReportLevel.CRITICAL_FAULT)
"""Error codes of these levels end a program."""

# Start of a program, after blank lines and comments.
_HEAD: Final = re.compile(r"\A(?:[ \t]*(?:#[^\n]*)?\r?\n)*[ \t]*(def|sec)\s+(\w+)\s*\(")
_NAME: Final = re.compile(r"[A-Za-z_]\w*\Z", re.ASCII)
_WIRE_LINE: Final = re.compile(r"(?<=syntax_error_on_line:)\d+")  # the controller names the line in such a text too

# The last line of a text, apart from comments, and statements that may end a program before it.
_LAST_END: Final = re.compile(r"^([ \t]*)end[ \t]*(?:#[^\n]*)?(?:\s*#[^\n]*)*\s*\Z", re.MULTILINE)
_DEFINITION: Final = re.compile(r"^([ \t]*)(?:def|sec)\b", re.MULTILINE)
_ENDS_EARLY: Final = re.compile(r"^[^#\n]*\b(?:halt|return)\b", re.MULTILINE)

_numbers = itertools.count(1)


@dataclass(frozen=True, slots=True)
class Script:
    """A program ready to be sent.

    shift: number of lines added before the caller's text. end_message: the text that it sends (textmsg) at its end;
    empty if it sends none.
    """

    name: str
    text: str
    shift: int = 0
    end_message: str = ""

    def line(self, reported: int) -> int:
        """The line in the caller's text for a line that a controller reports, both from 1."""
        return max(1, reported - self.shift)

    def message(self, reported: str) -> str:
        """A controller's text about an error, with the caller's line in it."""
        return _WIRE_LINE.sub(lambda match: str(self.line(int(match[0]))), reported)


def prepare(text: str, name: str | None = None) -> Script:
    """Prepare a script: a ``def`` program is unchanged, bare statements become one with this name or a new one.

    Raises LocalProtocolError for a ``sec`` program, about which controllers report nothing, and for an invalid name.
    """
    head = _HEAD.match(text)
    if head is None:
        return _wrapped(text, name or f"script_{next(_numbers)}")
    if head[1] == "sec":
        raise LocalProtocolError(
            f"cannot wait for the secondary program {head[2]}: controllers do not report its end; "
            "send it with send_script"
        )
    return Script(head[2], text)


def with_end_message(script: Script) -> Script:
    """Add a line to a program that shows that it has reached its end and was not stopped.

    The program is returned unchanged if that is not possible: if it may end early (halt, return), or if its last line
    is not clearly the end of the only program in the text.
    """
    end = _LAST_END.search(script.text)
    outer = [match[1] for match in _DEFINITION.finditer(script.text)]
    if end is None or _ENDS_EARLY.search(script.text) or outer.count(end[1]) != 1 or outer[0] != end[1]:
        return script
    words = f"{script.name} has come to its end"
    text = f'{script.text[: end.start()]}{end[1]}  textmsg("{words}")\n{script.text[end.start() :]}'
    return replace(script, text=text, end_message=words)


def is_secondary(text: str) -> bool:
    """Whether the text is a ``sec`` program."""
    head = _HEAD.match(text)
    return head is not None and head[1] == "sec"


def _wrapped(text: str, name: str) -> Script:
    if not _NAME.match(name):
        raise LocalProtocolError(f"{name!r} is not a program name: use letters, digits and _, not a digit first")
    return Script(name, f"def {name}():\n{text}\nend", shift=1)


@dataclass(frozen=True, slots=True)
class ScriptResult:
    """Result of a program that ran to its end or was stopped; controllers do not report which (`with_end_message`).

    texts: its textmsg() output. errors: error codes reported meanwhile, none of them fatal.
    """

    name: str
    texts: tuple[str, ...] = ()
    errors: tuple[ErrorCodeMessage, ...] = ()


class ScriptRun:
    """Collects the messages about a running program. failing: levels of error codes that count as its failure."""

    def __init__(self, script: Script, failing: Collection[ReportLevel] = FATAL_LEVELS) -> None:
        self.script = script
        self._failing = failing
        self._texts: list[str] = []
        self._errors: list[ErrorCodeMessage] = []
        self._stopped: SafetyMode | int | None = None
        self._states_since = 0
        self._reached_end = not script.end_message

    def watch(self, message: PrimaryMessage) -> None:
        """Process a message. Raises ScriptFailedError for one that ends the program."""
        if isinstance(message, TextMessage) and self.script.end_message and message.text == self.script.end_message:
            self._reached_end = True
        elif isinstance(message, TextMessage):
            self._texts.append(message.text)
        elif isinstance(message, RuntimeExceptionMessage):
            line = self.script.line(message.line)
            raise self.failed(self.script.message(message.text), line, message.column)
        elif isinstance(message, ErrorCodeMessage):
            self._errors.append(message)
            if message.level in self._failing:
                raise self.failed(f"{message.label} {message.text}")
        elif isinstance(message, SafetyModeMessage) and message.safety_mode not in MAY_RUN:
            self._stopped = message.safety_mode
        elif isinstance(message, RobotStateData):
            self._states_since += self._stopped is not None
        self._check_safety_stop()

    def _check_safety_stop(self) -> None:
        """Raise ScriptFailedError for a safety stop once its error code is known, which may come before or after it."""
        if self._stopped is not None and (self._errors or self._states_since > 1):
            codes = ", ".join(f"{error.label} {error.text}" for error in self._errors)
            raise self.failed(f"{mode_name(SafetyMode, self._stopped)} {codes}".rstrip())

    def failed(self, text: str, line: int = 0, column: int = 0) -> ScriptFailedError:
        return ScriptFailedError(line, column, text, self.script.name, tuple(self._errors))

    def result(self) -> ScriptResult:
        if not self._reached_end:
            raise self.failed("it was stopped before its end: by a user, or by another program that replaced it")
        return ScriptResult(self.script.name, tuple(self._texts), tuple(self._errors))
