"""Finds test files and reads their settings: the files under test, and what surrounds the robot.

The settings of ``test_cell.script`` are in ``test_cell.yaml`` next to it: ``program`` (by default ``cell.script``),
``mocks``, ``fails``, ``logs``, ``peers`` and the options of ``urscript run``; those under ``tests`` apply to one test.
Without that file, a configuration of Hirebotics' urscript-tester is used as it is (``urtester.config.json`` in a parent
folder).
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from glob import glob
from pathlib import Path
from typing import Any, Final

from urproto.structures import InvalidYamlError, load_yaml
from urscript.scripttest.program import Source, TestProgram

_TEST_FILE: Final = re.compile(r"test_(\w+)\.script|(\w+)[_.]test\.script")
_RIVAL: Final = "urtester.config.json"
_OWN: Final = ("program", "mocks", "fails", "logs", "peers", "tests")
_EACH: Final = ("before", "after")


class SuiteError(ValueError):
    """Settings of a test file are invalid."""


@dataclass(frozen=True)
class Settings:
    """Settings of a test.

    where: their file, or that of the test; paths are relative to its folder. fails: a regular expression of the
    failure. logs: what it has to report. options: of ``urscript run``.
    """

    where: Path
    program: tuple[Path, ...] = ()
    mocks: tuple[Path, ...] = ()
    fails: str = ""
    logs: tuple[str, ...] = ()
    peers: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Test:
    """One test function of a file."""

    __test__ = False  # not a class of tests for pytest

    path: Path
    name: str
    line: int
    settings: Settings

    @property
    def title(self) -> str:
        """Its file and name."""
        return f"{self.path}::{self.name}"

    def make_program(self) -> TestProgram:
        """The program that runs it. Raises OSError and ScriptError."""
        test = Source(self.path)
        names = {one.name.replace("_", "").lower(): one.name for one in test.definitions}
        before, after = (names.get(f"{when}each") for when in _EACH)
        calls = [f"{name}()" for name in (before, self.name, after) if name]
        tested, mocks = (list(map(Source, paths)) for paths in (self.settings.program, self.settings.mocks))
        return TestProgram(tested, mocks, test, calls)


def is_test_file(path: Path) -> bool:
    """Whether a file is named like one of tests: ``test_x.script``, ``x_test.script``, ``x.test.script``."""
    return _TEST_FILE.fullmatch(path.name) is not None


def find_files(paths: Iterable[Path]) -> Iterator[Path]:
    """The test files among the paths and in the folders among them. Raises SuiteError for a missing one."""
    for path in paths:
        if path.is_dir():
            yield from sorted(one for one in path.rglob("*.script") if is_test_file(one))
        elif path.is_file():
            yield path
        else:
            raise SuiteError(f"there is no file or folder {path}")


def tests_of(path: Path) -> list[Test]:
    """The tests of a file. Raises SuiteError, ScriptError or OSError."""
    settings, by_test = _settings(path)
    found = [one for one in Source(path).definitions if one.name.startswith("test_")]
    if unknown := sorted(by_test.keys() - {one.name for one in found}):
        raise SuiteError(f"{path.with_suffix('.yaml')}: there is no test {unknown[0]} in {path.name}")
    return [Test(path, one.name, one.line, by_test.get(one.name, settings)) for one in found]


def whole_program(path: Path) -> TestProgram:
    """Everything that the tests of a file use, as one program to be checked. Raises like `tests_of`."""
    common, by_test = _settings(path)
    files = {one: None for settings in (common, *by_test.values()) for one in settings.program}
    mocks = {one: None for settings in (common, *by_test.values()) for one in settings.mocks}
    return TestProgram([*map(Source, files)], [*map(Source, mocks)], Source(path), [], assigns=False)


# settings


def _settings(path: Path) -> tuple[Settings, dict[str, Settings]]:
    """The settings of a file's tests, and of those that have others."""
    beside = path.with_suffix(".yaml")
    if beside.is_file():
        content = _mapping(_loaded(beside), str(beside))
        tests = _mapping(content.pop("tests", {}), f"{beside}: tests")
        common = {"program": _named_after(path), **content}
        return _read(common, beside), {
            str(name): _read({**common, **_mapping(one, f"{beside}: {name}")}, beside) for name, one in tests.items()
        }
    rival = next((parent / _RIVAL for parent in path.absolute().parents if (parent / _RIVAL).is_file()), None)
    if rival is not None:
        return _of_rival(rival), {}
    return Settings(path, tuple(path.parent / name for name in _named_after(path))), {}


def _named_after(path: Path) -> list[str]:
    """The file of the same name without ``test``, if there is one."""
    found = _TEST_FILE.fullmatch(path.name)
    name = f"{found[1] or found[2]}.script" if found else ""
    return [name] if name and (path.parent / name).is_file() else []


def _read(content: Mapping[str, Any], where: Path) -> Settings:
    options = {name: value for name, value in content.items() if name not in _OWN}
    program, mocks = (_files(content.get(name, []), where) for name in ("program", "mocks"))
    logs = tuple(str(text) for text in _list(content.get("logs", [])))
    fails = str(content.get("fails", ""))
    try:
        re.compile(fails)
    except re.error as error:
        raise SuiteError(f"{where}: {error}") from error
    return Settings(where, program, mocks, fails, logs, content.get("peers"), options)


def _files(names: Any, where: Path) -> tuple[Path, ...]:
    found = []
    for name in _list(names):
        matches = sorted(where.parent.glob(str(name)))
        if not matches:
            raise SuiteError(f"{where}: there is no file {name}")
        found += matches
    return tuple(found)


def _of_rival(path: Path) -> Settings:
    """Files by patterns relative to the current folder, and the version of the controller."""
    content = _mapping(_loaded(path), str(path))
    scripts = content.get("sources", {}).get("global", {}).get("scripts", {})
    version = content.get("controller", {}).get("autoLaunch", {}).get("version")
    mocks = content.get("mocks", {"include": ["__mocks__/**/*.mock.script"]})
    options = {"polyscope": version} if version else {}
    return Settings(path, _matching(scripts), _matching(mocks), options=options)


def _matching(patterns: Mapping[str, Any]) -> tuple[Path, ...]:
    included, excluded = (
        {name for pattern in patterns.get(key, []) for name in glob(pattern, recursive=True)}
        for key in ("include", "exclude")
    )
    return tuple(Path(name) for name in sorted(included - excluded))


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _loaded(path: Path) -> Any:
    try:
        return load_yaml(path.read_bytes())
    except InvalidYamlError as error:
        raise SuiteError(f"{path} is not YAML: {error}") from error


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SuiteError(f"{where} must be a mapping, not {value!r}")
    return value
