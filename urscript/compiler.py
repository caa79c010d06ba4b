"""From text to a compiled program.

Compiling is work in steps (`urscript.work`): `compile_script` takes them all at once,
`compile_steps` leaves the pace to the caller. No step is long. Python's own compiling
of a function cannot be interrupted: it is announced before it is done, and long functions are divided.
"""

import ast
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import CodeType
from typing import TypeAlias

from urproto.versions import Availability, PolyscopeVersion
from urscript.analysis import FunctionPlan, plan_functions
from urscript.builtins import Builtin, LibrarySet
from urscript.compile_expressions import CallWarning, Unit
from urscript.compile_statements import PythonFunction, compile_function, compile_main
from urscript.errors import CompileError, ScriptError, ScriptWarning
from urscript.inference import Kinds, infer_kinds
from urscript.parser import forget, normalize, parse
from urscript.syntax import Label, Program, ProgramKind
from urscript.work import Steps, let_go, run_to_end

FILE_NAME = "<urscript>"
"""The file name of compiled programs in tracebacks."""

STRUCT = Availability.since(None, "5.14")
"""struct(): dozens of public programs saved by 5.14.5 controllers use it; that 5.14.0 has it is a guess."""

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
    functions: Mapping[str, FunctionPlan]  # how they are called
    libraries: LibrarySet
    version: PolyscopeVersion

    @property
    def list_methods(self) -> bool:
        """Whether lists have methods in this version."""
        return RESIZABLE_LISTS.covers(self.version)


_CACHE_SIZE = 64  # programs
_CACHE_CHARACTERS = 4_000_000  # of all their texts: compiled programs are some twenty times as large
_Key: TypeAlias = tuple[str, LibrarySet, PolyscopeVersion, bool]
_cache: dict[_Key, CompiledProgram] = {}  # the one used last is last

_FUNCTION_WORK = 60  # of Python's compiler, for a function
_FORGETTING_WORK = 5  # of a function that is not compiled, beside its statements
_SLICE = 20  # of functions that are forgotten at a time
_MOST_HINTS = 5  # unknown names for which a known one is looked for, when all errors are asked for
_STARTING_WORK = 10  # of making a namespace for a run, which follows at once, beside its contents
_PYTHON_WORK = 6  # of Python's compiler, for each expression and statement


def compile_script(
    text: str, libraries: LibrarySet, version: PolyscopeVersion, *, stepped: bool = False
) -> CompiledProgram:
    """Compile one program: ``def name(): … end``, ``sec name(): … end``, or bare statements.

    With `stepped`, the program asks its host (`urscript.runtime.StepHost`) before each statement;
    it does the same in the same frames otherwise. Raises CompileError.
    """
    return run_to_end(compile_steps(text, libraries, version, stepped=stepped))


def _cached(key: _Key) -> CompiledProgram | None:
    """The program of a text that was compiled before: drivers send the same one again and again."""
    program = _cache.pop(key, None)
    if program is not None:
        _cache[key] = program
    return program


def compile_steps(
    text: str, libraries: LibrarySet, version: PolyscopeVersion, *, stepped: bool = False
) -> Steps[CompiledProgram]:
    """`compile_script` in steps; a text that was compiled before takes none."""
    key = (text, libraries, version, stepped)
    program = _cached(key)
    if program is None:
        program = yield from _compile(text, libraries, version, stepped)
        yield from _make_room(len(text))
        _cache[key] = program
    return program


def _make_room(wanted: int) -> Steps[None]:
    """Forget the programs that were used longest ago, until another of so many characters may be kept."""
    characters = wanted + sum(len(text) for text, *_ in _cache)
    while _cache and (len(_cache) >= _CACHE_SIZE or characters > _CACHE_CHARACTERS):
        oldest = next(iter(_cache))
        characters -= len(oldest[0])
        program = _cache.pop(oldest)
        code, labels, plans = list(program.code), list(program.labels), list(program.functions.values())
        del program  # with the last of who runs it; what is in these lists goes in steps
        yield _FORGETTING_WORK
        while code:
            del code[-_SLICE:]
            yield _SLICE * _FORGETTING_WORK
        yield from let_go(labels)
        yield from let_go(plans)


