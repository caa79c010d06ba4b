"""Adds the folders of the helpers of these tests and of the driver's, which importlib mode does not."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))
sys.path.insert(0, str(Path(__file__).parent))
