"""All verbs of a robot as one Python object; `emulator.control.live` adds those of its ports."""

from typing import TypeVar

from emulator.control.base import Waiting
from emulator.control.modes import ModeVerbs
from emulator.control.programs import ProgramVerbs
from emulator.control.signals import SignalVerbs
from emulator.control.state import StateVerbs
from emulator.control.timing import OwnPace, TimeVerbs
from emulator.controller import Controller, ControllerConfig

__all__ = ["Control", "VirtualRobot"]

_T = TypeVar("_T")


class Control(StateVerbs, SignalVerbs, ModeVerbs, ProgramVerbs, TimeVerbs):
    """The verbs of a robot."""


class VirtualRobot(Control):
    """A controller without ports in virtual time: ``step``, ``run_until`` and what waits make its time go by.

    robot = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    """

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__(Controller(config), OwnPace())

    def _wait(self, steps: Waiting[_T]) -> _T:
        while True:
            try:
                next(steps)
            except StopIteration as done:
                result: _T = done.value
                return result
            self.controller.tick()
