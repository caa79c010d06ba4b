"""A program as the rules see it, and ways through its syntax tree."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
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
    If,
    Name,
    Return,
    Scope,
    Statement,
    ThreadControl,
    While,
    all_statements,
    parts,
)

_WORD: Final = re.compile(r'"[^"]*"|#[^\n]*|([A-Za-z_]\w*)')
_LABEL: Final = re.compile(r'^\s*\$ \d+ "', re.MULTILINE)


class Body(NamedTuple):
    """The statements of the program itself, or of a def or thread."""

    scope: Scope
    statements: list[Statement]


@dataclass
class Subject:
    """A program that the compiler could read. complete: nothing outside the program calls its functions."""

    unit: Unit
    complete: bool

    @cached_property
    def bodies(self) -> list[Body]:
        """The program itself, and every def and thread."""
        program = self.unit.program
        inner = (Body(function.scope, function.body) for function in program.functions.values())
        return [Body(program.scope, program.body), *inner]

    @cached_property
    def loops(self) -> list[tuple[Body, While]]:
        """Every loop, with the body it is in."""
        return [
            (body, statement)
            for body in self.bodies
            if body.scope.loops
            for statement in all_statements(body.statements)
            if isinstance(statement, While)
        ]

    @cached_property
    def words(self) -> Counter[str]:
        """How often each name occurs outside strings and comments."""
        return Counter(filter(None, _WORD.findall(self.unit.source)))

    @cached_property
    def by_polyscope(self) -> bool:
        """Whether PolyScope wrote the program."""
        return by_polyscope(self.unit.source)

    def value(self, body: Body, node: Expression) -> Expression:
        """The value of a global that is assigned only once; any other expression unchanged."""
        if isinstance(node, Name) and node.name not in body.scope.locals:
            return self.unit.kinds.constants.get(node.name, node)
        return node


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
