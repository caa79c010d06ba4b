"""From script values to the tuples the rest of the emulator uses, with errors the script's author can read."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from urscript.errors import RuntimeFault
from urscript.values import is_number

__all__ = ["numbers", "six", "three", "within_range"]

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


def six(values: Sequence[float]) -> Vector6:
    """Six floats."""
    a, b, c, d, e, f = values
    return (float(a), float(b), float(c), float(d), float(e), float(f))


def three(values: Sequence[float], what: str) -> Vector3:
    """Three floats; RuntimeFault naming ``what`` when they are not."""
    x, y, z = numbers(values, 3, what)
    return (float(x), float(y), float(z))


def numbers(values: Sequence[float], count: int, what: str) -> Sequence[float]:
    """The values, when they are ``count`` finite numbers; RuntimeFault naming ``what`` otherwise."""
    if len(values) != count or not all(is_number(value) and math.isfinite(value) for value in values):
        raise RuntimeFault(f"{what} must be {count} finite numbers")
    return values


@contextmanager
def within_range() -> Iterator[None]:
    """Turn the complaints of signals and registers into runtime faults."""
    try:
        yield
    except (IndexError, OverflowError, ValueError) as error:
        raise RuntimeFault(str(error)) from error
