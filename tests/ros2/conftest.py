"""The helpers of the driver's tests serve here too; importlib mode does not add the folders."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))
sys.path.insert(0, str(Path(__file__).parent))
