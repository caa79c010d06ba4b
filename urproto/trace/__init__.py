"""Traces: what happened in a run of a robot, and the page that shows it."""

from pathlib import Path
from typing import Final

STATIC: Final = Path(__file__).with_name("static")
"""What browsers get: parts of the page, some of which the pendant uses too."""
