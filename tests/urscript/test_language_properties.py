"""Generated programs: the text of a tree has that tree, and arithmetic is what an independent evaluator says."""

import math
import operator
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from tests.budget import examples
from urproto.versions import PolyscopeVersion
from urscript import LibrarySet, Runtime, compile_script
from urscript.library import LIBRARIES
from urscript.parser import parse
from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Constant,
    ExpressionStatement,
    FunctionDef,
    If,
    Index,
    Label,
    ListLiteral,
    Member,
    MethodCall,
    Name,
    Node,
    Parameter,
    PoseLiteral,
    Return,
    Run,
    Scope,
    ThreadControl,
    Unary,
    While,
    Word,
)
from urscript.work import run_to_end

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not add the folder

from script_printer import LEVEL, block, expression, shape

SET = LibrarySet(LIBRARIES)
VERSION = PolyscopeVersion.parse("5.22")
OPERATORS = st.sampled_from([sign for sign in LEVEL if sign != "not"])


def node(kind: Callable[..., Node], *parts: Any) -> st.SearchStrategy[Any]:
    """A node of a kind; its parts are strategies, or lists of them for any number."""
    return st.builds(kind, st.just(0), st.just(0), *parts)


# text and tree

NAMES = st.sampled_from(["a", "b2", "_c", "pose", "END", "definition", "x_def"])
INTS = st.integers(-(2**31), 2**31 - 1)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_characters='"', exclude_categories=["Cs"]), max_size=8)
CONSTANTS = node(Constant, st.one_of(st.booleans(), st.none(), INTS, FLOATS, TEXTS))


def is_number(value: Node) -> bool:
    return isinstance(value, Constant) and type(value.value) in (int, float)


