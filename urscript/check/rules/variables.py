"""Rules on names and texts: unused names, variables without a value, globals whose type changes, escapes."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from urscript.check.rules.registry import body_rule, declare, rule
from urscript.check.subject import Body, Subject, inner, names, own_expressions
from urscript.inference import BOOL, NUMBER, STRING, KindSet, is_local, is_number, is_vector
from urscript.literals import ESCAPE, SENDING
from urscript.syntax import (
    Assign,
    Call,
    Constant,
    FunctionDef,
    If,
    Name,
    Node,
    Return,
    Statement,
    While,
    Word,
    all_statements,
    blocks,
)

_TYPES: Final = ((NUMBER, "a number"), (BOOL, "a bool"), (STRING, "a text"))
_ANYTHING: Final[set[str]] = set()
_MOST_VARIABLES: Final = 300  # of a body that is followed path by path: the work grows with their square

UNUSED_INCLUDE: Final = "URS205"

_INTERPRETING = "interpret_escape"  # the argument of socket_read_string that makes it look for escapes


declare(UNUSED_INCLUDE, "unused-include", "no program of a project uses what a URCap or an included file defines")


@rule("URS201", "unused-function")
def unused_functions(subject: Subject) -> Iterator[tuple[Body, Node, str]]:
    """a function or thread is never used"""
    if not subject.complete or subject.by_polyscope or subject.unit.errors:  # an unknown name may be meant for it
        return
    for body in subject.bodies:
        if body.function is not None and subject.words[body.scope.name] == 1:
            kind = "thread" if body.scope.is_thread else "function"
            yield body, body.function, f"{kind} '{body.scope.name}' is never used"


@rule("URS202", "unused-variable")
def unused_variables(subject: Subject) -> Iterator[tuple[Body, Node, str]]:
    """a local variable is assigned and never read"""
    if subject.by_polyscope:
        return
    stores = Counter(name for _, name, _ in subject.assignments)
    seen: set[str] = set()
    for body, name, statement in subject.assignments:
        if subject.words[name] != stores[name] or name in seen or body.function is None:
            continue
        local = is_local(subject.unit.program, body.scope, name)
        if local and not any(isinstance(node, Call) for node in inner([statement.value])):
            seen.add(name)
            yield body, statement, f"variable '{name}' is never read"


@rule("URS203", "type-change")
def type_changes(subject: Subject) -> Iterator[tuple[Body, Node, str]]:
    """a global variable is assigned values of different types: it keeps the type of its first one"""
    kinds, program = subject.unit.kinds, subject.unit.program
    first: dict[str, str] = {}
    for body, name, statement in subject.assignments:
        if name not in program.globals or is_local(program, body.scope, name):
            continue
        found = type_in_words(kinds.expression(body.scope, statement.value))
        if found and first.setdefault(name, found) != found:
            yield body, statement, f"'{name}' is {first[name]} elsewhere: a global keeps its type, and this is {found}"


def type_in_words(kind: KindSet) -> str:
    """The type of a value, such as "a number"; empty if it may have several."""
    if is_number(kind):
        return _TYPES[0][1]
    if is_vector(kind):
        return "a list or pose"
    return next((text for single, text in _TYPES if kind == single), "")


@body_rule("URS204", "unset-variable")
def unset_variables(subject: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a local variable is read that has no value on a path through its function"""
    if body.function is None:
        return
    related: dict[str, set[str]] = {}
    for statement in _outer_ifs(body.statements):
        inside = _assigned(blocks(statement))
        for name in inside:  # what two of them assign, they may well assign in all cases
            related[name] = _ANYTHING if name in related else inside | _conditions(statement)
    parameters = {parameter.name for parameter in body.scope.parameters}
    for name in parameters & set(related):
        del related[name]
    local = {
        name: others
        for name, others in related.items()
        if others is not _ANYTHING and is_local(subject.unit.program, body.scope, name)
    }
    if len(local) <= _MOST_VARIABLES:
        yield from _Paths(local).run(body.statements)


def _outer_ifs(statements: Sequence[Statement]) -> Iterator[If]:
    """Every if that is not inside another one."""
    for statement in statements:
        if isinstance(statement, If):
            yield statement
        elif isinstance(statement, While):
            yield from _outer_ifs(statement.body)


def _conditions(statement: If) -> set[str]:
    """The variables in the conditions of an if, and of those inside it."""
    return names(c for s in all_statements([statement]) if isinstance(s, If) for c, _ in s.branches)


def _assigned(parts: Sequence[Sequence[Statement]]) -> set[str]:
    """The variables that some blocks assign."""
    found = (s.target for block in parts for s in all_statements(block) if isinstance(s, Assign))
    return {target.name for target in found if isinstance(target, Name)}


class _Paths:
    """Follows the paths through a body, with the variables that may have no value.

    related: for each variable that a branch assigns, those that tell whether it was taken. What is read in a branch
    that depends on one of them has a value. A loop is taken to run at least once.
    """

    def __init__(self, related: Mapping[str, set[str]]) -> None:
        self._related = dict(related)
        self._found: list[tuple[Node, str]] = []

    def run(self, statements: Sequence[Statement]) -> list[tuple[Node, str]]:
        """The places where a variable may be read without a value."""
        if self._related:
            self._follow(statements, set(), frozenset())
        return self._found

    def _follow(self, statements: Sequence[Statement], given: set[str], guards: frozenset[str]) -> set[str] | None:
        """The variables with a value after some statements; None if nothing comes after them."""
        for statement in statements:
            if isinstance(statement, FunctionDef):
                continue
            self._read(statement, given, guards)
            match statement:
                case Assign(target=Name(name=name)):
                    given.add(name)
                case Return() | Word(word="halt" | "break" | "continue"):
                    return None
                case If():
                    inner_guards = guards | names(own_expressions(statement))
                    after = [self._follow(block, given.copy(), inner_guards) for block in blocks(statement)]
                    reached = [found for found in after if found is not None]
                    if not reached:
                        return None
                    given = set.intersection(*reached)
                case While():
                    inner_guards = guards | names([statement.condition])
                    after_loop = self._follow(statement.body, given.copy(), inner_guards)
                    given = after_loop if after_loop is not None else given | _assigned([statement.body])
        return given

    def _read(self, statement: Statement, given: set[str], guards: frozenset[str]) -> None:
        for node in inner(own_expressions(statement)):
            name = node.name if isinstance(node, Name) else ""
            if name in self._related and name not in given and not self._related[name] & guards:
                del self._related[name]
                self._found.append((node, f"'{name}' has no value here on at least one path"))


@body_rule("URS107", "shown-escape")
def escapes(_: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a text that is shown or kept contains \\n, \\r or \\t: the backslash and the letter stay in it"""
    for statement in all_statements(body.statements):
        skipped: set[int] = set()
        for node in inner(own_expressions(statement)):
            if isinstance(node, Call) and (
                node.name in SENDING or any(name == _INTERPRETING for name, _ in node.keywords)
            ):
                skipped.update(id(part) for part in inner([node]))
            text = node.value if isinstance(node, Constant) and id(node) not in skipped else None
            if isinstance(text, str) and ESCAPE.search(text):
                yield node, "URScript has no escapes: the backslash and the letter after it stay in the text"
