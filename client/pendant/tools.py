"""Tool centre points somebody has saved: poses in the flange frame by name, in a file that all browsers share."""

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Final

from client.pendant import own_file
from urproto.robots.pose import Pose

__all__ = ["Tools"]

_LONGEST_NAME: Final = 60


class Tools:
    """Those in a JSON file ``{"gripper": [x, y, z, rx, ry, rz]}`` [m, rad], or without one in memory only.

    Read when asked for the first time, written whole at every change. Raises FileError when that does not work, and
    ValueError for what is no TCP. version: counts the changes.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._read: dict[str, Pose] | None = None
        self.version = 0

    @property
    def all(self) -> Mapping[str, Pose]:
        """By name, in the order of the names."""
        if self._read is None:
            self._read = {} if self._path is None else own_file.read(self._path, _parsed, "TCPs") or {}
        return self._read

    @property
    def known(self) -> Mapping[str, Pose]:
        """As ``all``, or nothing before somebody has asked for that."""
        return self._read or {}

    def save(self, name: str, tcp: Sequence[float]) -> None:
        """Under a name; another TCP of this name is replaced."""
        name = " ".join(name.split())
        if not 0 < len(name) <= _LONGEST_NAME:
            raise ValueError(f"the name of a TCP has 1 to {_LONGEST_NAME} characters")
        self._change({**self.all, name: _checked(tcp)})

    def delete(self, name: str) -> None:
        """One that is not there is gone already."""
        self._change({known: tcp for known, tcp in self.all.items() if known != name})

    def _change(self, tools: Mapping[str, Pose]) -> None:
        changed = dict(sorted(tools.items()))
        if self._path is not None:
            own_file.write(self._path, changed)
        self._read = changed
        self.version += 1


def _checked(values: Any) -> Pose:
    numbers = isinstance(values, Sequence) and all(isinstance(value, int | float) for value in values)
    if not numbers or len(values) != 6 or not all(map(isfinite, values)):
        raise ValueError(f"a TCP is six numbers, x, y, z [m], rx, ry, rz [rad], not {values!r}")
    x, y, z, rx, ry, rz = map(float, values)
    return (x, y, z, rx, ry, rz)


def _parsed(content: Any) -> dict[str, Pose]:
    return {str(name): _checked(tcp) for name, tcp in content.items()}
