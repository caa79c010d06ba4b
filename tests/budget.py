"""The amount of open-ended testing: a little in each run, more in `make long` and `make soak`.

Random examples are tried EXAMPLES times as often in `make soak`. In CI they are the same every time (see conftest.py),
so more of them would find nothing new there.
"""

import os
from collections.abc import Container, Iterable

import pytest

_FACTOR = int(os.environ.get("EXAMPLES", "1"))


def examples(count: int) -> int:
    """The value of ``max_examples`` for a test that uses ``count`` by default."""
    return count * _FACTOR


def subset(values: Iterable[str], now: Container[str]) -> list[object]:
    """Parameters of an expensive test: ``now`` in every run, the others with the long tests, also in CI."""
    return [value if value in now else pytest.param(value, marks=pytest.mark.long) for value in values]
