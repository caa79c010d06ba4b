"""From text to a compiled program."""

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import CodeType

from urproto.versions import Availability, PolyscopeVersion
from urscript.analysis import plan_functions
from urscript.builtins import Builtin, LibrarySet
from urscript.compile_expressions import CallWarning, Unit
from urscript.compile_statements import compile_function, compile_main
from urscript.errors import CompileError
from urscript.parser import normalize, parse
from urscript.syntax import Label, ProgramKind

__all__ = ["FILE_NAME", "CallWarning", "CompiledProgram", "compile_script"]

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
    code: CodeType
    builtins: Mapping[str, Builtin]  # those that it calls
    list_methods: bool


@lru_cache(maxsize=64)
def compile_script(text: str, libraries: LibrarySet, version: PolyscopeVersion) -> CompiledProgram:
    """Compile one program: ``def name(): … end``, ``sec name(): … end``, or bare statements.

    Drivers send the same text again and again, so results are kept. Raises CompileError.
    """
    source = normalize(text)
    try:
        program = parse(source)
        unit = Unit(
            program,
            source,
            libraries.available(version),
            plan_functions(program, libraries.available(version)),
            structs=STRUCT.covers(version),
            fixed_lists=not RESIZABLE_LISTS.covers(version),
        )
        code = _compile(unit)
    except RecursionError as error:
        raise CompileError.syntax("the program is nested too deeply", 1, 1, source) from error
    return CompiledProgram(
        name=program.name,
        kind=program.kind,
        source=source,
        labels=tuple(program.labels),
        global_names=tuple(program.globals),
        warnings=tuple(unit.warnings),
        code=code,
        builtins=unit.used,
        list_methods=RESIZABLE_LISTS.covers(version),
    )


def _compile(unit: Unit) -> CodeType:
    functions = [compile_function(unit, plan) for plan in unit.plans.values()]
    module = ast.Module(body=[*functions, compile_main(unit)], type_ignores=[])
    if unit.errors:
        raise min(unit.errors, key=lambda error: (error.line, error.column))
    try:
        return compile(module, FILE_NAME, "exec")
    except SyntaxError as error:  # Python allows 20 loops inside each other
        raise CompileError.syntax(f"{error.msg}", error.lineno or 1, error.offset or 1, unit.source) from error
