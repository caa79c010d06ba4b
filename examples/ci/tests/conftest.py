"""A cell on an emulated robot, and the cable between them."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cell import HOME, Cell

from urtesting import EmulatorProcess

sys.path.insert(0, str(Path(__file__).parent))
from cable import Cable


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What all robots of these tests are; e-Series arms take scripts of ur_rtde in remote control only."""
    for item in items:
        item.add_marker(pytest.mark.ur_model(running=True, initial_q=HOME, remote_control=True))


@pytest.fixture
def cell(ur_emulator: EmulatorProcess) -> Iterator[Cell]:
    with Cell(ur_emulator.host) as cell:
        yield cell


@pytest.fixture
def cable(ur_emulator: EmulatorProcess) -> Iterator[Cable]:
    with Cable(ur_emulator.host) as cable:
        yield cable


@pytest.fixture
def far_cell(cable: Cable) -> Iterator[Cell]:
    """A cell at the other end of the cable."""
    with Cell(cable.host) as cell:
        yield cell
        cable.plug()
