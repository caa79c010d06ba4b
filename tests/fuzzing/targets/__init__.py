"""Every reader of foreign bytes as a function of those bytes, grouped by the subject of the bytes.

`TARGETS` has all of them by name. `fuzz.py` searches for inputs, `test_corpus.py` replays those that are kept.
"""

from targets import control_api, programs, recordings, settings, wire  # each registers its own
from targets.registry import TARGETS

__all__ = ["TARGETS", "control_api", "programs", "recordings", "settings", "wire"]
