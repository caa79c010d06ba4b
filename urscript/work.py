"""Work in steps, so that compiling a long text can be spread over control periods.

A step generator yields the amount of work after each piece; its return value is the result. One unit of work is about a
microsecond on a small machine. All amounts are estimates from measurements, and only their proportions matter.
"""

import gc
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias, TypeVar

ResultT = TypeVar("ResultT")

Steps: TypeAlias = Generator[int, None, ResultT]
"""Yields the work done since the last yield; returns the result."""


_gc_pauses = 0  # under way in this process
_SLICE = 100  # elements removed at a time


def release(items: list[Any] | dict[Any, Any], work: int = 10) -> Steps[None]:
    """Empty a collection that is no longer needed. In steps, because Python takes half a second to free millions of
    objects in one go.

    work: to free a hundred elements with everything they refer to.
    """
    while items:
        if isinstance(items, list):
            del items[-_SLICE:]
        else:
            for _ in range(min(_SLICE, len(items))):
                items.popitem()
        yield work


def run_to_end(steps: Steps[ResultT]) -> ResultT:
    """Do all the work in one go; returns the result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: ResultT = end.value
            return result


@contextmanager
def gc_paused() -> Iterator[None]:
    """Disable the garbage collector, which would traverse every object of a large file or program in one go.

    None of them is garbage before the work is done, and most of them are freed immediately afterwards.
    """
    global _gc_pauses
    _gc_pauses += 1
    gc.disable()
    try:
        yield
    finally:
        _gc_pauses -= 1
        if not _gc_pauses:
            gc.enable()
