import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # fault_rig; importlib mode does not add the folder

from fault_rig import Robot


@pytest.fixture(params=["ur3", "ur5e"])
async def robot(request: pytest.FixtureRequest) -> AsyncIterator[Robot]:
    """An emulator with open ports in virtual time."""
    async with Robot(request.param) as robot:
        yield robot


@pytest.fixture
async def ur3() -> AsyncIterator[Robot]:
    async with Robot("ur3") as robot:
        yield robot
