"""Infer which expressions can only be numbers, bools or strings, so that they compile to plain Python.

Arithmetic then needs no calls, conditions no test of their type, and built-ins no check of their arguments.

A variable is a number when every value that the program assigns to it is a number, and likewise a bool, a string, a
vector (a list of numbers, or a pose) or a list of values of one kind. Assigned values may themselves be variables, so
all assignments are evaluated repeatedly until nothing changes. Expressions of unknown kind are left to the operators,
which check the values at run time.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from urscript.arguments import BindingError, Slot, bind_arguments
from urscript.builtins import Builtin
from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Constant,
    Expression,
    If,
    Index,
    ListLiteral,
    Member,
    Name,
    NumberList,
    PoseLiteral,
    Program,
    Return,
    Run,
    Scope,
    Statement,
    Unary,
    While,
    all_statements,
)
from urscript.values import Pose
from urscript.work import Steps, release

KindSet: TypeAlias = int
"""The kinds a value may have: a sum of those below; 0 when no value is known."""

INT: Final = 1
FLOAT: Final = 2
VECTOR: Final = 4
"""A pose, or a list of numbers."""
BOOL: Final = 8
STRING: Final = 16
OTHER: Final = 32
INTS: Final = 64
"""A list of ints, and likewise below."""
FLOATS: Final = 128
BOOLS: Final = 256
NUMBER: Final = INT | FLOAT
LISTS: Final = INTS | FLOATS | BOOLS
ANYTHING: Final = NUMBER | VECTOR | BOOL | STRING | OTHER | LISTS

_VECTORS: Final = VECTOR | INTS | FLOATS
_ELEMENTS: Final = ((VECTOR, NUMBER), (INTS, INT), (FLOATS, FLOAT), (BOOLS, BOOL))
_LISTS_OF: Final = ((INT, INTS), (FLOAT, FLOATS), (BOOL, BOOLS))

Variable: TypeAlias = tuple[str, str]  # scope and name; the scope of globals is "", that of results "return"
GLOBAL: Final = ""
RESULT: Final = "return"

_INTERPRETER: Final = "interpreter_mode"
_LIST_MAKER: Final = "make_list"

_ARITHMETIC: Final = frozenset(["+", "-", "*", "/", "%"])
_KIND_OF_CLASS: Final[dict[Any, KindSet]] = {int: INT, float: FLOAT, bool: BOOL, str: STRING}
_KIND_OF_RESULT: Final[tuple[tuple[Any, KindSet], ...]] = (  # by annotation; an int also satisfies the annotation float
    (int, INT),
    (float, NUMBER),
    (Pose, VECTOR),
    (list[float], VECTOR),
    (list[int], VECTOR),
    (bool, BOOL),
    (str, STRING),
)
_SETTLED: Final = (Constant, PoseLiteral, NumberList, Run)  # expressions whose kind no variable changes
_SLICE: Final = 40  # work between two yields
_MAX_ROUNDS: Final = 8
"""Rounds after which inference gives up and every variable may have any kind. Programs need two to four; only a text
designed to need more reaches the limit."""
_LONG_LIST: Final = 500  # items from which a list is not examined: each item takes a microsecond
_SCOPE_WORK: Final = 12  # per body, however short
_WORK: Final = 2  # per store or call that is found
_RELEASE_WORK: Final = 20  # to free a hundred stores or kinds
_NO_SCOPE: Final = Scope("")  # where the defaults of parameters are evaluated


def is_number(kind: KindSet) -> bool:
    """True for values that can only be numbers."""
    return 0 < kind <= NUMBER


def is_local(program: Program, scope: Scope, name: str) -> bool:
    """True for parameters, names declared local, and names only ever assigned in this scope."""
    return name in scope.locals or (name in scope.assigned and name not in program.globals)


def is_plain(kind: KindSet) -> bool:
    """True for values that can only be numbers, only bools, or only strings."""
    return is_number(kind) or kind in (BOOL, STRING)


def is_ordered(kind: KindSet) -> bool:
    """True for values that can only be numbers or bools."""
    return kind > 0 and not kind & ~(NUMBER | BOOL)


def is_vector(kind: KindSet) -> bool:
    """True for values that can only be poses and lists of numbers."""
    return kind > 0 and not kind & ~_VECTORS


def is_list(kind: KindSet) -> bool:
    """True for values that can only be poses and lists."""
    return kind > 0 and not kind & ~(VECTOR | LISTS)


def element_kind(kind: KindSet) -> KindSet:
    """The kinds that an element of a value may have."""
    if kind & ~(VECTOR | LISTS):
        return ANYTHING
    found = 0
    for lists, element in _ELEMENTS:
        if kind & lists:
            found |= element
    return found


def _list_of(kind: KindSet) -> KindSet:
    """The kinds that a list of values of these kinds may have."""
    if not kind:
        return 0
    return OTHER if kind & ~(NUMBER | BOOL) else sum(lists for element, lists in _LISTS_OF if kind & element)


class Kinds:
    """The possible kinds of the variables and expressions of a program. An empty instance knows only literals.

    constants: the values of global variables that are assigned only once in the whole program.
    """

    def __init__(
        self,
        program: Program,
        builtins: Mapping[str, Builtin],
        variables: dict[Variable, KindSet],
        constants: Mapping[str, Expression] = MappingProxyType({}),
    ) -> None:
        self.constants = constants
        self._program = program
        self._builtins = builtins
        self._variables = variables

    def discard(self) -> Steps[None]:
        """Free all results, in steps, when they are no longer needed."""
        yield from release(self._variables, _RELEASE_WORK)

    def variable(self, scope: Scope, name: str) -> KindSet:
        """The kinds a variable may have once a value was assigned to it."""
        return self._variables.get(_variable(self._program, scope, name), 0)

    def known(self, scope: str, name: str) -> KindSet:
        """Likewise, of a variable that is local to the scope of this name, of a `GLOBAL`, or of a `RESULT`."""
        return self._variables.get((scope, name), 0)

    def expression(self, scope: Scope, node: Expression) -> KindSet:
        """The kinds an expression may have."""
        match node:
            case Constant():
                return _KIND_OF_CLASS.get(node.value.__class__, OTHER)
            case Name():
                return self.variable(scope, node.name)
            case Binary() if node.operator in _ARITHMETIC:
                return arithmetic(node.operator, self.expression(scope, node.left), self.expression(scope, node.right))
            case Unary() if node.operator != "not":
                return self.expression(scope, node.operand)
            case Call():
                return self._result(scope, node)
            case Run():
                return INT
            case PoseLiteral() | NumberList():
                return VECTOR
            case ListLiteral():
                return self._list(scope, node)
            case Index() if len(node.positions) == 1:
                return element_kind(self.expression(scope, node.target))
            case Binary() | Unary():
                return BOOL
        return ANYTHING

    def _list(self, scope: Scope, node: ListLiteral) -> KindSet:
        if len(node.items) > _LONG_LIST:
            return ANYTHING
        kinds = [self.expression(scope, item) for item in node.items]
        if not all(kinds):
            return 0
        if len(set(kinds)) == 1 and kinds[0] in (INT, FLOAT, BOOL):
            return _list_of(kinds[0])
        return VECTOR if all(map(is_number, kinds)) else OTHER

    def _result(self, scope: Scope, node: Call) -> KindSet:
        if node.name in self._program.functions:
            return self._variables.get((RESULT, node.name), 0)
        if node.name == _LIST_MAKER and len(node.arguments) > 1:
            return _list_of(self.expression(scope, node.arguments[1]))
        builtin = self._builtins.get(node.name)
        if builtin is None:
            return ANYTHING
        if builtin.result is float and not builtin.host:  # of a built-in that computes; others may return an int
            return FLOAT
        return _result_kind(builtin.result)


def _result_kind(annotation: Any) -> KindSet:
    """The kinds that a built-in with this return annotation may return."""
    return next((kind for plain, kind in _KIND_OF_RESULT if annotation == plain), ANYTHING)


def arithmetic(operator: str, left: KindSet, right: KindSet) -> KindSet:
    """The kinds an arithmetic operation may result in."""
    if not left or not right:
        return 0
    if left == right == STRING and operator == "+":
        return STRING
    if (left | right) & ~(NUMBER | _VECTORS):
        return ANYTHING
    if is_vector(left) or is_vector(right):
        if (left | right) & VECTOR:
            return VECTOR
        return _list_of(
            arithmetic(operator, *(element_kind(kind) if is_vector(kind) else kind for kind in (left, right)))
        )
    if (left | right) & _VECTORS:
        return ANYTHING
    if operator == "/" or FLOAT in (left, right):
        return FLOAT
    return left | right


class _Store(NamedTuple):
    """A store: an expression assigned to a variable in a scope or, with ``part``, to one of its elements."""

    variable: Variable
    scope: Scope
    value: Expression | None  # None: neither a number nor a vector
    part: bool = False
    work: int = 2  # to evaluate it once

    def kind(self, kinds: Kinds) -> KindSet:
        """The kinds the variable may have because of this store."""
        if self.value is None:
            return OTHER
        kind = kinds.expression(self.scope, self.value)
        return _list_of(kind) if self.part else kind


def infer_kinds(program: Program, builtins: Mapping[str, Builtin]) -> Steps[Kinds]:
    """The kinds of all variables in a program.

    The result is empty when inference would take too long, or when statements sent later can assign to the program's
    variables.
    """
    stores: list[_Store] = []
    kinds = yield from _kinds(program, builtins, stores)
    yield from release(stores, _RELEASE_WORK)
    return kinds


def _kinds(program: Program, builtins: Mapping[str, Builtin], stores: list[_Store]) -> Steps[Kinds]:
    """The kinds of all variables in a program; collects its stores in the given list."""
    for scope, body in ((program.scope, program.body), *((f.scope, f.body) for f in program.functions.values())):
        for number, call in enumerate(scope.calls, 1):
            if call.name == _INTERPRETER:
                return Kinds(program, builtins, {})
            if number % _SLICE == 0:
                yield _SLICE * _WORK
        for number, store in enumerate(_stores(program, scope, body), 1):
            if store is not None:
                stores.append(store)
            if number % _SLICE == 0:
                yield _SLICE * _WORK
        yield _SCOPE_WORK
    constants = yield from _constants(stores)
    variables: dict[Variable, KindSet] = {}
    kinds = Kinds(program, builtins, variables, constants)
    for round_ in range(_MAX_ROUNDS):
        changed, work = False, 0
        for store in stores:
            work += store.work
            if work >= _SLICE:
                yield work
                work = 0
            known = variables.get(store.variable, 0)
            if known == ANYTHING or (round_ and isinstance(store.value, _SETTLED)):
                continue  # it cannot add anything; counted as work, so that compiling takes what it took
            found = known | store.kind(kinds)
            if found != known:
                variables[store.variable] = found
                changed = True
        if not changed:
            return kinds
    return Kinds(program, builtins, {})


def _constants(stores: Sequence[_Store]) -> Steps[dict[str, Expression]]:
    """The values of the global variables that are assigned only once."""
    seen: set[str] = set()
    constants: dict[str, Expression] = {}
    for number, store in enumerate(stores, 1):
        scope, name = store.variable
        if scope == GLOBAL:
            if name in seen or store.part or store.value is None:
                constants.pop(name, None)
            else:
                constants[name] = store.value
            seen.add(name)
        if number % _SLICE == 0:
            yield _SLICE
    return constants


def _stores(program: Program, scope: Scope, body: list[Statement]) -> Iterator[_Store | None]:
    """The stores of a body: to variables, to parameters of functions it calls, and to its own result.

    Yields None for a statement or call without a store, so that the caller can count the work.
    """
    if scope is not program.scope and not _always_returns(body):
        yield _Store((RESULT, scope.name), scope, None)
    for statement in all_statements(body):
        if isinstance(statement, Return):
            yield _Store((RESULT, scope.name), scope, statement.value, work=_work(statement))
        elif isinstance(statement, Assign):
            yield _assignment(program, scope, statement)
        elif not isinstance(statement, (If, While)):
            yield None
    for call in scope.calls:
        if call.name not in program.functions:
            yield None
        else:
            yield from _arguments(program.functions[call.name].scope, scope, call)
    for method in scope.methods:  # a list method rebinds its variable; the new value is not examined
        yield _Store(_variable(program, scope, root(method.target)), scope, None)


def _assignment(program: Program, scope: Scope, statement: Assign) -> _Store:
    target, value = statement.target, statement.value
    variable = _variable(program, scope, root(target))
    if isinstance(target, Name):
        return _Store(variable, scope, value, work=_work(statement))
    simple = isinstance(target, Index) and isinstance(target.target, Name) and len(target.positions) == 1
    return _Store(variable, scope, value if simple else None, part=True, work=_work(statement))


def _work(statement: Assign | Return) -> int:
    """Work to evaluate the value a statement assigns or returns: half a unit per token, apart from long lists."""
    value = statement.value
    if isinstance(value, NumberList) or (isinstance(value, ListLiteral) and len(value.items) > _LONG_LIST):
        return 1
    return 1 + statement.cost // 2


def _arguments(called: Scope, scope: Scope, call: Call) -> Iterator[_Store]:
    """The stores of a call to the parameters of a function."""
    parameters = called.parameters
    try:
        bound = bind_arguments(call, [Slot((p.name,), p.default is None) for p in parameters])
    except BindingError:
        return  # the call never happens: the program stops there
    for parameter, value in zip(parameters, bound, strict=True):
        variable = (called.name, parameter.name)
        yield _Store(variable, _NO_SCOPE, parameter.default) if value is None else _Store(variable, scope, value)


def _variable(program: Program, scope: Scope, name: str) -> Variable:
    return (scope.name if is_local(program, scope, name) else GLOBAL), name


def _always_returns(body: list[Statement]) -> bool:
    """True when a function cannot finish without a return statement."""
    last = body[-1] if body else None
    if isinstance(last, If):
        return all(map(_always_returns, [last.otherwise, *(block for _, block in last.branches)]))
    return isinstance(last, Return)


def root(node: Expression) -> str:
    """The variable that an expression is, or is an element or member of; empty for any other expression."""
    while isinstance(node, (Index, Member)):
        node = node.target
    return node.name if isinstance(node, Name) else ""
