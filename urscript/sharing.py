"""Lists that only one variable can refer to: their elements are written in place without a test."""

from urscript.inference import LIST_LENGTHS, LIST_MAKER
from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Expression,
    ExpressionStatement,
    If,
    Index,
    ListLiteral,
    Name,
    NumberList,
    Return,
    Scope,
    Statement,
    ThreadControl,
    While,
    all_statements,
    parts,
)

KEEPING_NOTHING = LIST_LENGTHS | {LIST_MAKER}
"""The built-ins known here: they return a new list, or do not keep one that is passed to them."""


def unshared_lists(scope: Scope, body: list[Statement]) -> set[str]:
    """The variables of a body whose lists nothing else can refer to while the body is executed.

    Each value assigned to them is made there, and only their elements and their length are read, except to return the
    whole list. That the names are local variables which can only be lists, and that the program does not define
    functions with the names of the built-ins, is for the caller to check.
    """
    assigned: set[str] = set()
    shared = {parameter.name for parameter in scope.parameters}
    expressions: list[Expression] = []
    for statement in all_statements(body):
        match statement:
            case Assign(target=Name(name=name), value=value):
                assigned.add(name)
                if not _is_new(value):
                    shared.add(name)
                expressions.append(value)
            case Assign(target=target, value=value):
                expressions += [target, value]
            case If():
                expressions += [condition for condition, _ in statement.branches]
            case While():
                expressions.append(statement.condition)
            case ExpressionStatement():
                expressions.append(statement.value)
            case Return(value=value) if value is not None and not isinstance(value, Name):
                expressions.append(value)
            case ThreadControl():
                expressions.append(statement.handle)
    while expressions:
        node = expressions.pop()
        match node:
            case Name():
                shared.add(node.name)
            case Index(target=Name()):
                expressions += node.positions
            case Call(arguments=[Name()], keywords=[]) if node.name in LIST_LENGTHS:
                pass
            case _:
                alone, row = parts(node)
                expressions += [*alone, *row]
    return assigned - shared


def _is_new(value: Expression) -> bool:
    """Whether the value, if it is a list, is made when the expression is evaluated."""
    if isinstance(value, Call):
        return value.name == LIST_MAKER
    return isinstance(value, (ListLiteral, NumberList, Binary))
