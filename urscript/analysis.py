"""Decide which functions become Python generators, and which may recurse.

A function whose calls all return within a bounded amount of work can be a plain Python function. A function that takes
physical time, loops, may recurse, or accumulates much work through the functions it calls must be able to yield, so it
becomes a generator.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from urscript.builtins import Builtin
from urscript.syntax import Parameter, Program, Scope
from urscript.work import Steps

MAX_CALL_DEPTH = 200
"""Deepest recursion. A guess; vendor programs recurse a few levels."""

_WORK = 8  # to plan a function, without its calls

_PLAIN_COST = 400
"""Maximum work of a plain function including everything it calls [meter units]: about 20 us."""

WHOLE = 350
"""Maximum cost of a function's own body that Python compiles in one go, which takes less than 2 ms. A longer body
becomes a generator and is divided. The value is a compromise: arithmetic takes twice as long with variables that pieces
share."""


@dataclass(frozen=True, slots=True)
class FunctionPlan:
    """How a def or thread is compiled and called. Without its body, because plans outlive the syntax tree.

    symbol: its name in Python.
    """

    parameters: tuple[Parameter, ...]
    is_thread: bool
    symbol: str
    cost: int  # including everything it calls [meter units]
    generator: bool
    recursive: bool  # calls itself, directly or indirectly, or such a function: counts its call depth


def plan_functions(
    program: Program, builtins: Mapping[str, Builtin], known: Mapping[str, FunctionPlan], prefix: str = "f"
) -> Steps[dict[str, FunctionPlan]]:
    """Plan every def and thread of the program; returns the plans by name.

    known: functions compiled earlier that the program may call. prefix: makes its symbols differ from theirs.
    """
    callees: dict[str, list[str]] = {}
    for name, function in program.functions.items():
        callees[name] = _callees(function.scope, program)
        yield _WORK + len(function.scope.calls)
    plans: dict[str, FunctionPlan] = {}
    for name in _leaves_first(callees):
        scope = program.functions[name].scope
        yield _WORK + len(scope.calls)
        called = [plans[callee] for callee in callees[name]] + _known_callees(scope, program, known)
        cost = min(scope.cost + sum(plan.cost for plan in called), _PLAIN_COST + 1)  # capped
        generator = (
            _takes_time(scope, program, builtins, known)
            or cost > _PLAIN_COST
            or scope.cost > WHOLE
            or any(plan.generator for plan in called)
        )
        plans[name] = _plan(scope, prefix, cost, generator, recursive=False)
    for name, definition in program.functions.items():
        if name not in plans:
            scope = definition.scope
            plans[name] = _plan(scope, prefix, _PLAIN_COST, generator=True, recursive=not scope.is_thread)
        yield 2
    return plans


def _plan(scope: Scope, prefix: str, cost: int, generator: bool, recursive: bool) -> FunctionPlan:
    return FunctionPlan(tuple(scope.parameters), scope.is_thread, f"{prefix}_{scope.name}", cost, generator, recursive)


def lends_its_scope(scope: Scope, builtins: Mapping[str, Builtin]) -> bool:
    """True when a body calls a built-in that receives the caller's variables."""
    called = (builtins.get(call.name) for call in scope.calls)
    return any(builtin is not None and builtin.takes_scope for builtin in called)


def _callees(scope: Scope, program: Program) -> list[str]:
    """The functions of the program that a body calls, once for each call."""
    functions = program.functions
    return [c.name for c in scope.calls if c.name in functions and not functions[c.name].scope.is_thread]


def _known_callees(scope: Scope, program: Program, known: Mapping[str, FunctionPlan]) -> list[FunctionPlan]:
    return [known[c.name] for c in scope.calls if c.name in known and c.name not in program.functions]


def _takes_time(
    scope: Scope, program: Program, builtins: Mapping[str, Builtin], known: Mapping[str, FunctionPlan]
) -> bool:
    if scope.is_thread or scope.loops or scope.waits:
        return True
    called = (builtins.get(c.name) for c in scope.calls if c.name not in program.functions and c.name not in known)
    return any(builtin is not None and builtin.takes_time for builtin in called)


def _leaves_first(callees: Mapping[str, list[str]]) -> list[str]:
    """Functions after everything they call; those that reach a cycle are left out."""
    waiting = {name: set(called) for name, called in callees.items()}
    callers: dict[str, list[str]] = {name: [] for name in callees}
    for name, called in waiting.items():
        for callee in called:
            callers[callee].append(name)
    order = [name for name, called in waiting.items() if not called]
    for name in order:
        for caller in callers[name]:
            waiting[caller].discard(name)
            if not waiting[caller]:
                order.append(caller)
    return order
