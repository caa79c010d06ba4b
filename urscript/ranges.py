"""Range analysis: what is known about the local variables at a place of a body.

A sum that cannot exceed 32 bits needs no wrap there, and a position that is certainly within a list needs no test.
`Ranges` follows the statements in the order in which they are compiled: assignments change what is known, conditions
add to it, and where branches meet, only what all of them know is left. Before a loop is compiled, its body is followed
until what is known at the beginning of a pass no longer changes; bounds that do change are dropped (textbooks call it
abstract interpretation with widening).
"""

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from urscript.builtins import Builtin
from urscript.inference import (
    INT,
    LIST_LENGTHS,
    LIST_MAKER,
    STRING,
    Kinds,
    assigned_names,
    is_local,
    is_sequence,
    root,
)
from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Constant,
    Expression,
    FunctionDef,
    If,
    ListLiteral,
    Name,
    NumberList,
    PoseLiteral,
    Program,
    Return,
    Scope,
    Statement,
    Unary,
    While,
    Word,
)
from urscript.values import INT_MAX, INT_MIN

Range: TypeAlias = tuple[int, int]
"""The smallest and the largest value that an int may have."""

_ANY: Final[Range] = (INT_MIN, INT_MAX)
_LENGTH: Final[Range] = (0, INT_MAX)

_MIRRORED: Final = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "=="}
_OPPOSITE: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "!=": "=="}
_LENGTHS: Final = LIST_LENGTHS | {"str_len"}
_POSE_LENGTH: Final = 6

_MAX_ROUNDS: Final = 5
"""Times that the body of a loop is followed, after which everything is forgotten that it changes; usually two."""

_MAX_STATEMENTS: Final = 300
"""Statements followed before a loop is compiled, after which inner loops are no longer followed: a millisecond."""


@dataclass(slots=True)
class Known:
    """What is known at one place.

    below: pairs of an int variable and a sequence or string whose length is greater.
    """

    ints: dict[str, Range] = field(default_factory=dict)
    lengths: dict[str, int] = field(default_factory=dict)  # of sequences
    below: set[tuple[str, str]] = field(default_factory=set)

    def copy(self) -> "Known":
        return Known(self.ints.copy(), self.lengths.copy(), self.below.copy())

    def forget(self, names: Set[str]) -> None:
        for name in names:
            self.ints.pop(name, None)
            self.lengths.pop(name, None)
        if self.below:
            self.below = {pair for pair in self.below if names.isdisjoint(pair)}

    def widened(self, later: "Known") -> "Known":
        """What is still known when a pass of a loop begins with this, or with what is known after a pass."""
        ints: dict[str, Range] = {}
        for name, (low, high) in self.ints.items():
            low_later, high_later = later.ints.get(name, _ANY)
            if low_later < low:
                low = 0 if low_later >= 0 else INT_MIN
            if high_later > high:
                high = INT_MAX
            if (low, high) != _ANY:
                ints[name] = low, high
        return Known(ints, dict(self.lengths.items() & later.lengths.items()), self.below & later.below)


def _met(known: Iterable[Known | None]) -> Known | None:
    """What is known where several ways meet; None where none of them arrives."""
    ways = [one for one in known if one is not None]
    if not ways:
        return None
    met = ways[0].copy()
    for one in ways[1:]:
        met.lengths = dict(met.lengths.items() & one.lengths.items())
        met.below &= one.below
        both = met.ints.keys() & one.ints.keys()
        met.ints = {
            name: (min(met.ints[name][0], one.ints[name][0]), max(met.ints[name][1], one.ints[name][1]))
            for name in both
        }
    return met


