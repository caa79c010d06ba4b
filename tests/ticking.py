"""Control periods, one by one."""

from emulator.clock import Tick
from emulator.controller import Controller
from emulator.snapshot import Snapshot


def ticked(controller: Controller) -> Snapshot:
    """Run a period; returns the state at its end."""
    controller.tick()
    return controller.snapshot


class StepClock:
    """A clock of which time advances only in ``step``."""

    last_tick_s = 0.0

    def __init__(self) -> None:
        self._tick: Tick | None = None

    def start(self, tick: Tick) -> None:
        self._tick = tick

    def step(self, periods: int = 1) -> None:
        """Let control periods pass. Raises RuntimeError before ``start``."""
        if self._tick is None:
            raise RuntimeError("the clock was not started: enter the emulator's context first")
        for _ in range(periods):
            self._tick()

    def close(self) -> None:
        self._tick = None