def find_problems(
    text: str, libraries: LibrarySet, version: PolyscopeVersion, *, statements: bool = False
) -> list[ScriptError]:
    """Everything that is wrong with one program, in the order of its text, each thing once.

    A CompileError keeps it from being started, a ScriptWarning does not.
    statements: it is the body of a program, even if it begins with a def.
    """
    source = normalize(text)
    errors: list[CompileError] = []
    warnings: list[CallWarning] = []
    try:
        with _nested_too_deeply(source):
            unit = run_to_end(_parsed(source, libraries, version, errors, statements=statements))
            unit.errors = errors
            run_to_end(generate(unit, _bodies(unit), FILE_NAME))
            for error in errors[:_MOST_HINTS]:
                run_to_end(unit.explain(error))
            warnings = unit.warnings
    except CompileError as error:
        errors.append(error)
    problems: list[ScriptError] = [
        *(error.at_its_cause() for error in errors),
        *(ScriptWarning(w.message, w.line, w.column, source) for w in warnings),
    ]
    once = {(problem.line, problem.column, problem.message): problem for problem in problems}
    return [once[place] for place in sorted(once)]


def _compile(text: str, libraries: LibrarySet, version: PolyscopeVersion, stepped: bool) -> Steps[CompiledProgram]:
    source = normalize(text)
    with _nested_too_deeply(source):
        unit = yield from _parsed(source, libraries, version)
        unit.stepped = stepped
        code = yield from generate(unit, _bodies(unit), FILE_NAME)
    error = yield from first_error(unit)
    if error is not None:
        yield from _forget(unit)
        raise error
    program = unit.program
    compiled = CompiledProgram(
        name=program.name,
        kind=program.kind,
        source=source,
        labels=tuple(program.labels),
        global_names=tuple(program.globals),
        warnings=tuple(unit.warnings),
        code=tuple(code),
        builtins=unit.used,
        functions=unit.plans,
        libraries=libraries,
        version=version,
    )
    yield from _forget(unit)
    yield _STARTING_WORK + 2 * len(compiled.code) + len(compiled.global_names) // 4
    return compiled


def _forget(unit: Unit) -> Steps[None]:
    """Let go of the syntax tree, and of what was found out about it."""
    yield from let_go(unit.errors)
    unit.unexplained.clear()
    yield from unit.kinds.forget()
    yield from forget(unit.program)


@contextmanager
def _nested_too_deeply(source: str) -> Iterator[None]:
    try:
        yield
    except RecursionError as error:
        raise CompileError.syntax("the program is nested too deeply", 1, 1, source) from error


def _parsed(
    source: str,
    libraries: LibrarySet,
    version: PolyscopeVersion,
    errors: list[CompileError] | None = None,
    *,
    statements: bool = False,
) -> Steps[Unit]:
    program = yield from parse(source, errors, statements=statements)
    builtins = libraries.available(version)
    plans = yield from plan_functions(program, builtins, known={})
    kinds = yield from infer_kinds(program, builtins)
    return make_unit(program, source, libraries, builtins, plans, version, kinds)


def make_unit(
    program: Program,
    source: str,
    libraries: LibrarySet,
    builtins: Mapping[str, Builtin],
    plans: Mapping[str, FunctionPlan],
    version: PolyscopeVersion,
    kinds: Kinds | None = None,
) -> Unit:
    """What is compiled together, for a version of the language. ``plans``: every function that can be called."""
    return Unit(
        program,
        source,
        builtins,
        plans,
        kinds or Kinds(program, builtins, {}),
        libraries.elsewhere(version) | ({} if STRUCT.covers(version) else {"struct": STRUCT}),
        version,
        structs=STRUCT.covers(version),
        fixed_lists=not RESIZABLE_LISTS.covers(version),
    )


def _bodies(unit: Unit) -> list[Steps[list[PythonFunction]]]:
    functions = unit.program.functions
    return [*(compile_function(unit, functions[name], plan) for name, plan in unit.plans.items()), compile_main(unit)]


def generate(unit: Unit, bodies: list[Steps[list[PythonFunction]]], file_name: str) -> Steps[list[CodeType]]:
    """The code of these bodies of the unit; what is wrong with it is in the unit's errors then."""
    code: list[CodeType] = []
    for steps in bodies:
        functions = yield from steps
        while functions:  # each is forgotten as soon as it is compiled
            function = functions.pop()
            if unit.errors:
                yield _FORGETTING_WORK + function.size
                continue
            yield _FUNCTION_WORK + function.size * _PYTHON_WORK
            code.append(_python(function, file_name))
    return code


def first_error(unit: Unit) -> Steps[CompileError | None]:
    """The error that stands first in the unit's text, if there is one."""
    if not unit.errors:
        return None
    error = min(unit.errors, key=lambda error: (error.line, error.column))
    yield from unit.explain(error)
    return error


def _python(function: PythonFunction, file_name: str) -> CodeType:
    return compile(ast.Module(body=[function.code], type_ignores=[]), file_name, "exec")
