"""Statements for a running program (interpreter mode), compiled against its functions and the variables of a scope.

A function that calls a built-in with `takes_scope` keeps its variables in a `Locals` instead of Python's own locals,
and so do the statements interpreted in it. Names that statements declare belong to that scope; functions cannot see
them, like any other local. New globals are refused (Script Manual: not supported).

The program does not change while a statement is compiled. `Runtime.link` adds the functions of the statement: all of
them or, after an error, none.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import CodeType

from urscript.analysis import FunctionPlan, plan_functions
from urscript.builtins import Builtin
from urscript.compile_statements import compile_function, compile_interpreted
from urscript.compiler import CompiledProgram, first_error, generate, make_unit
from urscript.errors import CompileError, RuntimeFault
from urscript.parser import normalize, parse_statements
from urscript.syntax import Assign, If, Name, Program, Statement, While
from urscript.values import Value
from urscript.work import Steps

STATEMENT_FILE = "<statement>"
"""The file name of interpreted code in tracebacks: its lines are not lines of the program."""


class Locals(dict[str, Value]):
    """The variables of a scope in which statements are interpreted. A declared name without a value has no item.

    declared: the names that interpreted statements added.
    """

    def __init__(self, names: Iterable[str] = (), values: Mapping[str, Value] | None = None) -> None:
        super().__init__(values or {})
        self.own = frozenset(names)
        self.declared: frozenset[str] = frozenset()

    def __missing__(self, name: str) -> Value:
        raise RuntimeFault(f"Variable '{name}' is used before it has a value")

    def declare(self, names: Iterable[str]) -> None:
        """Add names to the scope."""
        self.declared |= frozenset(names) - self.own

    def remove(self, names: Iterable[str]) -> None:
        """Remove declared names with their values."""
        for name in self.declared.intersection(names):
            self.pop(name, None)
        self.declared -= frozenset(names)


@dataclass(frozen=True, slots=True, eq=False)
class CompiledStatement:
    """The compiled statements of one line, ready to be linked into a program."""

    code: tuple[CodeType, ...]
    functions: Mapping[str, FunctionPlan]  # the ones they define
    names: frozenset[str]  # the ones they declare
    builtins: Mapping[str, Builtin]  # the ones they call
    calls: frozenset[str]  # functions called by the statements themselves


def compile_statement(
    text: str, program: CompiledProgram, functions: Mapping[str, FunctionPlan], scope: Locals, serial: int
) -> Steps[CompiledStatement]:
    """Compile a line of statements for a scope of a running program.

    functions: all functions that can be called. serial: a different number for each call, for the symbols of new
    functions. A statement cannot itself interpret statements. Raises CompileError.
    """
    source = normalize(text)
    try:
        tree = yield from parse_statements(source)
        _check_globals(tree, program, source)
        names = tree.scope.locals | (tree.scope.assigned - set(program.global_names))
        tree.globals = dict.fromkeys(program.global_names)
        tree.scope.locals |= scope.own | scope.declared
        available = program.libraries.available(program.version)
        builtins = {name: builtin for name, builtin in available.items() if not builtin.takes_scope}
        plans = yield from plan_functions(tree, builtins, functions, prefix=f"f{serial}")
        unit = make_unit(tree, source, program.libraries, builtins, {**functions, **plans}, program.version)
        defined = [compile_function(unit, tree.functions[name], plans[name], lasting=False) for name in plans]
        code = yield from generate(unit, [*defined, compile_interpreted(unit)], STATEMENT_FILE)
        if (error_found := (yield from first_error(unit))) is not None:
            raise error_found
    except RecursionError as error:
        raise CompileError.syntax("the statement is nested too deeply", 1, 1, source) from error
    return CompiledStatement(
        code=tuple(code),
        functions=plans,
        names=frozenset(names),
        builtins=unit.used,
        calls=frozenset(call.name for call in tree.scope.calls),
    )


def _check_globals(tree: Program, program: CompiledProgram, source: str) -> None:
    """Raise CompileError for a global that the program does not have."""
    new = [name for name in tree.globals if name not in program.global_names]
    if new:
        line, column = _first_assignment(new[0], tree)
        message = f"interpreted statements cannot declare a new global such as '{new[0]}'"
        raise CompileError.name_not_found(new[0], message, line, column, source)


def _first_assignment(name: str, tree: Program) -> tuple[int, int]:
    blocks: list[list[Statement]] = [tree.body, *(function.body for function in tree.functions.values())]
    for block in blocks:
        for statement in block:
            if isinstance(statement, Assign):
                if isinstance(statement.target, Name) and statement.target.name == name:
                    return statement.line, statement.column
            elif isinstance(statement, If):
                blocks += [*(body for _, body in statement.branches), statement.otherwise]
            elif isinstance(statement, While):
                blocks.append(statement.body)
    return 1, 1
