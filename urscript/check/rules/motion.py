"""Rules on moves."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

from urscript.check.rules.registry import body_rule
from urscript.check.subject import Body, Subject, argument
from urscript.literals import literal_value
from urscript.syntax import Call, Expression, ExpressionStatement, FunctionDef, Node, Statement, all_statements, blocks
from urscript.values import Pose, is_number

_STRAIGHT: Final = ("movel", "movep")
_MOVES: Final = (*_STRAIGHT, "movej", "movec", "optimovej", "optimovel")
_RADIUS: Final = {"movej": 4, "movel": 4, "movep": 3}  # position of the argument r


@body_rule("URS304", "blend-radius")
def blends(subject: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """the blend radius at a waypoint is larger than half of the straight segment before or after it"""
    if any(call.name in _STRAIGHT for call in body.scope.calls):
        for block in [body.statements, *(b for s in all_statements(body.statements) for b in blocks(s))]:
            yield from _in_block(subject, body, block)


def _in_block(subject: Subject, body: Body, block: Sequence[Statement]) -> Iterator[tuple[Node, str]]:
    row: list[Call] = []  # moves that follow each other
    for statement in [*block, None]:
        call = statement.value if isinstance(statement, ExpressionStatement) else None
        if isinstance(call, Call) and call.name in _MOVES:
            row.append(call)
        elif statement is None or blocks(statement) or isinstance(statement, FunctionDef):
            yield from _in_row(subject, body, row)
            row = []


def _in_row(subject: Subject, body: Body, row: Sequence[Call]) -> Iterator[tuple[Node, str]]:
    places = [_target(subject, body, move) for move in row]
    for at, move in enumerate(row[:-1]):
        radius = _number(subject, body, argument(move, _RADIUS.get(move.name, 9), "r"))
        for other, straight in ((at - 1, move), (at + 1, row[at + 1])):
            if other < 0 or straight.name not in _STRAIGHT:
                continue
            here, there = places[at], places[other]
            if here is None or there is None or not (length := math.dist(here[:3], there[:3])):
                continue
            if radius > length / 2:
                which = "before" if other < at else "after"
                yield (
                    move,
                    f"the blend radius of {radius:g} m is larger than half of the segment {which} it, which is "
                    f"{length:.3g} m long: the controller shortens the blend or skips the waypoint",
                )
                break


def _target(subject: Subject, body: Body, move: Call) -> Pose | None:
    node = argument(move, 0, "pose")
    while node is not None:
        node = subject.value(body, node)
        if isinstance(node, Call) and node.name == "get_inverse_kin":
            node = argument(node, 0, "x")
            continue
        value = literal_value(node)
        return value if isinstance(value, Pose) else None
    return None


def _number(subject: Subject, body: Body, node: Expression | None) -> float:
    value: Any = literal_value(subject.value(body, node)) if node is not None else 0.0
    return value if is_number(value) else 0.0
