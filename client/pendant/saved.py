"""Files in which the pendant saves data of its users as JSON, shared by all browsers: TCPs, poses, edited programs."""

import base64
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from client.errors import FileError
from urproto.durable import write_file
from urproto.robots import Joints
from urproto.robots.pose import Pose
from urproto.text import json_document
from urproto.vectors import as_six, is_number

_QUARTER_TURN: Final = 1.5707963267948966
BUILT_IN: Final[Mapping[str, Joints]] = {
    "Home": (0.0, -_QUARTER_TURN, 0.0, -_QUARTER_TURN, 0.0, 0.0),
    "Zero": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
}
"""PolyScope's home position, and every joint at zero. They cannot be changed."""

_T = TypeVar("_T")
_MAX_NAME_LENGTH: Final = 60
_INVALID_CHARACTERS: Final = re.compile(r"[^A-Za-z0-9.-]")  # in names of files


class JsonFile(Generic[_T]):
    """Named data in a JSON file; without a path, in memory only.

    The file is read on first use, and each change writes it completely or not at all. parse: converts the content of
    the file; its ValueError, like all errors of the file, becomes a FileError. version: number of changes.
    """

    def __init__(self, path: Path | None, parse: Callable[[Any], dict[str, _T]], label: str) -> None:
        self._path = path
        self._parse = parse
        self._label = label
        self._content: dict[str, _T] | None = None
        self.version = 0

    @property
    def content(self) -> Mapping[str, _T]:
        """The content of the file. Raises FileError."""
        if self._content is None:
            self._content = {} if self._path is None else self._load(self._path)
        return self._content

    @property
    def loaded(self) -> Mapping[str, _T]:
        """Like ``content``, but empty before that was first read."""
        return self._content or {}

    def change(self, content: dict[str, _T]) -> None:
        """Replace the content. Raises FileError; then nothing has changed."""
        if self._path is not None:
            _write_json(self._path, content)
        self._content = content
        self.version += 1

    def _load(self, path: Path) -> dict[str, _T]:
        def unusable(error: Exception) -> str:
            return f"the file does not contain {self._label}: {error}; move it out of the way"

        return _read_json(path, self._parse, unusable) or {}


class Tools(JsonFile[Pose]):
    """TCPs in a JSON file ``{"gripper": [x, y, z, rx, ry, rz]}`` [m, rad]; without a file, in memory only.

    Raises FileError if the file cannot be read or written, and ValueError for an invalid TCP.
    """

    def __init__(self, path: Path | None) -> None:
        super().__init__(path, _parse_tools, "TCPs")

    def save(self, name: str, tcp: Sequence[float]) -> None:
        """Save a TCP; another one with this name is replaced."""
        tools = {**self.content, checked_name(name, "a TCP"): _checked_tcp(tcp)}
        self.change(dict(sorted(tools.items())))

    def delete(self, name: str) -> None:
        self.change({other: tcp for other, tcp in self.content.items() if other != name})


def _checked_tcp(values: Any) -> Pose:
    return _six(values, "a TCP is six numbers, x, y, z [m], rx, ry, rz [rad]")


def _parse_tools(content: Any) -> dict[str, Pose]:
    return {str(name): _checked_tcp(tcp) for name, tcp in content.items()}


class Poses(JsonFile[dict[str, Joints]]):
    """Poses in a JSON file ``{"ur5e": {"above the box": [six angles in rad]}}``; without a file, in memory only.

    Raises FileError if the file cannot be read or written, and ValueError for an invalid name.
    """

    def __init__(self, path: Path | None) -> None:
        super().__init__(path, _parse_poses, "poses")

    def for_model(self, model: str) -> dict[str, Joints]:
        """The saved poses of a model by name, sorted."""
        return dict(sorted(self.content.get(model, {}).items()))

    def save(self, model: str, name: str, q_rad: Sequence[float]) -> None:
        """Save a pose; another one with this name is replaced."""
        self._replace(model, self.for_model(model) | {_checked_pose_name(name): _joint_angles(q_rad)})

    def delete(self, model: str, name: str) -> None:
        self._replace(model, {other: q for other, q in self.for_model(model).items() if other != name})

    def rename(self, model: str, old: str, new: str) -> None:
        """Rename a pose. Raises ValueError if another one has the new name."""
        poses, new = self.for_model(model), _checked_pose_name(new)
        if old not in poses:
            raise ValueError(f"the pose {old!r} no longer exists")
        if new != old and new in poses:
            raise ValueError(f"a pose called {new!r} already exists: delete it first or choose another name")
        self._replace(model, {new if name == old else name: q for name, q in poses.items()})

    def _replace(self, model: str, poses: dict[str, Joints]) -> None:
        self.change({**self.content, model: poses})


