"""How much is tried where there is always more to try: a little in each run, more in `make long` and `make soak`.

Random examples are tried EXAMPLES times as often in `make soak`. In CI they are the same every time (see conftest.py),
so that more of them there would find nothing new.
"""

import os
from collections.abc import Container, Iterable

import pytest

_FACTOR = int(os.environ.get("EXAMPLES", "1"))


def examples(count: int) -> int:
    """What a test gives as ``max_examples``."""
    return count * _FACTOR


def some(values: Iterable[str], now: Container[str]) -> list[object]:
    """What to parametrize a costly test with: ``now`` in every run, the others in those with long tests, CI's too."""
    return [value if value in now else pytest.param(value, marks=pytest.mark.long) for value in values]
