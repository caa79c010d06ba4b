"""Simplifies a failing run: reduces its options as far as it still fails in the same way.

It tries one simplification at a time: replacing a value of an axis by the first one of the axis, removing one of
several faults, or removing an argument of a fault. A simplification is kept if the run still fails in the same way.
This is repeated until no simplification is left. Inputs and answers are kept, because without them a correct program
would fail.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

from emulator.campaign.plan import Axis, Plan, Run

_MAX_TRIES: Final = 60  # guess: enough for a dozen options and faults of a few arguments
_FAULT: Final = "fault"
_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


def kind_of(failure: str) -> str:
    """The kind of a failure, which failures with the same cause share: its text without numbers."""
    return _NUMBER.sub("#", failure)


def minimised(plan: Plan, number: int, failure: str, failure_of: Callable[[Run], str]) -> Run:
    """The simplest run found. failure_of: executes a run and returns its failure, or an empty text."""
    wanted = kind_of(failure)
    run = plan.run(number)
    tried: list[Any] = [run.options]
    simpler = True
    while simpler:
        simpler = False
        for options in _simpler(plan, run):
            if options in tried or len(tried) > _MAX_TRIES:
                continue
            tried.append(options)
            candidate = Run(number, run.target, options)
            if kind_of(failure_of(candidate)) == wanted:
                run, simpler = candidate, True
                break
    return run


def _simpler(plan: Plan, run: Run) -> Iterator[dict[str, Any]]:
    """Options with one simplification each."""
    options = dict(run.options)
    for axis in plan.axes:
        if axis.name != plan.kind:
            yield _with_first_value(axis, options)
    value = options.get(_FAULT, [])
    faults = value if isinstance(value, list) else [value]
    for index, fault in enumerate(faults):
        for fewer in ([], *([shorter] for shorter in _shorter_faults(str(fault)))):
            left = [*faults[:index], *fewer, *faults[index + 1 :]]
            yield {**options, _FAULT: left} if left else _without(options, _FAULT)


def _without(options: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name not in names}


def _with_first_value(axis: Axis, options: dict[str, Any]) -> dict[str, Any]:
    """The options, with the value of an axis replaced by its first one."""
    first = axis.value(0)
    if not isinstance(first, dict):
        changed = {**options, axis.name: first}
    else:
        assert isinstance(axis.values, list), "numbers are not mappings"
        theirs = {name for value in axis.values for name in value}
        changed = _without(options, *theirs) | first
    return {name: value for name, value in changed.items() if value is not None}


def _shorter_faults(text: str) -> Iterator[str]:
    """The fault without one argument each. Without a required one the run is refused, which is another failure."""
    kind, *arguments = text.split(",")
    for index in range(len(arguments)):
        yield ",".join([kind, *arguments[:index], *arguments[index + 1 :]])
