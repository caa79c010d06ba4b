"""Rules on names: unused ones, variables without a value, globals whose type changes."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from urscript.check.rules.registry import declare, rule
from urscript.check.subject import Subject, blocks, inner, nested, own_expressions
from urscript.inference import BOOL, NUMBER, STRING, KindSet, is_local, is_number, is_vector
from urscript.syntax import Assign, Call, FunctionDef, If, Name, Node, Return, Statement, While, Word

_TYPES: Final = ((NUMBER, "a number"), (BOOL, "a bool"), (STRING, "a text"))
_MOST_VARIABLES: Final = 300  # of a body that is followed path by path: the work grows with their square

UNUSED_INCLUDE: Final = "URS205"
declare(UNUSED_INCLUDE, "unused-include", "no program of a project uses what a URCap or an included file defines")


@rule("URS201", "unused-function")
def unused_functions(subject: Subject) -> Iterator[tuple[Node, str]]:
    """a function or thread is never used"""
    if not subject.complete or subject.by_polyscope:
        return
    for name, function in subject.unit.program.functions.items():
        if subject.words[name] == 1:
            kind = "thread" if function.scope.is_thread else "function"
            yield function, f"{kind} '{name}' is never used"


@rule("URS202", "unused-variable")
def unused_variables(subject: Subject) -> Iterator[tuple[Node, str]]:
    """a local variable is assigned and never read"""
    if subject.by_polyscope:
        return
    program = subject.unit.program
    assigned = [
        (body.scope, statement)
        for body in subject.bodies
        for statement in nested(body.statements)
        if isinstance(statement, Assign) and isinstance(statement.target, Name)
    ]
    stores = Counter(statement.target.name for _, statement in assigned if isinstance(statement.target, Name))
    seen: set[str] = set()
    for scope, statement in assigned:
        name = statement.target.name if isinstance(statement.target, Name) else ""
        if subject.words[name] != stores[name] or name in seen or scope is program.scope:
            continue
        if is_local(program, scope, name) and not any(isinstance(node, Call) for node in inner([statement.value])):
            seen.add(name)
            yield statement, f"variable '{name}' is never read"


@rule("URS203", "type-change")
def type_changes(subject: Subject) -> Iterator[tuple[Node, str]]:
    """a global variable is assigned values of different types: it keeps the type of its first one"""
    kinds, program = subject.unit.kinds, subject.unit.program
    first: dict[str, str] = {}
    for body in subject.bodies:
        for statement in nested(body.statements):
            if not isinstance(statement, Assign) or not isinstance(statement.target, Name):
                continue
            name = statement.target.name
            if name not in program.globals or is_local(program, body.scope, name):
                continue
            found = _type(kinds.expression(body.scope, statement.value))
            if found and first.setdefault(name, found) != found:
                yield statement, f"'{name}' is {first[name]} elsewhere: a global keeps its type, and this is {found}"


def _type(kind: KindSet) -> str:
    """The type of a value in words; empty if it may have several."""
    if is_number(kind):
        return _TYPES[0][1]
    if is_vector(kind):
        return "a list or pose"
    return next((text for single, text in _TYPES if kind == single), "")


@rule("URS204", "unset-variable")
def unset_variables(subject: Subject) -> Iterator[tuple[Node, str]]:
    """a local variable is read that has no value on a path through its function"""
    program = subject.unit.program
    for body in subject.bodies[1:]:
        local = {name for name in body.scope.assigned | body.scope.locals if is_local(program, body.scope, name)}
        local -= {parameter.name for parameter in body.scope.parameters}
        local &= {
            name for s in nested(body.statements) if isinstance(s, If) for b in blocks(s) for name in _assigned(b)
        }
        if local and len(local) <= _MOST_VARIABLES:
            yield from _Paths(local).run(body.statements)


class _Paths:
    """Follows the paths through a body, with the variables that surely have a value.

    A loop is taken to run at least once. Of branches, only those count whose variables the others do set.
    """

    def __init__(self, local: set[str]) -> None:
        self._local = local
        self._reported: set[str] = set()
        self._found: list[tuple[Node, str]] = []

    def run(self, statements: Sequence[Statement]) -> list[tuple[Node, str]]:
        """The places where a variable may be read without a value."""
        self._follow(statements, set())
        return self._found

    def _follow(self, statements: Sequence[Statement], given: set[str]) -> set[str] | None:
        """The variables with a value after some statements; None if nothing comes after them."""
        for statement in statements:
            if isinstance(statement, FunctionDef):
                continue
            self._read(statement, given)
            match statement:
                case Assign(target=Name(name=name)):
                    given.add(name)
                case Return() | Word(word="halt" | "break" | "continue"):
                    return None
                case If():
                    after = [self._follow(block, given.copy()) for _, block in statement.branches]
                    after.append(self._follow(statement.otherwise, given.copy()))
                    reached = [names for names in after if names is not None]
                    if not reached:
                        return None
                    given = set.intersection(*reached)
                case While():
                    given = self._follow(statement.body, given.copy()) or given | _assigned(statement.body)
        return given

    def _read(self, statement: Statement, given: set[str]) -> None:
        for node in inner(own_expressions(statement)):
            if isinstance(node, Name) and node.name in self._local - given - self._reported:
                self._reported.add(node.name)
                self._found.append((node, f"'{node.name}' has no value here on at least one path"))


def _assigned(statements: Sequence[Statement]) -> set[str]:
    found = (s.target for s in nested(statements) if isinstance(s, Assign))
    return {target.name for target in found if isinstance(target, Name)}
