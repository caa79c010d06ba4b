"""The project file: ``[tool.urscript]`` in ``pyproject.toml``, or ``urscript.toml``, in a file's folder or above it.

Paths and patterns in it are relative to its folder.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from fnmatch import fnmatch
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

from urproto.compat import Self, load_toml
from urproto.text import quoted, unknown
from urproto.versions import PolyscopeVersion
from urscript.check import names
from urscript.check.rules import RULES
from urscript.compiler import NOTHING, Known

_OWN_FILE: Final = "urscript.toml"
_SHARED_FILE: Final = "pyproject.toml"


class ProjectError(ValueError):
    """A project file cannot be used: one line with its path."""


@dataclass(frozen=True)
class Project:
    """The settings; their fields are the keys of the file."""

    path: Path | None = None
    """The file; None if there is none."""
    versions: tuple[str, ...] = ()
    """PolyScope versions to check for."""
    models: tuple[str, ...] = ()
    """Arms to check for: each with the usual version of its series, unless there are versions."""
    urcaps: tuple[str, ...] = ()
    """URCaps of the robot, such as "robotiq-grippers" or "robotiq-grippers 1.7"."""
    include: tuple[str, ...] = ()
    """Script files whose functions and variables exist in every program."""
    provides: tuple[str, ...] = ()
    """Further names that exist: "speed" is a variable, "grip(width, force=40)" a function."""
    preamble: str = ""
    """A script file that is sent in front of every program, and may leave its def open."""
    open: tuple[str, ...] = ()
    """Patterns of files whose def is left open at their end: what follows may define further names."""
    templates: tuple[str, ...] = ()
    """Patterns of files with placeholders, {x} or {{x}}."""
    select: tuple[str, ...] = ("URS",)
    """Codes of rules, or their beginnings; all by default."""
    ignore: tuple[str, ...] = ()
    """Codes of rules, or their beginnings, that are left out."""

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """The settings in a file; None if it has no section for them. Raises ProjectError."""
        try:
            table = load_toml(path.read_text(encoding="utf-8"))
            if path.name == _SHARED_FILE:
                table = table.get("tool", {}).get("urscript")
                if table is None:
                    return None
            return cls(path, **{key: _value(key, value) for key, value in table.items()})
        except (OSError, ValueError, AttributeError) as error:
            raise ProjectError(f"{path}: {getattr(error, 'strerror', None) or error}") from None

    def selects(self, code: str) -> bool:
        """Whether findings of a rule are reported."""
        return code.startswith(self.select) and not (self.ignore and code.startswith(self.ignore))

    def matches(self, patterns: tuple[str, ...], file: Path) -> bool:
        """Whether a file is one of those that some patterns describe."""
        try:
            shown = file.resolve().relative_to(self._folder).as_posix()
        except ValueError:  # not below the project file
            shown = file.name
        return any(fnmatch(shown, pattern) or fnmatch(file.name, pattern) for pattern in patterns)

    @cached_property
    def sources(self) -> dict[str, Known]:
        """What each URCap and each included file brings. Raises ProjectError."""
        return dict([*self._read_all("urcaps", names.urcap), *self._read_all("include", self._defined_in)])

    @cached_property
    def known(self) -> Known:
        """The names that exist in every program. Raises ProjectError."""
        provided = [known for _, known in self._read_all("provides", lambda text: names.declared([text]))]
        return names.joined([*self.sources.values(), *provided]) if self.sources or provided else NOTHING

    @cached_property
    def preamble_text(self) -> bytes:
        """What is sent in front of every program. Raises ProjectError."""
        try:
            return (self._folder / self.preamble).read_bytes().rstrip(b"\n") + b"\n" if self.preamble else b""
        except OSError as error:
            raise ProjectError(f"{self.path}: preamble: {self.preamble}: {error.strerror}") from None

    @property
    def _folder(self) -> Path:
        return (self.path.parent if self.path else Path()).resolve()

    def _defined_in(self, pattern: str) -> Known:
        found = sorted(self._folder.glob(pattern))
        if not found:
            raise ValueError(f"no file {quoted(pattern)} below {self._folder}")
        return names.joined(map(names.defined_in, found))

    def _read_all(self, key: str, read: Callable[[str], Known]) -> Iterator[tuple[str, Known]]:
        for text in getattr(self, key):
            try:
                yield text, read(text)
            except (OSError, ValueError, NotImplementedError) as error:
                raise ProjectError(f"{self.path}: {key}: {getattr(error, 'strerror', None) or error}") from None


def _value(key: str, value: Any) -> Any:
    """A checked value. Raises ValueError."""
    keys = [field.name for field in fields(Project) if field.name != "path"]
    if key not in keys:
        raise ValueError(unknown("key", key, keys))
    if key == "preamble":
        if not isinstance(value, str):
            raise ValueError(f"{key} must be a text, not {quoted(value)}")
        return value
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError(f'{key} must be a list of texts such as ["..."], not {quoted(value)}')
    for item in value:
        if key == "versions":
            PolyscopeVersion.parse(item)
        elif key in ("select", "ignore") and not any(code.startswith(item) for code in RULES):
            raise ValueError(f"{key}: {unknown('rule', item, RULES)}")
    return tuple(value)


@cache
def project_of(folder: Path) -> Project:
    """The project file of a folder: the nearest one, in the folder or above. Raises ProjectError."""
    for place in (folder, *folder.parents):
        for name in (_OWN_FILE, _SHARED_FILE):
            path = place / name
            if path.is_file() and (project := Project.read(path)) is not None:
                return project
    return Project()
