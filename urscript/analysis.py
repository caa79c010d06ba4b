"""Which functions become Python generators, and which may recurse.

A function whose calls all return within a bounded amount of work can be a plain Python function;
one that takes physical time, loops, may recurse, or adds up to much work through the functions
it calls must be able to yield, so it becomes a generator.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from urscript.builtins import Builtin
from urscript.syntax import FunctionDef, Program, Scope

__all__ = ["FunctionPlan", "plan_functions"]

_PLAIN_COST = 400
"""Most work of a plain function with all it calls, in units of the meter: about 20 us."""


@dataclass(frozen=True, slots=True)
class FunctionPlan:
    """How one def or thread is compiled."""

    definition: FunctionDef
    generator: bool
    recursive: bool  # reaches itself, or a function that does: counts its call depth


def plan_functions(program: Program, builtins: Mapping[str, Builtin]) -> dict[str, FunctionPlan]:
    """A plan for every def and thread of the program, by name."""
    callees = {name: _callees(f.scope, program) for name, f in program.functions.items()}
    costs: dict[str, int] = {}
    plans: dict[str, FunctionPlan] = {}
    for name in _leaves_first(callees):
        definition = program.functions[name]
        scope = definition.scope
        costs[name] = scope.cost + sum(costs[callee] for callee in callees[name])
        generator = (
            _takes_time(scope, program, builtins)
            or costs[name] > _PLAIN_COST
            or any(plans[callee].generator for callee in callees[name])
        )
        plans[name] = FunctionPlan(definition, generator, recursive=False)
    for name, definition in program.functions.items():
        plans.setdefault(name, FunctionPlan(definition, generator=True, recursive=not definition.scope.is_thread))
    return plans


def _callees(scope: Scope, program: Program) -> list[str]:
    """The functions of the program that a body calls, once for each call."""
    functions = program.functions
    return [c.name for c in scope.calls if c.name in functions and not functions[c.name].scope.is_thread]


def _takes_time(scope: Scope, program: Program, builtins: Mapping[str, Builtin]) -> bool:
    if scope.is_thread or scope.loops or scope.waits:
        return True
    called = (builtins.get(call.name) for call in scope.calls if call.name not in program.functions)
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
