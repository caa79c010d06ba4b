"""The built-ins that programs are checked against: how each is called, and what it does in words.

The functions themselves belong to the emulator, which takes a second to load. ``docs/generate.py`` therefore writes
their signatures and docstrings to ``builtins.csv``.
"""

import csv
import json
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

from urproto.versions import Availability, PolyscopeVersion
from urscript import values
from urscript.builtins import Builtin, Library, LibrarySet, Parameter
from urscript.values import Kind, PhysicalKind, Pose

TABLE: Final = Path(__file__).with_name("builtins.csv")

_COLUMNS: Final = ("name", "parameters", "result", "flags", "cb3", "e", "x", "doc")
_KINDS: Final[dict[str, Kind]] = {kind.title: kind for kind in vars(values).values() if isinstance(kind, Kind)}
_RESULTS: Final[dict[str, Any]] = {
    "int": int,
    "float": float,
    "pose": Pose,
    "numbers": list[float],
    "ints": list[int],
    "bool": bool,
    "text": str,
}
"""The annotations of results that the compiler distinguishes."""
_IN_TESTS: Final = "tests"
"""The chapter of what only tests can call; the table does not name any other."""
_FLAGS: Final = ("host", "takes_scope", "variadic", "takes_time", _IN_TESTS)


@cache
def libraries(*, in_tests: bool = False) -> LibrarySet:
    """The built-ins of all versions; with those that only tests of programs can call."""
    library = Library("")
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if in_tests or _IN_TESTS not in row["flags"].split()]
        library.builtins.update((row["name"], _read(row)) for row in rows)
    return LibrarySet([library])


def table(builtins: Iterable[Builtin]) -> Iterator[tuple[str, ...]]:
    """The rows of the file for some built-ins, with the head."""
    yield _COLUMNS
    for builtin in sorted(builtins, key=lambda builtin: builtin.name):
        available = (builtin.availability.cb3, builtin.availability.e, builtin.availability.x)
        yield (
            builtin.name,
            "; ".join(map(_parameter_text, builtin.parameters)),
            result_word(builtin),
            " ".join(flag for flag in _FLAGS if flag == builtin.chapter or getattr(builtin, flag, False)),
            *(str(version or "") for version in available),
            builtin.doc,
        )


def result_word(builtin: Builtin) -> str:
    """The type of a built-in's result; empty if it has none, or several."""
    return next((word for word, annotation in _RESULTS.items() if annotation == builtin.result), "")


def _parameter_text(parameter: Parameter) -> str:
    """``t_min|t: Num?=0`` for an optional number that may be left out; ``!`` marks a physical quantity."""
    physical = "!" if isinstance(parameter.kind, PhysicalKind) else ""
    default = "" if parameter.required else f"={json.dumps(parameter.default)}"
    optional = "?" if parameter.optional else ""
    return f"{'|'.join(parameter.names)}: {parameter.kind.title}{physical}{optional}{default}"


def _parameter(text: str) -> Parameter:
    names, _, rest = text.partition(": ")
    kind, required, default = rest.partition("=")
    title = kind.rstrip("?!")
    accepted = PhysicalKind(title, _KINDS[title]) if "!" in kind else _KINDS[title]
    value = json.loads(default) if default else None
    value = tuple(value) if isinstance(value, list) else value
    return Parameter(tuple(names.split("|")), accepted, "?" in kind, required=not required, default=value)


def _read(row: dict[str, str]) -> Builtin:
    flags = row["flags"].split()
    versions = (PolyscopeVersion.parse(row[line]) if row[line] else None for line in ("cb3", "e", "x"))
    return Builtin(
        name=row["name"],
        chapter=_IN_TESTS if _IN_TESTS in flags else "",
        function=_absent,
        host="host" in flags,
        takes_scope="takes_scope" in flags,
        parameters=tuple(map(_parameter, row["parameters"].split("; "))) if row["parameters"] else (),
        variadic="variadic" in flags,
        takes_time="takes_time" in flags,
        result=_RESULTS.get(row["result"]),
        returns=None,
        availability=Availability(*versions),
        status="supported",
        note="",
        doc=row["doc"],
    )


def _absent(*_: Any) -> None:
    raise AssertionError("programs that are only checked do not run")
