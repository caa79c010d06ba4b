"""Tool centre points somebody has saved: poses in the flange frame by name, in a file that all browsers share."""

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from client.pendant.own_file import OwnFile, checked_name
from urproto.robots.pose import Pose

__all__ = ["Tools"]


class Tools:
    """Those in a JSON file ``{"gripper": [x, y, z, rx, ry, rz]}`` [m, rad], or without one in memory only.

    Raises FileError when the file cannot be read or written, and ValueError for what is no TCP.
    """

    def __init__(self, path: Path | None) -> None:
        self._saved = OwnFile(path, _parsed, "TCPs")

    @property
    def version(self) -> int:
        """Counts the changes."""
        return self._saved.version

    @property
    def all(self) -> Mapping[str, Pose]:
        """By name, in the order of the names."""
        return self._saved.content

    @property
    def known(self) -> Mapping[str, Pose]:
        """As ``all``, or nothing before somebody has asked for that."""
        return self._saved.known

    def save(self, name: str, tcp: Sequence[float]) -> None:
        """Under a name; another TCP of this name is replaced."""
        self._change({**self.all, checked_name(name, "a TCP"): _checked(tcp)})

    def delete(self, name: str) -> None:
        """One that is not there is gone already."""
        self._change({known: tcp for known, tcp in self.all.items() if known != name})

    def _change(self, tools: Mapping[str, Pose]) -> None:
        self._saved.change(dict(sorted(tools.items())))


def _checked(values: Any) -> Pose:
    numbers = isinstance(values, Sequence) and all(isinstance(value, int | float) for value in values)
    if not numbers or len(values) != 6 or not all(map(isfinite, values)):
        raise ValueError(f"a TCP is six numbers, x, y, z [m], rx, ry, rz [rad], not {values!r}")
    x, y, z, rx, ry, rz = map(float, values)
    return (x, y, z, rx, ry, rz)


def _parsed(content: Any) -> dict[str, Pose]:
    return {str(name): _checked(tcp) for name, tcp in content.items()}
