"""All verbs of a robot as one Python object.

    with_ports: emulator.servers.control.ControlServer serves one over HTTP
    without:    VirtualRobot, whose time goes by only in its verbs
"""

from typing import Final, TypeVar

from emulator.control.base import Waiting
from emulator.control.modes import ModeVerbs
from emulator.control.programs import ProgramVerbs
from emulator.control.signals import SignalVerbs
from emulator.control.state import StateVerbs
from emulator.control.timing import TimeVerbs
from emulator.control.verbs import NotPossible, Verb, verbs_of
from emulator.controller import Controller, ControllerConfig

__all__ = ["VERBS", "Control", "VirtualRobot"]

_T = TypeVar("_T")


class Control(StateVerbs, SignalVerbs, ModeVerbs, ProgramVerbs, TimeVerbs):
    """The verbs of a robot."""


VERBS: Final[dict[str, Verb]] = verbs_of(Control)


class _OwnPace:
    """Time that goes by only when it is told to."""

    speed = float("inf")
    paused = True

    def set_speed(self, speed: float) -> None:
        raise NotPossible("the time of this robot goes by in its verbs only, as fast as it can")

    def pause(self) -> None:
        """It is paused already."""

    def resume(self) -> None:
        """What goes by is up to the verb."""


class VirtualRobot(Control):
    """A controller without ports in virtual time: ``step``, ``run_until`` and what waits make its time go by.

    robot = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    """

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__(Controller(config), _OwnPace())

    def _wait(self, steps: Waiting[_T]) -> _T:
        while True:
            try:
                next(steps)
            except StopIteration as done:
                result: _T = done.value
                return result
            self.controller.tick()
