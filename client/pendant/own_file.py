"""Files of a pendant's own: what people have saved, as JSON, written whole or not at all."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from client.errors import FileError

__all__ = ["read", "write"]

_T = TypeVar("_T")


def read(path: Path, parse: Callable[[Any], _T], what: str) -> _T | None:
    """What ``parse`` makes of the content; None without a file. Raises FileError, also for parse's ValueError."""
    try:
        return parse(json.loads(path.read_text("utf-8")))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
    except (ValueError, AttributeError) as error:  # UnicodeError and JSONDecodeError are ValueErrors
        raise FileError(path, f"these are no {what}: {error}; move the file away") from error


def write(path: Path, content: Any) -> None:
    """A new file takes the place of the old one. Raises FileError."""
    new = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        os.replace(new, path)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
