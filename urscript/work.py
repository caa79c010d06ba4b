"""Work in steps, so that compiling a long text can be spread over control periods.

A step generator yields, after each piece of work, how much that was; its return value is the
result. One unit of work is about a microsecond on a small machine: every number is a guess
from measuring, and all that matters is that they fit together.
"""

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import TypeAlias, TypeVar

__all__ = ["Steps", "released", "run_to_end"]

ResultT = TypeVar("ResultT")
WorkerT = TypeVar("WorkerT")

Steps: TypeAlias = Generator[int, None, ResultT]
"""Yields the work done since the last yield; returns the result."""


def run_to_end(steps: Steps[ResultT]) -> ResultT:
    """The result, with all the work done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: ResultT = end.value
            return result


@contextmanager
def released(worker: WorkerT) -> Iterator[WorkerT]:
    """Empty a parser or compiler at the end of its work.

    They keep tables of their own methods, and so themselves, and with them the tokens and trees of the whole text:
    tens of thousands of objects that only the garbage collector would find, which stops a control loop meanwhile.
    """
    try:
        yield worker
    finally:
        vars(worker).clear()
