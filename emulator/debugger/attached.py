"""The debuggee of a running emulator, by its control API."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from typing import Any, Final

from emulator.debugger.debuggee import SHOWN
from emulator.programs.stepping import Breakpoint, Frame, Stop
from urproto.controlapi import ControlClient, NoControlError
from urscript.files import ScriptFile

_SLICE: Final = 25  # control periods of a call, after which the editor is asked for news

_ARGUMENTS: Final = {
    "stack": ("thread",),
    "evaluate": ("text", "thread", "frame"),
    "set_variable": ("name", "text", "thread", "frame"),
}


class Attached:
    """Programs that a running emulator starts from now on. Raises NoControlError, and OSError for the file.

    stop: where the program stands still. busy: whether a program ran already, which cannot be stopped.
    """

    def __init__(self, client: ControlClient, file: ScriptFile | None, interrupted: Callable[[], bool]) -> None:
        self._client = client
        self._interrupted = interrupted
        self.stop = Stop("", 0, 0, 0)
        main = next((unit for unit in file.units if not unit.secondary), None) if file is not None else None
        text, offset = ("", 0) if main is None else (main.text, main.lines_before)
        self.busy: bool = client.call("debug", {"text": text, "offset": offset})

    def ask(self, name: str, *values: Any, **named: Any) -> Any:
        """Ask what `SteppedProgram` or `Debuggee` answer, with values in the order of their arguments."""
        if name == "robot_state":
            state = self._client.call("state", {"names": ["timestamp", *SHOWN]})
            return {field: str(value) for field, value in state.items()}
        named |= dict(zip(_ARGUMENTS.get(name, ()), values, strict=True))
        answer = self._client.call("debug_ask", {"question": name, **named})
        if name == "stack":
            return [Frame(**frame) for frame in answer]
        return {int(number): text for number, text in answer.items()} if name == "threads" else answer

    def begin(self) -> None:
        """Nothing: programs start when somebody starts them."""

    def set_breakpoints(self, lines: list[Breakpoint], functions: list[str], stop_on: list[str]) -> None:
        """Replace all breakpoints."""
        arguments = {"lines": [asdict(one) for one in lines], "functions": functions, "stop_on": stop_on}
        self._client.call("debug_stops", arguments)

    def go(self, mode: str) -> Iterator[Stop]:
        """Go on until a program stops; yields a stop without a reason whenever there is output, or time to look."""
        began = self.stop
        while True:
            wanted = "pause" if self._interrupted() else mode
            where = {"mode": wanted, "periods": _SLICE, "thread": began.thread, "depth": began.depth}
            found = self._client.call("debug_go", where)
            self.stop = Stop(**{**found, "output": tuple(found["output"])})
            yield self.stop
            if self.stop.reason:
                return

    def close(self) -> None:
        """Let the program go on without stops."""
        with suppress(NoControlError):
            self._client.call("debug_end", {})
        self._client.close()
