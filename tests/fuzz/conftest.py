"""Fuzzers that run whole programs; each draws from a seed, so that a finding can be repeated."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not add the folder
