"""Poses somebody has saved: joint angles by name, for each model of arm, in a file that all browsers share."""

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Final

from client.pendant.own_file import OwnFile, checked_name
from urproto.robots import Joints

__all__ = ["BUILT_IN", "Poses"]

_HALF: Final = 1.5707963267948966
BUILT_IN: Final[Mapping[str, Joints]] = {
    "Home": (0.0, -_HALF, 0.0, -_HALF, 0.0, 0.0),
    "Zero": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
}
"""PolyScope's home position, and every joint at zero. They cannot be changed."""


class Poses:
    """Those in a JSON file ``{"ur5e": {"above the box": [six angles in rad]}}``, or without one in memory only.

    Raises FileError when the file cannot be read or written, and ValueError for names that cannot be.
    """

    def __init__(self, path: Path | None) -> None:
        self._saved = OwnFile(path, _parsed, "poses")

    @property
    def version(self) -> int:
        """Counts the changes."""
        return self._saved.version

    def of(self, model: str) -> dict[str, Joints]:
        """The saved ones by name, in the order of the names."""
        return dict(sorted(self._saved.content.get(model, {}).items()))

    def save(self, model: str, name: str, q_rad: Sequence[float]) -> None:
        """Under a name; another pose of this name is replaced."""
        self._change(model, self.of(model) | {_checked(name): _six(q_rad)})

    def delete(self, model: str, name: str) -> None:
        """One that is not there is gone already."""
        poses = self.of(model)
        poses.pop(name, None)
        self._change(model, poses)

    def rename(self, model: str, old: str, new: str) -> None:
        """Raises ValueError when there is another pose of the new name."""
        poses, new = self.of(model), _checked(new)
        if old not in poses:
            raise ValueError(f"there is no pose {old!r} any more")
        if new != old and new in poses:
            raise ValueError(f"there is a pose {new!r} already: delete it first, or take another name")
        self._change(model, {new if name == old else name: q for name, q in poses.items()})

    def _change(self, model: str, poses: dict[str, Joints]) -> None:
        self._saved.change({**self._saved.content, model: poses})


def _checked(name: str) -> str:
    name = checked_name(name, "a pose")
    if name in BUILT_IN:
        raise ValueError(f"{name} is a pose that every arm has: take another name")
    return name


def _six(values: Any) -> Joints:
    if not isinstance(values, Sequence) or len(values) != 6 or not all(map(_is_angle, values)):
        raise ValueError(f"a pose is six joint angles [rad], not {values!r}")
    a, b, c, d, e, f = map(float, values)
    return (a, b, c, d, e, f)


def _is_angle(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _parsed(content: Any) -> dict[str, dict[str, Joints]]:
    return {model: {name: _six(q) for name, q in poses.items()} for model, poses in content.items()}
