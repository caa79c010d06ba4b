"""Work in steps, so that compiling a long text can be spread over control periods.

A step generator yields, after each piece of work, how much that was; its return value is the
result. One unit of work is about a microsecond on a small machine: every number is a guess
from measuring, and all that matters is that they fit together.
"""

from collections.abc import Generator
from typing import Any, TypeAlias, TypeVar

ResultT = TypeVar("ResultT")

Steps: TypeAlias = Generator[int, None, ResultT]
"""Yields the work done since the last yield; returns the result."""


_SLICE = 100  # elements that are forgotten at a time


def let_go(items: list[Any] | dict[Any, Any], work: int = 10) -> Steps[None]:
    """Empty what nobody needs any more: Python takes half a second to forget millions of objects at once.

    ``work``: of a hundred elements, with all that goes with them.
    """
    while items:
        if isinstance(items, list):
            del items[-_SLICE:]
        else:
            for _ in range(min(_SLICE, len(items))):
                items.popitem()
        yield work


def run_to_end(steps: Steps[ResultT]) -> ResultT:
    """The result, with all the work done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: ResultT = end.value
            return result
