"""Compile the text of a program.

Compiling works in steps (`urscript.work`), each of which is short: `compile_script` takes all of them immediately, and
with `compile_steps` the caller sets the pace. Python's own compilation of a function cannot be interrupted, so its work
is yielded in advance, and long functions are divided.
"""

import ast
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from types import CodeType, MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from urproto.facts import availability
from urproto.versions import Availability, PolyscopeVersion
from urscript.analysis import FunctionPlan, plan_functions
from urscript.blocks import Blocks
from urscript.builtins import Builtin, LibrarySet
from urscript.compile_expressions import Unit
from urscript.compile_statements import compile_function, compile_main
from urscript.dependencies import Dependencies
from urscript.errors import CompileError, ScriptError, ScriptWarning
from urscript.inference import Kinds, infer_kinds
from urscript.parser import discard, normalize, parse
from urscript.pieces import PythonFunction
from urscript.pycode import code_of
from urscript.syntax import Label, Program, ProgramKind, Scope
from urscript.work import Steps, release, run_to_end

FILE_NAME = "<urscript>"
"""The file name of compiled programs in tracebacks."""

STRUCT = Availability.since(None, "5.14")
"""struct(): dozens of public programs saved by 5.14.5 controllers use it. It is a guess that 5.14.0 has it."""

RESIZABLE_LISTS = availability("list.resizable")
"""Earlier versions report "Resizing of 'List' is not supported"."""

_CACHE_SIZE = 64  # programs
_CACHE_CHARACTERS = 4_000_000  # of all source texts together: compiled programs are some twenty times as large
_RELEASE_WORK = 5  # to free a function that is not compiled, without its statements
_FUNCTION_WORK = 60  # of Python's compiler, per function
_SLICE = 20  # functions freed at a time
_MAX_HINTS = 5  # unknown names for which a similar one is searched when all errors are collected
_STARTING_WORK = 10  # to create the namespace of a run, which follows immediately, without its contents
_PYTHON_WORK = 6  # of Python's compiler, per expression and statement


@dataclass(frozen=True, slots=True, eq=False)
class CompiledProgram:
    """A compiled program, which can be run any number of times."""

    name: str  # of the def; empty for bare statements
    kind: ProgramKind
    source: str  # from the first line with code on: line 1 of every position
    labels: tuple[Label, ...]
    global_names: tuple[str, ...]  # in order of appearance
    warnings: tuple[ScriptWarning, ...]  # calls that will fail when executed
    code: tuple[CodeType, ...]  # of the Python functions; their free variables are global variables
    builtins: Mapping[str, Builtin]  # the ones it calls
    functions: Mapping[str, FunctionPlan]  # how they are called
    libraries: LibrarySet
    version: PolyscopeVersion
    prices: Sequence[int] = ()  # work of each step that compiling it took

    @property
    def list_methods(self) -> bool:
        """Whether lists have methods in this version."""
        return RESIZABLE_LISTS.covers(self.version)


Key: TypeAlias = tuple[str, LibrarySet, PolyscopeVersion, bool]
"""Identifies a program: text, libraries, version, whether it is stepped."""


class CompiledPrograms:
    """Programs by their keys: as many as there is room for; the least recently used ones are removed first."""

    def __init__(self) -> None:
        self._programs: dict[Key, CompiledProgram] = {}
        self._characters = 0

    def get(self, key: Key) -> CompiledProgram | None:
        """The program; None if it is not there, or was removed."""
        program = self._programs.pop(key, None)
        if program is not None:
            self._programs[key] = program
        return program

    def add(self, key: Key, program: CompiledProgram) -> list[CompiledProgram]:
        """Add a program; returns those that were removed to make room for it."""
        removed = []
        if self._programs.pop(key, None) is None:
            self._characters += len(key[0])
        while self._programs and (len(self._programs) >= _CACHE_SIZE or self._characters > _CACHE_CHARACTERS):
            oldest = next(iter(self._programs))
            self._characters -= len(oldest[0])
            removed.append(self._programs.pop(oldest))
        self._programs[key] = program
        return removed