class Ranges:
    """What is known at the place of a body that is being compiled.

    following: False for a body whose variables others share, or that is too long; nothing is known in it.
    """

    def __init__(
        self, program: Program, scope: Scope, builtins: Mapping[str, Builtin], kinds: Kinds, *, following: bool
    ) -> None:
        self._program = program
        self._scope = scope
        self._builtins = builtins
        self._kinds = kinds
        self._following = following
        self._here: Known | None = Known()
        self._computed: dict[int, Range | None] = {}  # ranges of operations here, by the node's id
        self._resized = {root(method.target) for method in scope.methods} if following else set[str]()
        self._breaks: list[Known | None] = []  # what is known at each break of the loop that is being followed
        self._passes: list[Known | None] = []  # and at each continue
        self._statements = 0

    # questions

    def fits(self, node: Binary) -> bool:
        """Whether the result of an operation on two ints certainly has 32 bits before any wrap."""
        if not self._following:
            return False
        left, right = self.range_of(node.left), self.range_of(node.right)
        if left is None or right is None or (found := _result(node.operator, left, right)) is None:
            return False
        return found[0] >= INT_MIN and found[1] <= INT_MAX

    def is_not_negative(self, node: Expression) -> bool:
        """Whether an int is certainly not negative."""
        found = self.range_of(node)
        return found is not None and found[0] >= 0

    def is_below_length(self, node: Expression, name: str) -> bool:
        """Whether an int is certainly less than the length of the list, pose or string in a variable."""
        known = self._known
        if known is None or not self._following:
            return False
        found, length = self.range_of(node), known.lengths.get(name)
        if found is not None and length is not None and found[1] < length:
            return True
        return isinstance(node, Name) and (node.name, name) in known.below

    def length_of(self, name: str) -> int | None:
        """The length of the list or pose in a variable, if it is known."""
        return self._known.lengths.get(name) if self._known is not None else None

    def range_of(self, node: Expression) -> Range | None:
        """The range of a value; None if it may be something else than an int."""
        if not isinstance(node, (Binary, Unary)):
            return self._range(node)
        if id(node) not in self._computed:
            self._computed[id(node)] = self._range(node)
        return self._computed[id(node)]

    def _range(self, node: Expression) -> Range | None:
        match node:
            case Constant(value=value):
                return (value, value) if isinstance(value, int) and not isinstance(value, bool) else None
            case Name():
                if self._known is not None and (found := self._known.ints.get(node.name)) is not None:
                    return found
                return _ANY if self._kinds.variable(self._scope, node.name) == INT else None
            case Binary() if node.operator in ("+", "-", "*", "%"):
                left, right = self.range_of(node.left), self.range_of(node.right)
                if left is None or right is None:
                    return None
                found = _result(node.operator, left, right)
                return found if found is not None and found[0] >= INT_MIN and found[1] <= INT_MAX else _ANY
            case Unary() if node.operator == "-":
                found = self.range_of(node.operand)
                return None if found is None else (-found[1], -found[0]) if found[0] > INT_MIN else _ANY
            case Call() if node.name in _LENGTHS and self._is_builtin(node.name):
                sequence = self._argument(node)
                known = self.length_of(sequence)
                return _LENGTH if known is None else (known, known)
        return _ANY if self._kinds.expression(self._scope, node) == INT else None

    # the way through the body

    @property
    def _known(self) -> Known | None:
        """What is known here; None where nothing arrives, as after a return."""
        return self._here

    @_known.setter
    def _known(self, known: Known | None) -> None:
        self._here = known
        self._computed.clear()

    def place(self) -> Known | None:
        """What is known here, to return to later with `go_to`."""
        return self._known.copy() if self._known is not None else None

    def go_to(self, *places: Known | None) -> None:
        """Continue where one or several ways meet."""
        self._known = _met(places)

    def assume(self, condition: Expression, truth: bool) -> None:
        """The condition has just been evaluated, with this result."""
        if self._known is None or not self._following:
            return
        match condition:
            case Constant() if condition.value.__class__ is bool and condition.value is not truth:
                self._known = None
            case Unary() if condition.operator == "not":
                self.assume(condition.operand, not truth)
            case Binary() if condition.operator in ("and", "or"):
                if truth == (condition.operator == "and"):
                    self.assume(condition.left, truth)
                    self.assume(condition.right, truth)
            case Binary():
                operator = condition.operator if truth else _OPPOSITE.get(condition.operator, "")
                if operator in _MIRRORED:
                    self._compare(condition.left, operator, condition.right)
                    self._compare(condition.right, _MIRRORED[operator], condition.left)

    def follow(self, statement: Statement) -> None:
        """A statement without blocks has been executed."""
        if self._known is None or not self._following:
            return
        match statement:
            case Assign(target=Name(name=name)) if self._is_local(name):
                self._assign(name, statement.value)
            case Return() | Word(word="halt"):
                self._known = None
            case Word(word="break"):
                self._breaks.append(self._known)
                self._known = None
            case Word(word="continue"):
                self._passes.append(self._known)
                self._known = None

    def enter(self, loop: While) -> tuple[Known | None, int]:
        """Go to the beginning of a pass, before the condition is evaluated.

        Returns what is known after the loop, and the number of statements that had to be followed.
        """
        if self._known is None or not self._following:
            return self._known, 0
        self._statements = 0
        head, after = self._loop(loop)
        self._known = head
        return after, self._statements

    # following

    def _loop(self, loop: While) -> tuple[Known, Known | None]:
        """What is known at the beginning of every pass, and after the loop."""
        assert self._known is not None
        outer = self._breaks, self._passes
        head = self._known.copy()
        for _ in range(_MAX_ROUNDS if self._statements < _MAX_STATEMENTS else 0):
            self._known = head.copy()
            self._breaks, self._passes = [], []
            self.assume(loop.condition, True)
            self._body(loop.body)
            later = _met([self._known, *self._passes])
            widened = head if later is None else head.widened(later)
            if widened == head:
                break
            head = widened
        else:
            changed = assigned_names(loop)
            head.forget(changed)
            forgotten = head.copy()
            self._breaks = [forgotten]
        self._known = head.copy()
        self.assume(loop.condition, False)
        after = _met([self._known, *self._breaks])
        self._breaks, self._passes = outer
        return head, after

    def _body(self, statements: list[Statement]) -> None:
        for statement in statements:
            self._statements += 1
            if self._known is None:
                return
            if isinstance(statement, If):
                ends: list[Known | None] = []
                for condition, block in statement.branches:
                    before = self.place()
                    self.assume(condition, True)
                    self._body(block)
                    ends.append(self.place())
                    self._known = before
                    self.assume(condition, False)
                self._body(statement.otherwise)
                self.go_to(self._known, *ends)
            elif isinstance(statement, While):
                _, self._known = self._loop(statement)
            elif not isinstance(statement, FunctionDef):
                self.follow(statement)

    def _assign(self, name: str, value: Expression) -> None:
        known = self._known
        assert known is not None
        kind = self._kinds.variable(self._scope, name)
        found = self.range_of(value) if kind == INT else None
        length = self._length(value) if is_sequence(kind) and name not in self._resized else None
        known.forget({name})
        if found is not None and found != _ANY:
            known.ints[name] = found
        if length is not None:
            known.lengths[name] = length
        self._computed.clear()

    def _compare(self, left: Expression, operator: str, right: Expression) -> None:
        """Note what a comparison that is true says about its left side."""
        known = self._known
        if known is None or not isinstance(left, Name) or not self._is_counter(left.name):
            return
        bounds = self.range_of(right)
        if bounds is None:
            return
        low, high = known.ints.get(left.name, _ANY)
        if operator in ("<", "<=", "=="):
            high = min(high, bounds[1] - (operator == "<"))
        if operator in (">", ">=", "=="):
            low = max(low, bounds[0] + (operator == ">"))
        if low <= high:  # else the comparison cannot be true
            known.ints[left.name] = low, high
            self._computed.clear()
        if operator == "<" and isinstance(right, Call) and right.name in _LENGTHS and self._is_builtin(right.name):
            sequence = self._argument(right)
            if sequence:
                known.below.add((left.name, sequence))

    def _length(self, node: Expression) -> int | None:
        """The length of a value that can only be a list of numbers or bools, or a pose; None if it is not known."""
        match node:
            case ListLiteral():
                return len(node.items)
            case NumberList():
                return len(node.values)
            case PoseLiteral():
                return _POSE_LENGTH
            case Name():
                return self.length_of(node.name)
            case Binary():  # of two lists of the same length, or of a list and a number
                left = self._length(node.left)
                return self._length(node.right) if left is None else left
            case Call() if node.name == LIST_MAKER and node.arguments and self._is_builtin(node.name):
                low, high = self.range_of(node.arguments[0]) or _ANY
                return low if low == high else None
        return None

    def _argument(self, call: Call) -> str:
        """The local variable with a sequence or string that is the only argument of a call; else empty."""
        if len(call.arguments) != 1 or call.keywords or not isinstance(call.arguments[0], Name):
            return ""
        name = call.arguments[0].name
        kind = self._kinds.variable(self._scope, name)
        usable = self._is_local(name) and name not in self._resized and (is_sequence(kind) or kind == STRING)
        return name if usable else ""

    def _is_counter(self, name: str) -> bool:
        return self._is_local(name) and self._kinds.variable(self._scope, name) == INT

    def _is_local(self, name: str) -> bool:
        return is_local(self._program, self._scope, name)

    def _is_builtin(self, name: str) -> bool:
        return name in self._builtins and name not in self._program.functions


def _result(operator: str, left: Range, right: Range) -> Range | None:
    """The range of the result of an operation on two ints, before any wrap; None for any other operator."""
    (low, high), (low_right, high_right) = left, right
    match operator:
        case "+":
            return low + low_right, high + high_right
        case "-":
            return low - high_right, high - low_right
        case "*":
            products = low * low_right, low * high_right, high * low_right, high * high_right
            return min(products), max(products)
        case "%":  # with the sign of the left side, and less than the right one, which is not zero
            most = max(abs(low_right), abs(high_right), 1) - 1
            return (0 if low >= 0 else max(low, -most)), (0 if high <= 0 else min(high, most))
    return None
