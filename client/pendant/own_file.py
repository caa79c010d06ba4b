"""Files of a pendant's own: what people have saved under names, as JSON, shared by all browsers."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from client.errors import FileError

__all__ = ["OwnFile", "checked_name"]

_T = TypeVar("_T")
_LONGEST_NAME: Final = 60


class OwnFile(Generic[_T]):
    """What has been saved, by name, in a file of JSON, or without a path in memory only.

    Read when asked for the first time, written whole or not at all at every change. parse: makes it of the file's
    content; its ValueError, as all that goes wrong with the file, is a FileError. version: counts the changes.
    """

    def __init__(self, path: Path | None, parse: Callable[[Any], dict[str, _T]], what: str) -> None:
        self._path = path
        self._parse = parse
        self._what = what
        self._read: dict[str, _T] | None = None
        self.version = 0

    @property
    def content(self) -> Mapping[str, _T]:
        """All of it. Raises FileError."""
        if self._read is None:
            self._read = {} if self._path is None else self._load(self._path)
        return self._read

    @property
    def known(self) -> Mapping[str, _T]:
        """As ``content``, or nothing before somebody has asked for that."""
        return self._read or {}

    def change(self, content: dict[str, _T]) -> None:
        """Have this instead. Raises FileError; then nothing has changed."""
        if self._path is not None:
            _write(self._path, content)
        self._read = content
        self.version += 1

    def _load(self, path: Path) -> dict[str, _T]:
        try:
            return self._parse(json.loads(path.read_text("utf-8")))
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise FileError(path, error.strerror or str(error)) from error
        except (ValueError, AttributeError) as error:  # UnicodeError and JSONDecodeError are ValueErrors
            raise FileError(path, f"these are no {self._what}: {error}; move the file away") from error


def checked_name(name: str, of: str) -> str:
    """Without needless spaces. Raises ValueError for one that is empty or too long."""
    name = " ".join(name.split())
    if not 0 < len(name) <= _LONGEST_NAME:
        raise ValueError(f"the name of {of} has 1 to {_LONGEST_NAME} characters")
    return name


def _write(path: Path, content: Any) -> None:
    """A new file takes the place of the old one. Raises FileError."""
    new = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        os.replace(new, path)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
