"""From text to a compiled program.

Compiling is work in steps (`urscript.work`): `compile_script` takes them all at once,
`compile_steps` leaves the pace to the caller. No step is long, except Python's own compiling
of a function, which cannot be interrupted; it is announced before it is done.
"""

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from types import CodeType

from urproto.versions import Availability, PolyscopeVersion
from urscript.analysis import plan_functions
from urscript.builtins import Builtin, LibrarySet
from urscript.compile_expressions import CallWarning, Unit
from urscript.compile_statements import PythonFunction, compile_function, compile_main
from urscript.errors import CompileError
from urscript.parser import normalize, parse
from urscript.syntax import Label, ProgramKind
from urscript.work import Steps, run_to_end

__all__ = ["FILE_NAME", "CallWarning", "CompiledProgram", "compile_script", "compile_steps"]

FILE_NAME = "<urscript>"
"""The file name of compiled programs in tracebacks."""

STRUCT = Availability.since(None, "5.15")
"""struct(): introduced with list capacities, says one developer's note; the exact version is a guess."""

RESIZABLE_LISTS = Availability.since(None, "5.15")
"""Before, "Resizing of 'List' is not supported" (simulators 5.9.4 to 5.14.6); after, it is (5.15.2 on)."""


@dataclass(frozen=True, slots=True, eq=False)
class CompiledProgram:
    """A program that compiled, ready to be run any number of times."""

    name: str  # of the def; empty for bare statements
    kind: ProgramKind
    source: str  # from the first line with code on: line 1 of every position
    labels: tuple[Label, ...]
    global_names: tuple[str, ...]  # in order of appearance
    warnings: tuple[CallWarning, ...]  # calls that will fail when executed
    code: tuple[CodeType, ...]  # to be executed one after the other in a namespace
    builtins: Mapping[str, Builtin]  # those that it calls
    list_methods: bool


_CACHE_SIZE = 64  # programs
_CACHE_CHARACTERS = 4_000_000  # of all their texts: compiled programs are some twenty times as large
_cache: dict[tuple[str, LibrarySet, PolyscopeVersion], CompiledProgram] = {}  # the one used last is last

_MAX_FUNCTION = 50_000
"""Longest function [statements and expressions]: Python compiles one in one go, this one in about 0.2 s (a guess)."""

_PYTHON_WORK = 4  # of Python's compiler, for each expression and statement


def compile_script(text: str, libraries: LibrarySet, version: PolyscopeVersion) -> CompiledProgram:
    """Compile one program: ``def name(): … end``, ``sec name(): … end``, or bare statements.

    Raises CompileError.
    """
    return run_to_end(compile_steps(text, libraries, version))


def _cached(text: str, libraries: LibrarySet, version: PolyscopeVersion) -> CompiledProgram | None:
    """The program of a text that was compiled before: drivers send the same one again and again."""
    key = (text, libraries, version)
    program = _cache.pop(key, None)
    if program is not None:
        _cache[key] = program
    return program


def compile_steps(text: str, libraries: LibrarySet, version: PolyscopeVersion) -> Steps[CompiledProgram]:
    """`compile_script` in steps; a text that was compiled before takes none."""
    program = _cached(text, libraries, version)
    if program is None:
        program = yield from _compile(text, libraries, version)
        _cache[text, libraries, version] = program
        _trim_cache()
    return program


def _trim_cache() -> None:
    """Forget the programs that were used longest ago, but not the last."""
    characters = sum(len(text) for text, _, _ in _cache)
    while len(_cache) > 1 and (len(_cache) > _CACHE_SIZE or characters > _CACHE_CHARACTERS):
        oldest = next(iter(_cache))
        characters -= len(oldest[0])
        del _cache[oldest]


def _compile(text: str, libraries: LibrarySet, version: PolyscopeVersion) -> Steps[CompiledProgram]:
    source = normalize(text)
    try:
        program = yield from parse(source)
        builtins = libraries.available(version)
        unit = Unit(
            program,
            source,
            builtins,
            plan_functions(program, builtins),
            structs=STRUCT.covers(version),
            fixed_lists=not RESIZABLE_LISTS.covers(version),
        )
        code = yield from _generate(unit)
    except RecursionError as error:
        raise CompileError.syntax("the program is nested too deeply", 1, 1, source) from error
    return CompiledProgram(
        name=program.name,
        kind=program.kind,
        source=source,
        labels=tuple(program.labels),
        global_names=tuple(program.globals),
        warnings=tuple(unit.warnings),
        code=tuple(code),
        builtins=unit.used,
        list_methods=RESIZABLE_LISTS.covers(version),
    )


def _generate(unit: Unit) -> Steps[list[CodeType]]:
    """The code of every function of the program; raises the first error of the text."""
    code: list[CodeType] = []
    for steps in [*(compile_function(unit, plan) for plan in unit.plans.values()), compile_main(unit)]:
        for function in (yield from steps):
            if unit.error is not None:
                continue  # only to find an earlier error
            _check_length(function, unit.source)
            yield function.size * _PYTHON_WORK
            code.append(_python(function))
    if unit.error is not None:
        raise unit.error
    return code


def _check_length(function: PythonFunction, source: str) -> None:
    if function.size > _MAX_FUNCTION:
        message = f"a def, a thread or an undivided block is longer than {_MAX_FUNCTION} statements and values"
        raise CompileError.syntax(message, function.code.lineno, function.code.col_offset + 1, source)


def _python(function: PythonFunction) -> CodeType:
    return compile(ast.Module(body=[function.code], type_ignores=[]), FILE_NAME, "exec")
