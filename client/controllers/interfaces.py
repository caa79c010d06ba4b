"""Numbers with names: what a robot's hardware reports, and what it is commanded."""

import math
from collections.abc import Iterable, Sequence
from typing import Final, Self

__all__ = ["NO_COMMAND", "Interfaces", "UnknownInterfaceError"]

NO_COMMAND: Final = math.nan
"""On a command interface: nothing to do."""


class UnknownInterfaceError(LookupError):
    """``names`` are not among the interfaces."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        super().__init__(f"there is no interface {', '.join(self.names)}")


class Interfaces:
    """State or command interfaces, named as in ros2_control ("elbow_joint/position"); each is NaN until it is set.

    `lend` gives a part of them, in any order: whoever has it reads and writes the same numbers.
    """

    __slots__ = ("_places", "_store", "names")

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        self._places = {name: place for place, name in enumerate(self.names)}
        self._store = [NO_COMMAND] * len(self.names)

    def lend(self, names: Sequence[str]) -> Self:
        """The interfaces with these names, in this order. Raises UnknownInterfaceError."""
        if unknown := [name for name in names if name not in self._places]:
            raise UnknownInterfaceError(unknown)
        part = object.__new__(type(self))
        part.names = tuple(names)
        part._places = {name: self._places[name] for name in part.names}
        part._store = self._store
        return part

    def get(self) -> list[float]:
        """All values, in the order of the names."""
        store = self._store
        return [store[place] for place in self._places.values()]

    def put(self, values: Sequence[float]) -> None:
        """Set all values, in the order of the names."""
        for place, value in zip(self._places.values(), values, strict=True):
            self._store[place] = value

    def fill(self, value: float) -> None:
        """Set all values to one."""
        for place in self._places.values():
            self._store[place] = value

    def take(self) -> list[float] | None:
        """All values, which are NaN from then on; None while any of them is NaN."""
        values = self.get()
        if any(value != value for value in values):
            return None
        self.fill(NO_COMMAND)
        return values

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> float:
        return self._store[self._places[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self._store[self._places[name]] = value
