"""One control period of a controller."""

from emulator.controller import Controller
from emulator.snapshot import Snapshot


def ticked(controller: Controller) -> Snapshot:
    """Run a period; returns the state at its end."""
    controller.tick()
    return controller.snapshot
