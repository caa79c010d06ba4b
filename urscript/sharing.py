"""Lists that only one variable can refer to: their elements are written in place without a test."""

from collections.abc import Iterator

from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Expression,
    ExpressionStatement,
    FunctionDef,
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
    parts,
)

_MAKER = "make_list"
_LENGTHS = frozenset(["length", "get_list_length"])
KEEPING_NOTHING = _LENGTHS | {_MAKER}
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
    for statement in _statements(body):
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
            case Call(arguments=[Name()], keywords=[]) if node.name in _LENGTHS:
                pass
            case _:
                alone, row = parts(node)
                expressions += [*alone, *row]
    return assigned - shared


def _is_new(value: Expression) -> bool:
    """Whether the value, if it is a list, is made when the expression is evaluated."""
    return isinstance(value, (ListLiteral, NumberList, Binary)) or (isinstance(value, Call) and value.name == _MAKER)


def _statements(body: list[Statement]) -> Iterator[Statement]:
    """All statements of a body and its blocks, without those of nested functions."""
    waiting = [*body]
    while waiting:
        statement = waiting.pop()
        if isinstance(statement, FunctionDef):
            continue
        yield statement
        if isinstance(statement, If):
            waiting += [*statement.otherwise, *(inner for _, block in statement.branches for inner in block)]
        elif isinstance(statement, While):
            waiting += statement.body