def _checked_pose_name(name: str) -> str:
    name = checked_name(name, "a pose")
    if name in BUILT_IN:
        raise ValueError(f"{name} is a predefined pose: choose another name")
    return name


def _joint_angles(values: Any) -> Joints:
    return _six(values, "a pose is six joint angles [rad]")


def _parse_poses(content: Any) -> dict[str, dict[str, Joints]]:
    return {model: {name: _joint_angles(q) for name, q in poses.items()} for model, poses in content.items()}


def _six(values: Any, required: str) -> Joints:
    """Six numbers. Raises ValueError, which says what is required, for anything else."""
    if not isinstance(values, Sequence) or len(values) != 6 or not all(map(is_number, values)):
        raise ValueError(f"{required}, not {values!r}")
    return as_six(values)


def checked_name(name: str, subject: str) -> str:
    """Normalise the spaces of a name. Raises ValueError if it is empty or too long."""
    name = " ".join(name.split())
    if not 0 < len(name) <= _MAX_NAME_LENGTH:
        raise ValueError(f"the name of {subject} has 1 to {_MAX_NAME_LENGTH} characters")
    return name


def _read_json(path: Path, parse: Callable[[Any], _T], unusable: Callable[[Exception], str]) -> _T | None:
    """The parsed content of a file, None if it does not exist. Raises FileError, with the text of ``unusable``."""
    try:
        return parse(json_document(path.read_text("utf-8")))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise FileError(path, unusable(error)) from error  # also for huge numbers, deep nesting


def _write_json(path: Path, content: Any) -> None:
    """Replace a file atomically. Raises FileError."""
    with FileError.accessing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, json.dumps(content, indent=1) + "\n")


@dataclass(frozen=True, slots=True)
class SavedDraft:
    """A saved draft. data: the bytes of its ``.urp`` file in the present state.

    path: in the robot's programs folder, "" if it was never saved there. changed: since it was saved there.
    """

    path: str
    changed: bool
    data: bytes


def _parse_draft(content: Any) -> SavedDraft:
    return SavedDraft(str(content["path"]), bool(content["changed"]), base64.b64decode(content["urp"], None, True))


class ProgramFile:
    """Files in a folder, one for each robot address; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, address: str) -> None:
        self.path = None if folder is None else folder / f"{_INVALID_CHARACTERS.sub('_', address)}.json"

    def read(self) -> SavedDraft | None:
        """The saved draft, None without one. Raises FileError for an unusable file, which is moved aside."""

        def unusable(error: Exception) -> str:
            return f"not a program draft of a pendant: {error}; {self.move_aside()}"

        return None if self.path is None else _read_json(self.path, _parse_draft, unusable)

    def move_aside(self) -> str:
        """Rename an unusable file, so that it is not overwritten; returns a text that says where it is."""
        if self.path is None:
            return "nothing is saved"
        new_path = self.path.with_suffix(".unreadable")
        try:
            os.replace(self.path, new_path)
        except OSError as error:
            return f"it could not be renamed: {error.strerror or error}"
        return f"it was renamed to {new_path}"

    def write(self, draft: SavedDraft) -> None:
        """Replace the saved draft, completely or not at all. Raises FileError."""
        if self.path is not None:
            urp = base64.b64encode(draft.data).decode()
            _write_json(self.path, {"path": draft.path, "changed": draft.changed, "urp": urp})
