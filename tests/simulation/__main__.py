"""Plays seeds, and prints what they found.

python -m tests.simulation 503 --trace      # one seed, with every event
python -m tests.simulation 1 2000           # many of them
"""

import argparse
import time
from collections import Counter
from typing import Final

from tests.simulation.clients import play_seed

_REPORT_EVERY: Final = 100  # seeds

_now_s = time.monotonic  # of the real clock; inside a world, `time` has another


def main() -> int:
    """Exit status 1 if a seed found something."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("seed", type=int)
    parser.add_argument("last", type=int, nargs="?", help="the last seed of a range")
    parser.add_argument("--trace", action="store_true", help="print every event")
    options = parser.parse_args()
    last = options.seed if options.last is None else options.last
    began_s, events, virtual_s, failed, errors = _now_s(), 0, 0.0, 0, Counter[str]()
    for count, seed in enumerate(range(options.seed, last + 1), 1):
        outcome = play_seed(seed, print if options.trace else None)
        events += outcome.events
        virtual_s += outcome.virtual_s
        errors.update(outcome.errors)
        failed += bool(outcome.problems)
        if outcome.problems or last == options.seed:
            print(outcome, flush=True)
        if count % _REPORT_EVERY == 0 or seed == last:
            took_s = _now_s() - began_s
            speed = f"{took_s:.0f} s, {events / took_s:.0f} events/s, {virtual_s / took_s:.1f} times real time"
            print(f"{count} seeds, {failed} failed; {speed}; errors of the client: {dict(errors)}", flush=True)
    return int(failed > 0)


raise SystemExit(main())
