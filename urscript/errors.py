"""Errors and warnings of scripts.

    ScriptError                 has line, column, message, source; ``render()`` draws the caret
    ├── CompileError            the program was refused before it started; ``wire`` is the controller's text
    ├── ScriptWarning           the program can start, but will fail or misbehave if it reaches this position
    └── ScriptRuntimeError      the program stopped while it ran
    RuntimeFault                raised by a built-in; becomes a ScriptRuntimeError at the caller's position

Lines and columns count from 1. Line 1 is the first line with code (the ``def`` line), as on a controller.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from urproto.compat import Self


@lru_cache(maxsize=2)  # texts with thousands of errors exist, and each shows its line
def _lines(source: str) -> list[str]:
    return source.split("\n")


class RuntimeFault(Exception):  # noqa: N818  # it becomes an error only at a position in a script
    """A built-in refuses its arguments or cannot continue. The runtime adds line and column."""


class ScriptError(Exception):
    """An error at a position in a script."""

    _rank: ClassVar = ""

    def __init__(self, message: str, line: int, column: int, source: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.line = line
        self.column = column
        self.source = source

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.message}"

    @property
    def source_line(self) -> str:
        """The text of the line with the error, without its line end; empty when unknown."""
        lines = _lines(self.source)
        return lines[self.line - 1].rstrip("\r") if 0 < self.line <= len(lines) else ""

    def render(self, file: str = "<script>") -> str:
        """Format position, message, source line and a caret below the column, as several lines of text."""
        text = self.source_line
        indent = "".join("\t" if char == "\t" else " " for char in text[: self.column - 1])
        number = str(self.line)
        return "\n".join(
            [
                f"{file}:{self.line}:{self.column}: {self._rank}{self.message}",
                f"  {number} | {text}",
                f"  {' ' * len(number)} | {indent}^",
            ]
        )


@dataclass(frozen=True, slots=True)
class Cause:
    """A mistake that the parser noticed only later in the text: where it was made, and its description.

    opened: the line of the block that lacks its end, if it is about one.
    """

    line: int
    column: int
    text: str
    opened: int = 0


class CompileError(ScriptError):
    """The program was not started.

    ``wire`` is the text that a controller puts into its runtime exception message, as seen on real controllers:
    ``syntax_error_on_line:3:end:`` and ``compile_error_name_not_found:foo:``. Line and column are where a controller
    notices the mistake; ``cause`` is where it was made, if that is a different position.
    """

    def __init__(
        self, message: str, line: int, column: int, source: str, wire: str, cause: Cause | None = None
    ) -> None:
        super().__init__(message, line, column, source)
        self.wire = wire
        self.cause = cause

    @property
    def unknown_name(self) -> bool:
        """Whether a name is not defined."""
        return self.wire.startswith("compile_error_name_not_found")

    @property
    def missing_name(self) -> str:
        """The name that is not defined; empty for other errors."""
        return self.wire.split(":")[1] if self.unknown_name else ""

    def at_its_cause(self) -> "CompileError":
        """The same error at the position where the mistake was made."""
        cause = self.cause
        if cause is None:
            return self
        return CompileError(f"syntax error: {cause.text}", cause.line, cause.column, self.source, self.wire)

    @property
    def is_open(self) -> bool:
        """Whether the text lacks the ``end`` of its def, such as a preamble."""
        return self.message.startswith("syntax error at end of text: expected 'end' to close the program") and (
            self.cause is None or self.cause.opened == 1
        )

    @classmethod
    def syntax(cls, message: str, line: int, column: int, source: str, cause: Cause | None = None) -> Self:
        """An error for text that does not parse; the wire text quotes the line where parsing failed."""
        error = cls(message, line, column, source, "", cause)
        error.wire = f"syntax_error_on_line:{line}:{error.source_line}:"
        return error

    @classmethod
    def name_not_found(cls, name: str, message: str, line: int, column: int, source: str) -> Self:
        """An error for a name that is neither a variable, a function of the program, nor a built-in of this version."""
        return cls(message, line, column, source, f"compile_error_name_not_found:{name}:")


class ScriptWarning(ScriptError):  # noqa: N818  # a warning, not an error
    """A problem that occurs if the program reaches this position. It does not prevent the program from starting.

    kind: of the mistake, such as "units".
    """

    _rank: ClassVar = "warning: "

    def __init__(self, message: str, line: int, column: int, source: str = "", kind: str = "") -> None:
        super().__init__(message, line, column, source)
        self.kind = kind


class ScriptRuntimeError(ScriptError):
    """The program stopped: a built-in refused, a type did not fit, an index was out of range."""

    def __init__(self, message: str, line: int, column: int, source: str = "", thread: str = "") -> None:
        super().__init__(message, line, column, source)
        self.thread = thread
