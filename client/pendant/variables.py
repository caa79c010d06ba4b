"""The global variables of the running program, from the primary interface."""

from typing import Any, Final

from urproto.primary.program_state import GlobalVariableNames, GlobalVariableValues, MatrixValue, PoseValue, Value

_MAX_SHOWN: Final = 1000
_MAX_TEXT_LENGTH: Final = 400  # characters of a value on the screen
_KINDS: Final[dict[type, str]] = {
    type(None): "",
    bool: "bool",
    int: "int",
    float: "float",
    str: "string",
    PoseValue: "pose",
    tuple: "list",
    MatrixValue: "matrix",
}


class Variables:
    """All variables. names: in the order of the program. values: by name.

    revision: counts the messages that were applied. program: counts those with new names.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self.revision = 0
        self.program = 0
        self._values: list[Any] = []

    @property
    def values(self) -> dict[str, Any]:
        return dict(zip(self.names, self._values, strict=False))

    def handle_message(self, message: object) -> None:
        """Process names, which arrive when a program starts, and values."""
        if isinstance(message, GlobalVariableNames):
            self._rename(message.start_index, message.names)
        elif isinstance(message, GlobalVariableValues):
            start, values = message.start_index, message.values
            if not values and not start and self.names:  # the only message for a program without variables
                self._rename(0, ())
            elif start <= len(self._values):
                self._values[start : start + len(values)] = values
                self.revision += 1

    def _rename(self, start: int, names: tuple[str, ...]) -> None:
        self.names[start:] = names
        del self._values[start:]
        self.revision += 1
        self.program += 1

    def clear(self) -> None:
        if self.names:
            self._rename(0, ())

    def rows(self) -> list[tuple[str, str]]:
        """Type and text of each received value, in the order of the names."""
        return [(type_name(value), format_value(value)) for value in self._values[:_MAX_SHOWN]]


class VariablesView:
    """The variables that one browser shows: only changes are sent."""

    def __init__(self, variables: Variables) -> None:
        self._variables = variables
        self._program = -1
        self._revision = -1
        self._rows: list[tuple[str, str]] = []

    def next_update(self, fresh: bool) -> list[Any] | None:
        """[names of a new program or None, {index: [type, text]}] since the last call, None if nothing has changed.

        fresh: the browser has nothing yet.
        """
        variables = self._variables
        if not fresh and self._revision == variables.revision:
            return None
        complete = fresh or self._program != variables.program
        before = [] if complete else self._rows
        self._program, self._revision, self._rows = variables.program, variables.revision, variables.rows()
        known_count = len(before)
        changed = {i: row for i, row in enumerate(self._rows) if i >= known_count or row != before[i]}
        if complete:
            return [variables.names[:_MAX_SHOWN], changed]
        return [None, changed] if changed else None


def type_name(value: Value) -> str:
    return _KINDS[type(value)]


def format_value(value: Value) -> str:
    """A value as text in the notation of scripts; poses in m and rad, as in scripts."""
    text = _text(value)
    return text if len(text) <= _MAX_TEXT_LENGTH else f"{text[: _MAX_TEXT_LENGTH - 1]}…"


def _text(value: Value) -> str:
    match value:
        case None:
            return "-"
        case bool() | int():
            return str(value)
        case float():
            return f"{value:.6g}"
        case str():
            return f'"{value}"'
        case PoseValue():
            return f"p[{', '.join(f'{number:.4f}' for number in value.values)}]"
        case tuple():
            return f"[{', '.join(map(_text, value))}]"
        case MatrixValue():
            return f"[{', '.join(_text(row) for row in value.rows)}]"
