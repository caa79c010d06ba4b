"""Rules on loops: whether they take time, and what they do in each pass."""

from collections.abc import Iterator, Sequence
from typing import Final

from urscript.check.rules.registry import body_rule
from urscript.check.subject import END, Body, Subject, argument, calls, inner, is_true, names, own_expressions
from urscript.inference import root
from urscript.literals import literal_value
from urscript.syntax import (
    Assign,
    Call,
    If,
    MethodCall,
    Node,
    Return,
    Run,
    Statement,
    ThreadControl,
    While,
    Word,
    all_statements,
    blocks,
)
from urscript.values import is_number

_QUICK: Final = frozenset(["popup", "textmsg", "sync", "sleep"])
_READS: Final = {
    "socket_read_ascii_float": 2,
    "socket_read_binary_integer": 2,
    "socket_read_byte_list": 2,
    "socket_read_line": 1,
    "socket_read_string": 3,
}
"""Functions that wait 2 s for data unless a timeout is given, with the position of that argument."""

_SHORT_S: Final = 0.02  # guess: no servo period is longer
_READABLE_S: Final = 0.5  # guess: time between two popups that an operator could follow


@body_rule("URS301", "loop-takes-no-time")
def endless(subject: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a loop waits without sync() or sleep(): a pass takes no time, and nothing in the loop changes its condition"""
    timing = subject.timing
    for loop in body.loops:
        if END not in timing.idle(loop.body) or timing.takes([loop.condition]):
            continue
        inside = [loop, *all_statements(loop.body)]
        conditions = [c for s in inside if isinstance(s, If | While) for c in own_expressions(s)]
        changed = {root(s.target) for s in inside if isinstance(s, Assign)}
        nodes = (node for s in inside for node in inner(own_expressions(s)))
        hidden = any(isinstance(n, MethodCall | Run) or getattr(n, "name", "") in subject.unit.plans for n in nodes)
        if not hidden and not names(conditions) & changed:  # what functions of the program change is not followed
            yield loop, "a pass of this loop may take no time: add sync(), or the controller stops the program"


@body_rule("URS302", "popup-in-loop")
def popups(_: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a popup that does not block is shown in each pass of a loop that hardly waits"""
    for loop in body.loops:
        yield from _popups(loop.body)


def _popups(block: Sequence[Statement]) -> Iterator[tuple[Node, str]]:
    """The popups of a block, unless something in it keeps the loop from passing often."""
    if any(isinstance(s, Return | While | Assign) or (isinstance(s, Word) and s.word != "continue") for s in block):
        return
    own = [call for s in block if not isinstance(s, If) for call in calls(s)]
    if any(call.name not in _QUICK or _blocks(call, longer_than=_READABLE_S) for call in own):
        return
    for call in own:
        if call.name == "popup":
            yield call, "this popup is shown again in each pass: pass blocking=True, or leave the loop after it"
    for statement in block:
        for inside in blocks(statement):
            yield from _popups(inside)


def _blocks(call: Call, longer_than: float) -> bool:
    """Whether a call stops its thread for longer than some time [s]."""
    if call.name == "sleep":
        time = literal_value(argument(call, 0, "t") or call)
        return is_number(time) and time > longer_than
    if call.name == "popup":
        return is_true(argument(call, 4, "blocking"))
    return call.name in _READS and argument(call, _READS[call.name], "timeout") is None


@body_rule("URS303", "blocking-in-servo-loop")
def blocking(_: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a loop that commands servoj also waits: sleep, a blocking popup, or reading a socket without a timeout"""
    if any(call.name == "servoj" for call in body.scope.calls):
        for loop in body.loops:
            if _servos(loop.body):
                yield from _blocking(loop.body)


def _servos(block: Sequence[Statement]) -> bool:
    inside = (s for s in block if not isinstance(s, While))
    return any(any(c.name == "servoj" for c in calls(s)) or any(map(_servos, blocks(s))) for s in inside)


def _blocking(block: Sequence[Statement]) -> Iterator[tuple[Node, str]]:
    for statement in block:
        for call in calls(statement):
            if _blocks(call, longer_than=_SHORT_S):
                yield call, f"{call.name} stops this loop, and with it the arm that servoj moves"
        if isinstance(statement, If):
            for inner_block in blocks(statement):
                if not any(map(_ends_servoing, all_statements(inner_block))):
                    yield from _blocking(inner_block)


def _ends_servoing(statement: Statement) -> bool:
    left = isinstance(statement, Return | ThreadControl) or (isinstance(statement, Word) and statement.word == "break")
    return left or any(call.name in ("stopj", "stopl") for call in calls(statement))
