"""A failing run made simpler: as few and as plain options as still make it fail in the same way.

One thing at a time is taken away, and the run is tried: a value of an axis for the first one of its axis, a fault of
several, an argument of a fault. What is not needed for failing the same stays away. It goes round until nothing more
can go. Inputs and answers stay: without them a program fails that would be right.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

from emulator.campaign.plan import Axis, Plan, Run

_MOST_TRIES: Final = 60  # guess: enough for a dozen options and faults of a few arguments
_FAULT: Final = "fault"
_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


def kind_of(failure: str) -> str:
    """What two failures of one cause have in common: their text without numbers."""
    return _NUMBER.sub("#", failure)


def minimised(plan: Plan, number: int, failure: str, failure_of: Callable[[Run], str]) -> Run:
    """The simplest run found. failure_of: carries a run out and says how it failed, or nothing."""
    wanted = kind_of(failure)
    run = plan.run(number)
    tried: list[Any] = [run.options]
    simpler = True
    while simpler:
        simpler = False
        for options in _simpler(plan, run):
            if options in tried or len(tried) > _MOST_TRIES:
                continue
            tried.append(options)
            candidate = Run(number, run.target, options)
            if kind_of(failure_of(candidate)) == wanted:
                run, simpler = candidate, True
                break
    return run


def _simpler(plan: Plan, run: Run) -> Iterator[dict[str, Any]]:
    """The options with one thing less."""
    options = dict(run.options)
    for axis in plan.axes:
        if axis.name != plan.kind:
            yield _with_the_first(axis, options)
    value = options.get(_FAULT, [])
    faults = value if isinstance(value, list) else [value]
    for index, fault in enumerate(faults):
        for fewer in ([], *([shorter] for shorter in _shorter_faults(str(fault)))):
            left = [*faults[:index], *fewer, *faults[index + 1 :]]
            yield {**options, _FAULT: left} if left else _without(options, _FAULT)


def _without(options: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name not in names}


def _with_the_first(axis: Axis, options: dict[str, Any]) -> dict[str, Any]:
    """The value of an axis replaced by its first."""
    first = axis.value(0)
    if not isinstance(first, dict):
        changed = {**options, axis.name: first}
    else:
        assert isinstance(axis.values, list), "numbers are not mappings"
        theirs = {name for value in axis.values for name in value}
        changed = _without(options, *theirs) | first
    return {name: value for name, value in changed.items() if value is not None}


def _shorter_faults(text: str) -> Iterator[str]:
    """Without one of its arguments; one that it needs makes the run a refused one, which is another failure."""
    kind, *arguments = text.split(",")
    for index in range(len(arguments)):
        yield ",".join([kind, *arguments[:index], *arguments[index + 1 :]])
