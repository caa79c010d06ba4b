"""A debuggee that can go back: copies of its process stand still at earlier statements, and go on from there."""

from collections.abc import Callable, Iterator
from typing import Any, Final

from emulator.branches import Copied
from emulator.debugger.debuggee import Breakpoint, Debuggee, Stop

_SLICE: Final = 250  # control periods between two copies, unless the program stops before
_MOST_COPIES: Final = 64  # then every second one is given up, except for the last ones
_AT_STATEMENTS: Final = ("breakpoint", "function breakpoint", "pause", "step")
_FOREVER: Final = 1_000_000


class Traveller:
    """A debuggee in a process of its own, and at other moments. Use it with ``with``.

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

    def __enter__(self) -> "Traveller":
        return self

    def __exit__(self, *_: object) -> None:
        self._now.close()
        for moment in self._moments.values():
            moment[0].close()

    def ask(self, name: str, *values: Any) -> Any:
        """Call a method of the debuggee, at the present moment. Raises what it raises."""
        return self._now.ask(name, *values)

    def begin(self) -> None:
        """Submit the programs."""
        self._now.ask("begin")
        self._keep()

    def set_breakpoints(self, lines: list[Breakpoint], functions: list[str], stop_on: list[str]) -> None:
        """Replace all breakpoints."""
        self._breakpoints = lines, functions, stop_on
        self._now.ask("set_breakpoints", *self._breakpoints)

    def go(self, mode: str) -> Iterator[Stop]:
        """Go on until the program stops; yields a stop without a reason whenever there is output, or time to look."""
        began = self.stop
        depth = self._depth(began.number)
        while True:
            wanted = "pause" if self._interrupted() else mode
            self.stop = self._now.ask("go", wanted, _SLICE, began.thread, depth)
            if self.stop.reason != "ended":
                self._keep()
            yield self.stop
            if self.stop.reason:
                return

    def back(self, mode: str) -> Stop:
        """Go back: by one statement of the thread, not into functions (over), or to a breakpoint (continue)."""
        threads, depths, lines = self._now.ask("history")
        here, thread = self.stop.number, self.stop.thread
        depth = depths[here] if here < len(depths) else 1
        wanted = {one.line: one for one in self._breakpoints[0] if not one.log}
        for number in range(min(here, len(lines)) - 1, -1, -1):
            if mode == "over" and thread in (threads[number], -1) and depths[number] <= depth:
                return self._to(number, "step")
            if mode == "continue" and lines[number] in wanted:
                stop = self._to(number, "breakpoint")
                condition = wanted[stop.line].condition
                if not condition or self.ask("evaluate", condition, stop.thread, 0) not in ("False", "0", "0.0"):
                    return stop
        return self._to(0, "entry")

    def _depth(self, number: int) -> int:
        _, depths, _ = self._now.ask("history")
        return depths[number] if 0 <= number < len(depths) else 0

    def _to(self, number: int, reason: str) -> Stop:
        """Be at the moment before a statement."""
        threads, _, lines = self._now.ask("history")
        origin = max(known for known in self._moments if known <= number)
        copy, standing = self._moments[origin]
        self._now.close()
        self._now = copy.copy()
        if not (standing and origin == number):
            self._now.ask("go", "to", _FOREVER, -1, 0, number)
        self.stop = Stop(reason, number, threads[number], lines[number])
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
