"""The syntax tree that the parser creates.

Every node has the line and column (from 1) that an error about it should point at. A `Scope` collects, for the program
body and for each def and thread, the information that later stages need.

Nodes are equal if they mean the same, wherever they are and whatever they cost.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

ProgramKind: TypeAlias = Literal["program", "secondary", "statement"]


@dataclass(slots=True)
class Node:
    line: int = field(compare=False)
    column: int = field(compare=False)


@dataclass(slots=True)
class Constant(Node):
    value: bool | int | float | str | None


@dataclass(slots=True)
class Name(Node):
    name: str


@dataclass(slots=True)
class PoseLiteral(Node):
    items: list["Expression"]


@dataclass(slots=True)
class ListLiteral(Node):
    items: list["Expression"]


@dataclass(slots=True)
class NumberList(Node):
    """A list of number literals so long that no later stage should iterate over it."""

    values: tuple[float, ...]


@dataclass(slots=True)
class Unary(Node):
    operator: str  # - + not
    operand: "Expression"


@dataclass(slots=True)
class Binary(Node):
    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(slots=True)
class Index(Node):
    target: "Expression"
    positions: list["Expression"]  # one, or two for a matrix


@dataclass(slots=True)
class Member(Node):
    target: "Expression"
    name: str


@dataclass(slots=True)
class Call(Node):
    name: str
    arguments: list["Expression"]
    keywords: list[tuple[str, "Expression"]]


@dataclass(slots=True)
class MethodCall(Node):
    target: "Expression"
    name: str
    arguments: list["Expression"]


@dataclass(slots=True)
class Run(Node):
    name: str


Expression: TypeAlias = (
    Constant | Name | PoseLiteral | ListLiteral | NumberList | Unary | Binary | Index | Member | Call | MethodCall | Run
)


def parts(node: Expression) -> tuple[list[Expression], list[Expression]]:
    """The expressions inside an expression: a fixed number of parts, and a sequence of any length."""
    match node:
        case Unary():
            return [node.operand], []
        case Binary():
            return [node.left, node.right], []
        case Index():
            return [node.target, *node.positions], []
        case Member():
            return [node.target], []
        case MethodCall():
            return [node.target], node.arguments
        case PoseLiteral():
            return node.items, []
        case ListLiteral():
            return [], node.items
        case Call():
            by_name = [value for _, value in node.keywords]
            return ([], by_name) if node.name == "struct" and not node.arguments else (by_name, node.arguments)
    return [], []


@dataclass(slots=True)
class Assign(Node):
    target: Name | Index | Member
    value: Expression
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class ExpressionStatement(Node):
    value: Expression
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class If(Node):
    branches: list[tuple[Expression, list["Statement"]]]
    otherwise: list["Statement"]
    cost: int = field(default=0, compare=False)
    own_cost: int = field(default=0, compare=False)  # without the loops


@dataclass(slots=True)
class While(Node):
    condition: Expression
    body: list["Statement"]
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class Return(Node):
    value: Expression | None
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class Word(Node):
    """A statement of a single keyword: break, continue, halt, enter_critical, exit_critical."""

    word: str
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class ThreadControl(Node):
    """``join handle`` and ``kill handle``."""

    word: str
    handle: Expression
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class Label(Node):
    number: int
    text: str
    option: str  # "", "breakAfter", "noBreak"
    cost: int = field(default=0, compare=False)


@dataclass(slots=True)
class Parameter(Node):
    name: str
    default: Expression | None


@dataclass(slots=True)
class Scope:
    """The names a body uses and properties of its statements. Nested defs and threads have their own scopes."""

    name: str
    is_thread: bool = False
    parameters: list[Parameter] = field(default_factory=list)
    locals: set[str] = field(default_factory=set)  # parameters, and names declared local
    assigned: set[str] = field(default_factory=set)  # names assigned without a declaration
    calls: list[Call] = field(default_factory=list)
    methods: list[MethodCall] = field(default_factory=list)
    loops: bool = False
    waits: bool = False  # contains a join, a label or a method call
    cost: int = field(default=0, compare=False)


@dataclass(slots=True, eq=False)
class Kept:
    """What is known of a text that was parsed on its own, for as long as the text is kept (`urscript.blocks`).

    words: how often each name occurs in it. found: problems of its defs; see `urscript.dependencies`.
    """

    words: Counter[str]
    found: dict[Any, Any] = field(default_factory=dict)


@dataclass(slots=True)
class FunctionDef(Node):
    """A def or thread. lines_before: by how many its lines, and those of all nodes in it, are too small in a program
    into which it was put after it had been parsed; kept: with what."""

    scope: Scope
    body: list["Statement"]
    cost: int = field(default=0, compare=False)
    lines_before: int = field(default=0, compare=False)
    kept: Kept | None = field(default=None, compare=False)


Statement: TypeAlias = Assign | ExpressionStatement | If | While | Return | Word | ThreadControl | Label | FunctionDef


def blocks(statement: Statement) -> list[list[Statement]]:
    """The blocks directly inside a statement."""
    match statement:
        case If():
            return [*(block for _, block in statement.branches), statement.otherwise]
        case While():
            return [statement.body]
    return []


def all_statements(body: Iterable[Statement]) -> Iterator[Statement]:
    """Statements and those in their blocks, in the order of the text; without nested functions."""
    waiting = [*body][::-1]
    while waiting:
        statement = waiting.pop()
        if isinstance(statement, FunctionDef):
            continue
        yield statement
        if isinstance(statement, If | While):
            for block in reversed(blocks(statement)):
                waiting += reversed(block)


@dataclass(slots=True)
class Program:
    kind: ProgramKind
    name: str
    body: list[Statement]
    scope: Scope
    functions: dict[str, FunctionDef]  # every def and thread of the text, at any depth
    globals: dict[str, None]  # in order of appearance
    labels: list[Label]
    damaged: set[str]  # names in text that did not parse
    blocks: list[list[Statement]]  # all lists of statements, for `urscript.parser.discard`
    scopes: list[Scope]
    words: Counter[str] = field(default_factory=Counter)  # if `urscript.blocks` read it: how often each name occurs
