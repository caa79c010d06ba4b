"""Every file is valid for the oldest supported Python, regardless of the Python that runs the tests.

In the packages, mypy finds names newer than that Python, and ruff finds newer syntax. This finds what they do not
check: names in the files outside the packages, regular expressions, and code that is an error only in some versions.
"""

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.rows import each_row
from urproto.compat import load_toml

ROOT = Path(__file__).resolve().parents[2]
PROJECT = load_toml((ROOT / "pyproject.toml").read_text())
OLDEST = PROJECT["project"]["requires-python"].removeprefix(">=")
COMPAT = {"urproto/compat.py", "urproto/compat_asyncio.py"}  # they provide the newer names
PACKAGES = ("urproto/", "urscript/", "emulator/", "client/", "urproto/testing/")

# names that Python 3.10 lacks -> replacements
NEWER = {
    "asyncio.Runner": "asyncio.run",
    "asyncio.TaskGroup": "asyncio.gather",
    "asyncio.timeout": "urproto.compat_asyncio.timeout",
    "asyncio.timeout_at": "urproto.compat_asyncio.timeout",
    "contextlib.chdir": "monkeypatch.chdir",
    "datetime.UTC": "datetime.timezone.utc",
    "enum.StrEnum": "urproto.compat.StrEnum",
    "hashlib.file_digest": "hashlib.sha256",
    "itertools.batched": "a loop",
    "tomllib": "urproto.compat.load_toml",
    "typing.Never": "typing.NoReturn",
    "typing.Self": "urproto.compat.Self",
    "typing.assert_never": "an error",
    "typing.override": "nothing",
}
# names that behave differently in Python 3.10 -> replacements in the packages
OTHERWISE = {
    "asyncio.wait_for": "urproto.compat_asyncio.timeout, whose TimeoutError is Python's own",
    "enum.IntEnum": "urproto.compat.IntEnum, which prints as a number",
    "enum.IntFlag": "urproto.compat.IntFlag, which prints as a number",
}
_LAST = "|".join(name.split(".")[-1] for name in NEWER | OTHERWISE)
SUSPECT = re.compile(rf"except\*|to_bytes|\bre\.|\b(?:{_LAST})\b")
POSSESSIVE = re.compile(r"(?<!\\)(?:[+*?]|\{[0-9,]+\})\+|\(\?>")


def complaints(source: str, *, packaged: bool) -> Iterator[str]:
    """Code that the oldest Python rejects, each with its line. packaged: include different behaviour."""
    if not SUSPECT.search(source):
        return  # most files: reading them all takes seconds
    try:
        tree = ast.parse(source, feature_version=tuple(map(int, OLDEST.split("."))))
    except SyntaxError as error:
        yield f"{error.lineno}: {error.msg}"
        return
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        names = set(_names(node))
        yield from (f"{line}: {name}: take {NEWER[name]}" for name in sorted(names & NEWER.keys()))
        if packaged:
            yield from (f"{line}: {name}: take {OTHERWISE[name]}" for name in sorted(names & OTHERWISE.keys()))
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name("re")), args=[pattern, *_]):
                texts = (part.value for part in ast.walk(pattern) if isinstance(part, ast.Constant))
                if any(isinstance(text, str | bytes) and POSSESSIVE.search(_text(text)) for text in texts):
                    yield f"{line}: possessive quantifiers and atomic groups: write it so that it need not go back"
            case ast.Call(func=ast.Attribute(attr="to_bytes"), args=[_], keywords=[]):
                yield f"{line}: to_bytes: say which byte comes first"


def _names(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Import(names):
            yield from (alias.name for alias in names)
        case ast.ImportFrom(str(module), names):
            yield from (module, *(f"{module}.{alias.name}" for alias in names))
        case ast.Attribute(ast.Name(module), name):
            yield f"{module}.{name}"


def _text(value: str | bytes) -> str:
    return value if isinstance(value, str) else value.decode("latin-1")


@pytest.mark.long
def test_every_file_is_valid_for_the_oldest_python() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [file for file in listed.split() if file not in COMPAT and (ROOT / file).exists()]
    assert len(files) > 500
    found = [
        f"{file}:{complaint}"
        for file in files
        for complaint in complaints((ROOT / file).read_text(), packaged=file.startswith(PACKAGES))
    ]
    assert not found, "\n".join(found)


@each_row(
    ("source", "complaint"),
    [
        ("try:\n  pass\nexcept* OSError:\n  pass", "[34]: (Exception groups|invalid syntax)"),
        ("import asyncio\nasync def f():\n  async with asyncio.timeout(1):\n    pass", "3: asyncio.timeout: take"),
        ("import asyncio\nasync def f():\n  await asyncio.wait_for(g(), 1)", "3: asyncio.wait_for: take"),
        ("from enum import Enum, IntEnum", "1: enum.IntEnum: take urproto.compat.IntEnum"),
        ("from typing import Any, Self", "1: typing.Self: take urproto.compat.Self"),
        ("import tomllib", "1: tomllib: take urproto.compat.load_toml"),
        ("import re\nre.compile(rb'[a-z]*+x')", "2: possessive"),
        ("import re\nre.match('(?>a)' + 'b', text)", "2: possessive"),
        ("length.to_bytes(3)", "1: to_bytes: say which"),
    ],
)
def test_newer_features_are_found(source: str, complaint: str) -> None:
    (found,) = complaints(source, packaged=True)
    assert re.match(complaint, found)


def test_older_features_are_accepted() -> None:
    source = "import re, asyncio\nre.compile(r'\\++[+]+ a{2}')\nx.to_bytes(2, 'big')\nfrom enum import Enum"
    assert not list(complaints(source, packaged=True))


def test_the_oldest_python_is_named_consistently() -> None:
    assert PROJECT["tool"]["mypy"]["python_version"] == OLDEST
    assert PROJECT["tool"]["ruff"]["target-version"] == f"py{OLDEST.replace('.', '')}"
    assert f"Programming Language :: Python :: {OLDEST}" in PROJECT["project"]["classifiers"]
    makefile = (ROOT / "Makefile").read_text()
    assert f"sys.version_info < ({OLDEST.replace('.', ', ')})" in makefile
    assert f"--python-version {OLDEST} " in makefile
    assert f'"{OLDEST}"' in (ROOT / ".github/workflows/ci.yml").read_text()
