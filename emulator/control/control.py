"""All verbs of a robot as one Python object; `emulator.control.live` adds those of its ports."""

from typing import TypeVar

from emulator.control.base import Waiting
from emulator.control.faults import FaultVerbs
from emulator.control.modes import ModeVerbs
from emulator.control.programs import ProgramVerbs
from emulator.control.signals import SignalVerbs
from emulator.control.state import StateVerbs
from emulator.control.timing import OwnPace, Pace, TimeVerbs
from emulator.control.world import WorldVerbs
from emulator.controller import Controller, ControllerConfig
from emulator.faults.injector import FaultInjector
from emulator.faults.reboot import rebooted, show_gone

__all__ = ["Control", "VirtualRobot"]

_T = TypeVar("_T")


class Control(StateVerbs, SignalVerbs, ModeVerbs, WorldVerbs, ProgramVerbs, TimeVerbs, FaultVerbs):
    """The verbs of a robot."""

    def __init__(self, controller: Controller, pace: Pace, faults: FaultInjector) -> None:
        super().__init__(controller, pace)
        self._faults = faults


class VirtualRobot(Control):
    """A controller without ports in virtual time: ``step``, ``run_until`` and what waits make its time go by.

    robot = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    """

    def __init__(self, config: ControllerConfig) -> None:
        controller = Controller(config)
        super().__init__(controller, OwnPace(), FaultInjector(controller, machine=self))
        self._power_wanted = True
        self._periods_off = 0
        self._boot_s = 0.0

    def switch_off(self, *, silent: bool) -> None:
        """The controller is gone after this period: a fault."""
        self._power_wanted = False

    def switch_on(self, boot_s: float) -> None:
        """A new controller boots; its uptime begins at 0."""
        self._power_wanted, self._boot_s = True, boot_s

    def _period(self) -> None:
        """One control period, with or without a controller."""
        if self._periods_off:
            self._periods_off += 1
            self._faults.step()
            if self._power_wanted:
                self._come_back()
            return
        self.controller.tick()
        if not self._power_wanted:
            self._periods_off = 1
            self._faults.controller_gone()
            self.controller.programs.stop("the controller ended")
            show_gone(self.controller)

    def _come_back(self) -> None:
        before, periods, self._periods_off = self.controller, self._periods_off, 0
        self.controller = rebooted(before, self._boot_s, periods * before.period_s)
        self.controller.programs.socket_backend = before.programs.socket_backend
        self._faults.controller_back(self.controller)

    def _wait(self, steps: Waiting[_T]) -> _T:
        while True:
            try:
                next(steps)
            except StopIteration as done:
                result: _T = done.value
                return result
            self._period()
