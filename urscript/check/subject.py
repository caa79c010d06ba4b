"""A program as the rules see it, and ways through its syntax tree."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

from urscript.compile_expressions import Unit
from urscript.syntax import (
    Assign,
    Call,
    Constant,
    Expression,
    ExpressionStatement,
    FunctionDef,
    If,
    MethodCall,
    Name,
    Return,
    Scope,
    Statement,
    ThreadControl,
    While,
    Word,
    all_statements,
    blocks,
    parts,
)

END, BREAK, LEAVE = "end", "break", "leave"  # how a pass of a loop may end without having taken time

_ROUNDS: Final = 30  # calls within calls that are followed where functions call each other
_LABEL: Final = re.compile(r'^\s*\$ \d+ "', re.MULTILINE)


class Body(NamedTuple):
    """The statements of the program itself, or of a def or thread."""

    scope: Scope
    statements: list[Statement]
    function: FunctionDef | None = None

    @property
    def lines_before(self) -> int:
        """By how many the lines of its nodes are too small."""
        return self.function.lines_before if self.function else 0

    @property
    def loops(self) -> Iterator[While]:
        """Every loop in it."""
        if self.scope.loops:
            yield from (statement for statement in all_statements(self.statements) if isinstance(statement, While))


@dataclass
class Subject:
    """A program that the compiler could read. complete: nothing outside the program calls its functions."""

    unit: Unit
    complete: bool

    @cached_property
    def bodies(self) -> list[Body]:
        """The program itself, and every def and thread."""
        program = self.unit.program
        inner = (Body(function.scope, function.body, function) for function in program.functions.values())
        return [Body(program.scope, program.body), *inner]

    @cached_property
    def assignments(self) -> list[tuple[Body, str, Assign]]:
        """Every assignment to a variable, with its name."""
        return [
            (body, statement.target.name, statement)
            for body in self.bodies
            for statement in all_statements(body.statements)
            if isinstance(statement, Assign) and isinstance(statement.target, Name)
        ]

    @property
    def words(self) -> Counter[str]:
        """How often each name occurs outside strings and comments."""
        return self.unit.program.words

    @cached_property
    def by_polyscope(self) -> bool:
        """Whether PolyScope wrote the program."""
        return by_polyscope(self.unit.source)

    @cached_property
    def timing(self) -> "Timing":
        """Which of its functions surely take time."""
        return Timing(self.unit)

    def value(self, body: Body, node: Expression) -> Expression:
        """The value of a global that is assigned only once; any other expression unchanged."""
        if isinstance(node, Name) and node.name not in body.scope.locals:
            return self.unit.kinds.constants.get(node.name, node)
        return node


class Timing:
    """Which statements surely take time.

    functions: whether a call of each function of the program does; one whose answer depends on itself is taken to.
    """

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        own = unit.program.functions
        self.functions = dict.fromkeys((name for name in unit.plans if name in own), True)  # callees come first
        for _ in range(_ROUNDS):
            quick = 0
            for name, takes in self.functions.items():
                if takes and self._may_be_idle(own[name]):
                    self.functions[name] = False
                    quick += 1
            if not quick:
                break

    def _may_be_idle(self, function: FunctionDef) -> bool:
        """Whether a function may end without having taken time; kept as long as the functions that it calls say so."""
        facts = [self._call_takes(call.name) for call in function.scope.calls]
        found = function.kept.found if function.kept else {}
        key = "idle", self._unit.version, id(function.scope)
        if found.get(key, ((), None))[0] != facts:
            found[key] = facts, bool(self.idle(function.body))
        idle: bool = found[key][1]
        return idle

    def takes(self, nodes: Iterable[Expression]) -> bool:
        """Whether evaluating some expressions takes time; what is not known is taken to."""
        return any(
            isinstance(node, MethodCall) or (isinstance(node, Call) and self._call_takes(node.name))
            for node in inner(nodes)
        )

    def _call_takes(self, name: str) -> bool:
        if name in self._unit.plans:
            return self.functions.get(name, True)
        builtin = self._unit.builtins.get(name)
        return builtin is None or builtin.takes_time

    def idle(self, statements: Sequence[Statement]) -> set[str]:
        """How a pass through some statements may end without having taken time; empty if it cannot."""
        found: set[str] = set()
        for statement in statements:
            match statement:
                case FunctionDef():
                    continue
                case Word(word="break"):
                    return found | {BREAK}
                case Word(word="continue"):
                    return found | {END}
                case Word(word="halt"):
                    return found | {LEAVE}
                case ThreadControl(word="join"):
                    return found
            evaluated = own_expressions(statement)
            if self.takes(evaluated[:1] if isinstance(statement, If) else evaluated):
                return found
            match statement:
                case Return():
                    return found | {LEAVE}
                case If():
                    ends = set[str]().union(*map(self.idle, blocks(statement)))
                    found |= ends - {END}
                    if END not in ends:
                        return found
                case While():
                    ends = self.idle(statement.body)
                    found |= ends & {LEAVE}
                    if is_true(statement.condition) and BREAK not in ends:
                        return found
        return found | {END}


def by_polyscope(text: str) -> bool:
    """Whether PolyScope wrote a program, which then has labels, and whatever the installation defines."""
    return _LABEL.search(text) is not None


def own_expressions(statement: Statement) -> list[Expression]:
    """The expressions of a statement, without those of the statements inside it."""
    match statement:
        case Assign():
            return [statement.value] if isinstance(statement.target, Name) else [statement.target, statement.value]
        case ExpressionStatement():
            return [statement.value]
        case If():
            return [condition for condition, _ in statement.branches]
        case While():
            return [statement.condition]
        case Return():
            return [] if statement.value is None else [statement.value]
        case ThreadControl():
            return [statement.handle]
    return []


def inner(expressions: Iterable[Expression]) -> Iterator[Expression]:
    """Expressions and the expressions inside them."""
    waiting = [*expressions]
    while waiting:
        node = waiting.pop()
        yield node
        for group in parts(node):
            waiting += group


def calls(statement: Statement) -> Iterator[Call]:
    """The calls in a statement's own expressions."""
    return (node for node in inner(own_expressions(statement)) if isinstance(node, Call))


def names(expressions: Iterable[Expression]) -> set[str]:
    """The variables in some expressions."""
    return {node.name for node in inner(expressions) if isinstance(node, Name)}


def argument(call: Call, position: int, name: str) -> Expression | None:
    """An argument of a call by its position or its name."""
    if position < len(call.arguments):
        return call.arguments[position]
    return next((value for key, value in call.keywords if key == name), None)


def is_true(node: Expression | None) -> bool:
    """Whether an expression is the literal True."""
    return isinstance(node, Constant) and node.value is True