_cache = CompiledPrograms()  # of all robots of this process: it saves work, but none of a robot's time
_discarded: list[Any] = []  # contents of programs, to be freed in slices


def compile_script(
    text: str, libraries: LibrarySet, version: PolyscopeVersion, *, stepped: bool = False
) -> CompiledProgram:
    """Compile one program: ``def name(): … end``, ``sec name(): … end``, or bare statements.

    With `stepped`, the program asks its host (`urscript.runtime.StepHost`) before each statement; apart from that, it
    does the same in the same frames. Raises CompileError.
    """
    return run_to_end(compile_steps(text, libraries, version, stepped=stepped))


def compile_steps(
    text: str, libraries: LibrarySet, version: PolyscopeVersion, *, stepped: bool = False
) -> Steps[CompiledProgram]:
    """Like `compile_script`, in steps, which are the same for a text that this process has compiled before.

    A robot's time, which these steps take, must not depend on what other robots of its process have done.
    """
    key = (text, libraries, version, stepped)
    program = _cache.get(key)
    if program is not None:
        yield from program.prices
        return program
    prices = array("L")
    with closing(_compile(text, libraries, version, stepped)) as steps:
        while True:
            try:
                price = next(steps)
            except StopIteration as end:
                compiled: CompiledProgram = end.value
                program = replace(compiled, prices=prices)
                break
            prices.append(price)
            del _discarded[-_SLICE:]
            yield price
    let_go(_cache.add(key, program))
    return program


def let_go(programs: Iterable[CompiledProgram]) -> None:
    """Let go of programs; unless others use them, they are freed in slices while further programs are compiled."""
    for program in programs:
        _discarded.extend((*program.functions.values(), *program.labels, *program.code))


class Known(NamedTuple):
    """Functions and variables that exist although a program does not define them.

    undecided: names that are never reported as undefined, such as placeholders.
    """

    functions: Mapping[str, FunctionPlan] = MappingProxyType({})
    variables: Collection[str] = ()
    undecided: Collection[str] = ()


NOTHING: Final = Known()

Inspect: TypeAlias = Callable[[Unit, Dependencies], Iterable[ScriptWarning]]
"""Finds further problems of a program that the compiler could read to its end."""


def find_problems(
    text: str,
    libraries: LibrarySet,
    version: PolyscopeVersion,
    known: Known = NOTHING,
    inspect: Inspect = lambda *_: (),
    *,
    statements: bool = False,
    blocks: Blocks | None = None,
) -> list[ScriptError]:
    """All problems of one program in the order of its text, without duplicates.

    A CompileError prevents the program from starting; a ScriptWarning does not.
    statements: the text is the body of a program, even if it begins with a def. blocks: those of earlier states of the
    text, with what was found in them.
    """
    source = normalize(text)
    errors: list[CompileError] = []
    warnings: list[ScriptWarning] = []
    scopes: list[Scope] = []
    try:
        with _nested_too_deeply(source):
            program = (blocks or Blocks()).parse(source, errors, statements=statements)
            scopes = program.scopes
            unit = run_to_end(_unit(program, source, libraries, version, known))
            unit.errors, unit.divided = errors, False
            dependencies = Dependencies(unit)
            for name, plan in unit.plans.items():
                if function := program.functions.get(name):
                    compiling = partial(_warnings, unit, compile_function(unit, function, plan))
                    warnings += dependencies.found("compiler", function, compiling)
            warnings += _warnings(unit, compile_main(unit))
            for error in errors[:_MAX_HINTS]:
                run_to_end(unit.explain(error))
            if all(error.unknown_name for error in errors):  # otherwise, the tree lacks what could not be parsed
                warnings += inspect(unit, dependencies)
    except CompileError as error:
        errors.append(error)
    problems = [*(error.at_its_cause() for error in _certain(errors, scopes)), *warnings]
    once = {(problem.line, problem.column, problem.message): problem for problem in problems}
    return [once[place] for place in sorted(once)]


