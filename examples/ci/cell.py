"""The application under test: a robot that moves between two places and comes back from what goes wrong.

Everything that touches the robot is ur_rtde and the dashboard; nothing here knows of emulators.
"""

import time
from collections.abc import Callable, Sequence
from types import TracebackType

from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOME = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
FAR = (1.4, -1.4, 1.5, -1.7, -1.5, 0.1)
RUNNING = "Robotmode: RUNNING"
WATCHDOG_HZ = 1.0
EXPLANATION_S = 1.0  # the state comes over another connection than the end of a move
PATIENCE_S = 30.0


class CellError(Exception):
    """The robot needs somebody; the text says why."""


class Cell:
    """A robot at an address. ``stale_after_s``: how long its state may stand still before it counts as lost."""

    def __init__(self, host: str, stale_after_s: float = 0.5) -> None:
        self.stale_after_s = stale_after_s
        self.dashboard = DashboardClient(host)
        self.dashboard.connect()
        self.receive = RTDEReceiveInterface(host)
        self.control = RTDEControlInterface(host)
        self._last = (self.receive.getTimestamp(), time.monotonic())

    def __enter__(self) -> "Cell":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for interface in (self.control, self.receive, self.dashboard):
            interface.disconnect()

    def is_online(self) -> bool:
        """Whether states of the robot still come. Call it regularly."""
        stamp, seen = self._last
        newest = self.receive.getTimestamp()
        if newest != stamp:
            self._last = (newest, time.monotonic())
            return True
        return time.monotonic() - seen < self.stale_after_s

    def move(self, q_rad: Sequence[float], speed: float = 1.0) -> None:
        """Go there. Raises CellError when the robot was stopped on the way."""
        if not self.control.moveJ(list(q_rad), speed, 4.0):
            raise CellError(f"the move was ended: {self._reason()}")

    def guard(self) -> None:
        """From now on the robot stops by itself unless ``kick`` is called in time."""
        if not self.control.setWatchdog(WATCHDOG_HZ):
            raise CellError("the watchdog cannot be set")

    def kick(self) -> None:
        """Tell the robot that we are there."""
        self.control.kickWatchdog()

    def stop_reason(self) -> str:
        """What stops the robot, "" for nothing."""
        if self.receive.isEmergencyStopped():
            return "emergency stop"
        return "protective stop" if self.receive.isProtectiveStopped() else ""

    def _reason(self) -> str:
        deadline = time.monotonic() + EXPLANATION_S
        while not (stop_reason := self.stop_reason()) and time.monotonic() < deadline:
            time.sleep(0.02)
        return stop_reason or "the program stopped"

    def recover(self) -> None:
        """Bring the robot back to where it moves. Raises CellError while the emergency stop is pressed."""
        if self.receive.isEmergencyStopped():
            raise CellError("the emergency stop is pressed: release it first")
        if self.receive.isProtectiveStopped():
            self._until(self._unlocked, "the protective stop cannot be unlocked")
        if self.dashboard.robotmode() != RUNNING:
            self.dashboard.powerOn()
            self.dashboard.brakeRelease()
            self._until(lambda: self.dashboard.robotmode() == RUNNING, "the brakes are not released")
        self.dashboard.stop()
        if not self.control.reuploadScript():
            raise CellError("the control script does not start again")
        self._until(self.control.isProgramRunning, "the control script does not run")

    def _unlocked(self) -> bool:
        """Controllers unlock no sooner than 5 s after the stop."""
        try:
            self.dashboard.closeSafetyPopup()
            self.dashboard.unlockProtectiveStop()
        except RuntimeError:
            return False
        return not self.receive.isProtectiveStopped()

    @staticmethod
    def _until(condition: Callable[[], bool], failure: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline:
                raise CellError(failure)
            time.sleep(0.02)
