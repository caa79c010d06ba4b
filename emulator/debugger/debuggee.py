"""A program that is being debugged: it runs on a robot in virtual time, and stands still within a period when it stops.

Each statement of the main program has a number, in the order of their execution. The run is deterministic, so a number
always means the same statement of the same moment.
"""

import sys
from array import array
from collections.abc import Collection
from types import FrameType
from typing import Final

from emulator.branches import Server
from emulator.builtins.host import ProgramHost
from emulator.peers.connection import Peers
from emulator.programs.stepping import SteppedProgram, Stop, Wish, program_frames
from emulator.snapshot import Snapshot
from emulator.virtual import VirtualRobot
from urproto.modes import RuntimeState
from urscript.files import ScriptFile
from urscript.runtime import ScriptThread

SHOWN: Final = (
    *("actual_q", "actual_TCP_pose", "robot_mode", "safety_mode"),
    *("actual_digital_input_bits", "actual_digital_output_bits"),
)
"""The robot's state beside the variables."""

_ANY: Final = -1  # thread


class Debuggee(SteppedProgram):
    """One run of a file of programs. server: set by the process in which it is. Raises ValueError, OSError."""

    def __init__(self, robot: VirtualRobot, file: ScriptFile, peers: Peers | None = None) -> None:
        super().__init__()
        self.server: Server | None = None
        self._robot = robot
        self._file = file
        if peers is not None:
            robot.connect(peers)
        self._left = 0
        self._threads, self._levels, self._lines = array("i"), array("i"), array("i")  # of all statements so far
        self._thread: ScriptThread | None = None  # that executed a statement last
        self._frames: list[FrameType] = []
        main = [unit for unit in file.units if not unit.secondary]
        self.offset = main[0].lines_before if main else 0
        robot.controller.programs.step_hook = self._statement
        robot.controller.subscribe(self._look)

    # what the adapter calls

    def begin(self) -> None:
        """Submit the programs, which start as time goes on."""
        for unit in self._file.units:
            self._robot.controller.programs.submit(unit.text)

    def go(self, mode: str, periods: int, thread: int = -1, depth: int = 0, number: int = 0) -> Stop:
        """Go on: at most for a number of control periods, after which the stop has no reason."""
        self._want(mode, periods, thread, depth, number)
        while self._left > 0:
            self._left -= 1
            self._robot.step(1)
            if (stop := self.problem_stop()) is not None:
                self._pause(stop)
            if not self._robot.controller.programs.busy:
                text = "" if self.number else self._robot.log(1)[0]
                return self.said(Stop("ended", self.number, _ANY, 0, text=text))
        return self.said(Stop("", self.number, _ANY, 0))

    def robot_state(self) -> dict[str, str]:
        """Where the robot is: time [s], joint angles [rad], pose [m, rad], modes, I/O."""
        state = self._robot.state(SHOWN)
        return {"time_s": f"{self._robot.controller.time_s:.3f}"} | {name: str(value) for name, value in state.items()}

    def statement(self, number: int) -> Stop:
        """A statement so far, by its number."""
        return Stop("", number, self._threads[number], self._lines[number], self._levels[number])

    def earlier(self, stop: Stop, lines: Collection[int]) -> Stop | None:
        """The last statement before a stop that is on one of these lines; without any, the one before of its thread,
        which is not within a function that it has called.
        """
        for number in range(min(stop.number, len(self._lines)) - 1, -1, -1):
            if lines:
                found = self._lines[number] in lines
            else:
                found = stop.thread in (self._threads[number], _ANY) and self._levels[number] <= stop.depth
            if found:
                return self.statement(number)
        return None

    @property
    def checksum(self) -> str:
        """A digest of all values of the robot and of the program's variables, to compare moments."""
        return repr((self._robot.state(), self.globals(), self.number))

    # within a control period

    def _statement(self, host: ProgramHost, line: int, column: int, thread: ScriptThread) -> bool:
        """A thread is about to execute a statement."""
        if host.secondary:
            return False
        self.runtime, self._thread = host.runtime, thread
        frames = program_frames(sys._getframe(1))
        place, depth = line + self.offset, len(frames)
        self._threads.append(thread.id)
        self._levels.append(depth)
        self._lines.append(place)
        if reason := self.reason(thread.id, place, frames):
            self._frames = frames
            self._pause(Stop(reason, self.number, thread.id, place, depth))
            self._frames = []
        self.number += 1
        return False

    def _pause(self, stop: Stop) -> None:
        assert self.server is not None, "it is in a process of its own"
        values, named = self.server.pause("go", self.said(stop))
        self._want(*values, **named)

    def _want(self, mode: str, periods: int, thread: int = -1, depth: int = 0, number: int = 0) -> None:
        self.wish, self._left = Wish(mode, thread, depth, number), periods

    def _look(self, snapshot: Snapshot) -> None:
        self.look(snapshot, stopped=self._robot.controller.safety.stopped)
        if snapshot.runtime_state == RuntimeState.STOPPED:
            self._thread = None

    def frames_of(self, number: int) -> list[FrameType]:
        """The frames of a thread, innermost first: also of the one that is within a statement now."""
        if self._thread is not None and number == self._thread.id and self._frames:
            return self._frames
        return super().frames_of(number)
