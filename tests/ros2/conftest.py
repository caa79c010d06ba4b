"""The helpers of the driver's tests serve here too; importlib mode does not add the folders."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "driver"))
sys.path.insert(0, str(Path(__file__).parent))

import pytest


@pytest.fixture(scope="session", autouse=True)
def message_packages() -> None:
    """Those that the wheels lack: `make test` has made them, and the programs of these tests find them."""
    from client.ros2 import message_packages

    message_packages.ensure()
