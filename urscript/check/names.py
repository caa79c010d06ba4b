"""Names that exist outside a program: of URCaps, of included scripts, and of the project file."""

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final

from urproto.compat import load_toml
from urproto.text import quoted, unknown
from urscript.analysis import FunctionPlan
from urscript.compiler import Known
from urscript.files import ScriptFile
from urscript.parser import parse
from urscript.syntax import Constant, Parameter
from urscript.work import run_to_end

_SIGNATURE: Final = re.compile(r"(\w+)(\(([^()]*)\))?")
_PARAMETER: Final = re.compile(r"\s*([A-Za-z_]\w*)\s*(=.*)?")
_LEFT_OUT: Final = Constant(1, 1, None)
"""Stands for every default value: only whether there is one matters."""


def joined(parts: Iterable[Known]) -> Known:
    """All of these names."""
    functions: dict[str, FunctionPlan] = {}
    variables: set[str] = set()
    undecided: set[str] = set()
    for part in parts:
        functions |= part.functions
        variables.update(part.variables)
        undecided.update(part.undecided)
    return Known(functions, variables, undecided)


def declared(signatures: Iterable[str]) -> Known:
    """Functions written as ``grip(width, force=40)`` and variables. Raises ValueError."""
    functions, variables = {}, set()
    for text in signatures:
        match = _SIGNATURE.fullmatch(text.strip())
        if match is None or text.strip()[0].isdigit():
            raise ValueError(f"{quoted(text)} is neither a variable nor a function such as grip(width, force=40)")
        if match[2] is None:
            variables.add(match[1])
            continue
        found = [_PARAMETER.fullmatch(part) for part in match[3].split(",")] if match[3].strip() else []
        if not all(found):
            raise ValueError(f"{quoted(text)} has a parameter that is not a name")
        parameters = [Parameter(1, 1, part[1], _LEFT_OUT if part[2] else None) for part in found if part]
        functions[match[1]] = _plan(match[1], parameters, is_thread=False)
    return Known(functions, variables)


def defined_in(path: Path) -> Known:
    """The functions, threads and global variables of a script file. Raises OSError and ValueError."""
    file = ScriptFile(path.name, path.read_bytes())
    functions: dict[str, FunctionPlan] = {}
    variables: set[str] = set()
    for unit in file.units:
        program = run_to_end(parse(unit.text, []))
        variables.update(program.globals)
        if program.name:
            functions[program.name] = _plan(program.name, [], is_thread=False)
        for name, function in program.functions.items():
            functions[name] = _plan(name, function.scope.parameters, is_thread=function.scope.is_thread)
    return Known(functions, variables)


def _plan(name: str, parameters: Iterable[Parameter], *, is_thread: bool) -> FunctionPlan:
    given = tuple(Parameter(1, 1, p.name, _LEFT_OUT if p.default is not None else None) for p in parameters)
    return FunctionPlan(given, is_thread, f"k_{name}", cost=0, generator=True, recursive=False)


# URCaps


@cache
def urcaps() -> dict[str, dict[str, Known]]:
    """What each version of each URCap defines; the newest version comes last."""
    found: dict[str, dict[str, Known]] = {}
    table = load_toml(Path(__file__).with_name("urcaps.toml").read_text(encoding="utf-8"))
    for entry in table["urcap"]:
        known = declared([*entry.get("functions", "").split(), *entry.get("variables", "").split()])
        found.setdefault(entry["name"], {})[entry["version"]] = known
    return found


def urcap(text: str) -> Known:
    """What a URCap defines: ``robotiq-grippers``, or ``robotiq-grippers 1.7``. Raises ValueError."""
    name, _, version = text.partition(" ")
    versions = urcaps().get(name)
    if versions is None:
        raise ValueError(unknown("URCap", name, urcaps()))
    version = version.strip() or list(versions)[-1]
    if version not in versions:
        raise ValueError(unknown(f"version of {name}", version, versions))
    return versions[version]


def owner_of(function: str) -> str:
    """The URCap that defines a function; empty if none does."""
    return next((name for name, all_ in urcaps().items() for one in all_.values() if function in one.functions), "")
