"""The work budget of a frame.

Only one script thread executes at a time in a process, so there is one meter. The scheduler fills it before it resumes
a thread; compiled code draws from it and parks the thread when it is empty. Functions whose work grows with their
arguments charge it, too. Counting work instead of measuring time keeps programs deterministic.
"""

from collections.abc import Generator


class Meter:
    """`left` is the work the running thread may still do in this frame, in units of about 50 ns."""

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = 0


METER = Meter()


def charge(units: int) -> None:
    """Charge work that the compiler could not foresee, such as iterating over a long list."""
    METER.left -= units


def pay(units: int) -> Generator[None, None, None]:
    """Charge work in a built-in that may wait: it continues in the next frame when this frame's budget is spent."""
    METER.left -= units
    if METER.left <= 0:
        yield
