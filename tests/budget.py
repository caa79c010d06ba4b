"""How much the tests with random examples try: a little in each run, EXAMPLES times as much in `make soak`.

In CI the examples are the same every time (see conftest.py), so that more of them there would find nothing new.
"""

import os

_FACTOR = int(os.environ.get("EXAMPLES", "1"))


def examples(count: int) -> int:
    """What a test gives as ``max_examples``."""
    return count * _FACTOR
