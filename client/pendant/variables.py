"""The global variables of the running program, as the primary interface tells them."""

from typing import Any

from urproto.primary.program_state import GlobalVariableNames, GlobalVariableValues

__all__ = ["Variables"]


class Variables:
    """values: by name, in the order of the program."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._values: list[Any] = []

    @property
    def values(self) -> dict[str, Any]:
        """Those whose value has come."""
        return dict(zip(self._names, self._values, strict=False))

    def hear(self, message: object) -> None:
        """Take note of names, which come when a program starts, and of values."""
        if isinstance(message, GlobalVariableNames):
            self._names[message.start_index :] = message.names
            del self._values[message.start_index :]
        elif isinstance(message, GlobalVariableValues) and message.start_index <= len(self._values):
            self._values[message.start_index : message.start_index + len(message.values)] = message.values
