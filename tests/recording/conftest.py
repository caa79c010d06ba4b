"""Recordings of a robot in virtual time."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # recording_rig; importlib mode does not add the folder

from recording_rig import moving_states


@pytest.fixture(scope="session")
def states() -> list[dict[str, object]]:
    """States of a UR5e that moves for two seconds, one per control period."""
    return moving_states()
