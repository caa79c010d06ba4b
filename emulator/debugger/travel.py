"""A debuggee that can go back: copies of its process stand still at earlier statements, and go on from there."""

from collections.abc import Callable, Iterator
from typing import Any, Final

from emulator.branches import Copied
from emulator.debugger.debuggee import Debuggee
from emulator.programs.stepping import Breakpoint, Stop

_SLICE: Final = 250  # control periods between two copies, unless the program stops before
_MOST_COPIES: Final = 64  # then every second one is given up, except for the last ones
_AT_STATEMENTS: Final = ("breakpoint", "function breakpoint", "pause", "step")
_FOREVER: Final = 1_000_000


class Traveller:
    """A debuggee in a process of its own, and at other moments.

    stop: where the program stands still. interrupted: called between slices; whether it is to stop now.
    """

    def __init__(self, debuggee: Debuggee, interrupted: Callable[[], bool] = lambda: False) -> None:
        self._interrupted = interrupted
        self._now = Copied.of(debuggee)
        self._moments: dict[
            int, tuple[Copied, bool]
        ] = {}  # by statement; whether they stand at it, or before its period
        self._breakpoints: tuple[list[Breakpoint], list[str], list[str]] = ([], [], [])
        self.stop = Stop("", 0, 0, 0)

    def close(self) -> None:
        """End all copies."""
        self._now.close()
        for moment in self._moments.values():
            moment[0].close()

    def ask(self, name: str, *values: Any, **named: Any) -> Any:
        """Call a method of the debuggee, at the present moment. Raises what it raises."""
        return self._now.ask(name, *values, **named)

    def begin(self) -> None:
        self._now.ask("begin")
        self._keep()

    def set_breakpoints(self, lines: list[Breakpoint], functions: list[str], stop_on: list[str]) -> None:
        self._breakpoints = lines, functions, stop_on
        self._now.ask("set_breakpoints", *self._breakpoints)

    def go(self, mode: str) -> Iterator[Stop]:
        """Go on until the program stops; yields a stop without a reason whenever there is output, or time to look."""
        began = self.stop
        while True:
            wanted = "pause" if self._interrupted() else mode
            self.stop = self._now.ask("go", wanted, _SLICE, began.thread, began.depth)
            if self.stop.reason != "ended":
                self._keep()
            yield self.stop
            if self.stop.reason:
                return

    def back(self, mode: str) -> Stop:
        """Go back: by one statement of the thread, not into functions (over), or to a breakpoint (continue)."""
        wanted = {one.line: one for one in self._breakpoints[0] if not one.log} if mode == "continue" else {}
        if mode == "continue" and not wanted:
            return self._to(self._now.ask("statement", 0), "entry")
        place = self.stop
        while (found := self._now.ask("earlier", place, set(wanted))) is not None:
            if not wanted:
                return self._to(found, "step")
            place = self._to(found, "breakpoint")
            condition = wanted[place.line].condition
            if not condition or self.ask("evaluate", condition, place.thread, 0) not in ("False", "0", "0.0"):
                return place
        return self._to(self._now.ask("statement", 0), "entry")

    def _to(self, place: Stop, reason: str) -> Stop:
        """Be at the moment before an earlier statement."""
        origin = max(known for known in self._moments if known <= place.number)
        copy, standing = self._moments[origin]
        self._now.close()
        self._now = copy.copy()
        if not (standing and origin == place.number):
            self._now.ask("go", "to", _FOREVER, -1, 0, place.number)
        self.stop = place._replace(reason=reason)
        self._now.ask("set_breakpoints", *self._breakpoints)
        return self.stop

    def _keep(self) -> None:
        number = self.stop.number
        if number in self._moments:
            return
        self._moments[number] = self._now.copy(), self.stop.reason in _AT_STATEMENTS
        if len(self._moments) > _MOST_COPIES:
            for old in sorted(self._moments)[1:-16:2]:
                self._moments.pop(old)[0].close()