def _certain(errors: Sequence[CompileError], scopes: Iterable[Scope]) -> list[CompileError]:
    """The errors without unknown names that a text may define after all, because it does not parse.

    The rest of an open text may define them, and so may a def whose beginning or end is not where it should be.
    """
    syntax = [error for error in errors if not error.unknown_name]
    if not syntax or any(error.is_open for error in syntax):
        return syntax or list(errors)
    local = set[str]().union(*(scope.locals | scope.assigned for scope in scopes))
    return [error for error in errors if error.missing_name not in local]


def _warnings(unit: Unit, steps: Steps[list[PythonFunction]]) -> list[ScriptWarning]:
    """The warnings of compiling a body."""
    unit.warnings = []
    run_to_end(steps)
    return unit.warnings


def _compile(text: str, libraries: LibrarySet, version: PolyscopeVersion, stepped: bool) -> Steps[CompiledProgram]:
    source = normalize(text)
    with _nested_too_deeply(source):
        program = yield from parse(source)
        unit = yield from _unit(program, source, libraries, version)
        unit.stepped = stepped
        code = yield from generate(unit, _bodies(unit), FILE_NAME)
    error = yield from first_error(unit)
    if error is not None:
        yield from _discard(unit)
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
    yield from _discard(unit)
    yield _STARTING_WORK + 2 * len(compiled.code) + len(compiled.global_names) // 4
    return compiled


def _discard(unit: Unit) -> Steps[None]:
    """Free the syntax tree and the results of its analysis, in steps."""
    yield from release(unit.errors)
    unit.unexplained.clear()
    yield from unit.kinds.discard()
    yield from discard(unit.program)


@contextmanager
def _nested_too_deeply(source: str) -> Iterator[None]:
    try:
        yield
    except RecursionError as error:
        raise CompileError.syntax("the program is nested too deeply", 1, 1, source) from error


def _unit(
    program: Program, source: str, libraries: LibrarySet, version: PolyscopeVersion, known: Known = NOTHING
) -> Steps[Unit]:
    program.globals |= dict.fromkeys(known.variables)
    program.damaged.update(known.undecided)
    builtins = libraries.available(version)
    plans = yield from plan_functions(program, builtins, known.functions)
    kinds = yield from infer_kinds(program, builtins)
    return make_unit(program, source, libraries, builtins, {**known.functions, **plans}, version, kinds)


def make_unit(
    program: Program,
    source: str,
    libraries: LibrarySet,
    builtins: Mapping[str, Builtin],
    plans: Mapping[str, FunctionPlan],
    version: PolyscopeVersion,
    kinds: Kinds | None = None,
) -> Unit:
    """The unit of a program for a version of the language. plans: those of all functions that can be called."""
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
    own = unit.program.functions
    functions = (compile_function(unit, own[name], plan) for name, plan in unit.plans.items() if name in own)
    return [*functions, compile_main(unit)]


def generate(unit: Unit, bodies: list[Steps[list[PythonFunction]]], file_name: str) -> Steps[list[CodeType]]:
    """The code of these bodies of the unit; errors found on the way are added to the unit's errors."""
    code: list[CodeType] = []
    for steps in bodies:
        functions = yield from steps
        while functions:  # each is freed as soon as it is compiled
            function = functions.pop()
            if unit.errors:
                yield _RELEASE_WORK + function.size
                continue
            yield _FUNCTION_WORK + function.size * _PYTHON_WORK
            code.append(_python(function, file_name))
    return code


def first_error(unit: Unit) -> Steps[CompileError | None]:
    """The first error in the unit's text, if there is one."""
    if not unit.errors:
        return None
    error = min(unit.errors, key=lambda error: (error.line, error.column))
    yield from unit.explain(error)
    return error


def _python(function: PythonFunction, file_name: str) -> CodeType:
    return code_of(compile(ast.Module(body=[function.code], type_ignores=[]), file_name, "exec"))