def _larger(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    several = st.lists(inner, max_size=3)
    parts = st.one_of(node(Name, NAMES), node(ListLiteral, several), node(Call, NAMES, several, st.just([])))
    return st.one_of(
        node(Binary, OPERATORS, inner, inner),
        node(Unary, st.just("not"), inner),
        node(Unary, st.sampled_from("+-"), inner.filter(lambda value: not is_number(value))),
        node(Index, parts, st.lists(inner, min_size=1, max_size=2)),
        node(Member, parts, NAMES),
        node(MethodCall, parts, NAMES, several),
        node(Call, NAMES, several, st.lists(st.tuples(NAMES, inner), max_size=2)),
        node(ListLiteral, several),
        node(PoseLiteral, st.lists(inner, min_size=6, max_size=6)),
    )


EXPRESSIONS = st.recursive(st.one_of(CONSTANTS, node(Name, NAMES), node(Run, NAMES)), _larger, max_leaves=5)
TARGETS = st.one_of(
    node(Name, NAMES),
    node(Index, node(Name, NAMES), st.lists(EXPRESSIONS, min_size=1, max_size=2)),
    node(Member, node(Name, NAMES), NAMES),
)
PARAMETERS = st.lists(NAMES, unique=True, max_size=3).map(lambda names: [Parameter(0, 0, name, None) for name in names])


def statements(depth: int, in_loop: bool = False) -> st.SearchStrategy[list[Node]]:
    words = ["halt", "enter_critical", "exit_critical", *(["break", "continue"] if in_loop else [])]
    simple = [
        node(Assign, TARGETS, EXPRESSIONS),
        node(ExpressionStatement, node(Call, NAMES, st.lists(EXPRESSIONS, max_size=2), st.just([]))),
        node(ExpressionStatement, node(Run, NAMES)),
        node(Return, st.one_of(st.none(), EXPRESSIONS)),
        node(Word, st.sampled_from(words)),
        node(ThreadControl, st.sampled_from(["join", "kill"]), EXPRESSIONS),
        node(Label, st.integers(0, 999), TEXTS, st.just("")),
    ]
    return st.lists(st.one_of(*simple, *(_compounds(depth - 1, in_loop) if depth else [])), max_size=3)


def _compounds(depth: int, in_loop: bool) -> list[st.SearchStrategy[Any]]:
    body, outside = statements(depth, in_loop), statements(depth)
    scopes = st.builds(Scope, NAMES, is_thread=st.just(False), parameters=PARAMETERS)
    threads = st.builds(Scope, NAMES, is_thread=st.just(True))
    branches = st.lists(st.tuples(EXPRESSIONS, body), min_size=1, max_size=2)
    return [
        node(If, branches, body, st.just(False)),
        node(While, EXPRESSIONS, statements(depth, in_loop=True)),
        node(FunctionDef, st.one_of(scopes, threads), outside),
    ]


@settings(max_examples=examples(26))
@given(statements(2))
def test_the_text_of_a_tree_has_that_tree(body: list[Node]) -> None:
    program = run_to_end(parse(f"def program():\n{block(body)}end"))
    assert shape(program.body) == shape(body)


# arithmetic


class Fault(Exception):  # noqa: N818
    """The program stops."""


def evaluate(tree: Node) -> Any:
    """The value of an expression by the rules of docs/reference/urscript_rules.md; numpy does the floating point."""
    match tree:
        case Constant(value=value):
            return value
        case ListLiteral(items=items):
            return [evaluate(item) for item in items]
        case Unary(operator="not", operand=operand):
            return not condition(evaluate(operand))
        case Unary(operator="-", operand=operand):
            return combine("*", evaluate(operand), -1)
        case Unary(operand=operand):
            return number(evaluate(operand))
        case Binary(operator="and", left=left, right=right):
            return condition(evaluate(left)) and condition(evaluate(right))
        case Binary(operator="or", left=left, right=right):
            return condition(evaluate(left)) or condition(evaluate(right))
        case Binary(operator="xor", left=left, right=right):
            return condition(evaluate(left)) != condition(evaluate(right))
        case Binary(operator=sign, left=left, right=right):
            return combine(sign, evaluate(left), evaluate(right))
    raise AssertionError(tree)


def condition(value: Any) -> bool:
    if isinstance(value, list):
        raise Fault
    return value != 0


def number(value: Any) -> Any:
    if type(value) not in (int, float):
        raise Fault
    return value


def combine(sign: str, left: Any, right: Any) -> Any:
    if sign in ("==", "!="):
        assume(
            not any(
                isinstance(item, float) and math.isnan(item)
                for side in (left, right)
                if isinstance(side, list)
                for item in side
            )
        )
        return (left == right) == (sign == "==")
    if sign in ("<", "<=", ">", ">="):
        if isinstance(left, list) or isinstance(right, list):
            raise Fault
        return {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}[sign](left, right)
    if isinstance(left, list) and isinstance(right, list):
        if len(left) != len(right):
            raise Fault
        return [arithmetic(sign, a, b) for a, b in zip(left, right, strict=True)]
    if isinstance(left, list):
        number(right)
        return [arithmetic(sign, item, right) for item in left]
    if isinstance(right, list):
        number(left)
        return [arithmetic(sign, left, item) for item in right]
    return arithmetic(sign, left, right)


def arithmetic(sign: str, left: Any, right: Any) -> int | float:
    ints = type(number(left)) is type(number(right)) is int
    with np.errstate(all="ignore"):
        if sign == "/":
            return float(np.divide(np.float64(left), np.float64(right)))
        if not ints:
            function = {"+": np.add, "-": np.subtract, "*": np.multiply, "%": np.fmod}[sign]
            return float(function(np.float64(left), np.float64(right)))
        if sign == "%":
            if right == 0:
                raise Fault
            return int(np.fmod(np.int64(left), np.int64(right)))
        function = {"+": np.add, "-": np.subtract, "*": np.multiply}[sign]
        return int(function(np.int64(left), np.int64(right)).astype(np.int32))


NUMBERS = st.one_of(
    st.integers(-3, 3), st.sampled_from([-(2**31), 2**31 - 1, 65536, 0.0, -0.0, 0.5, -2.5, 1e300]), INTS
)
OPERANDS = st.one_of(
    node(Constant, NUMBERS),
    node(Constant, st.booleans()),
    node(ListLiteral, st.lists(node(Constant, NUMBERS), max_size=3)),
)
ARITHMETIC = st.recursive(
    OPERANDS,
    lambda inner: st.one_of(
        node(Binary, OPERATORS, inner, inner),
        node(Unary, st.just("not"), inner),
        node(Unary, st.sampled_from("+-"), inner.filter(lambda value: not is_number(value))),
    ),
    max_leaves=6,
)


class Host:
    period_s = 0.002

    def on_label(self, number, text, option, thread):
        pass


def run(tree: Node) -> Any:
    """What the interpreter says, repr for the difference between 1, 1.0, True and -0.0."""
    runtime = Runtime(compile_script(f"x = {expression(tree)}", SET, VERSION), Host())
    runtime.step()
    return "fault" if runtime.error is not None else repr(runtime.globals["x"])


@settings(max_examples=examples(100))
@given(ARITHMETIC)
@example(Binary(0, 0, "*", Constant(0, 0, 2**31 - 1), Constant(0, 0, 2**31 - 1)))
@example(Binary(0, 0, "<", Constant(0, 0, True), Constant(0, 0, 1)))
@example(Binary(0, 0, "%", Constant(0, 0, -(2**31)), Constant(0, 0, -1)))
@example(Binary(0, 0, "/", Constant(0, 0, -1), Constant(0, 0, -0.0)))
@example(Binary(0, 0, "%", Constant(0, 0, -0.0), Constant(0, 0, 1)))
def test_arithmetic_agrees_with_an_independent_evaluator(tree: Node) -> None:
    try:
        expected = repr(evaluate(tree))
    except Fault:
        expected = "fault"
    assert run(tree) == expected, expression(tree)
