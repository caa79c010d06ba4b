"""What other parts of the controller see of a main program."""

from urproto.primary.messages import ProgramThread
from urscript.compiler import CompiledProgram
from urscript.runtime import Runtime
from urscript.values import Value


class ProgramView:
    """A view of a main program. ``number`` counts started programs, so that two runs of one program differ."""

    def __init__(self, number: int, runtime: Runtime) -> None:
        self.number = number
        self._runtime = runtime

    @property
    def program(self) -> CompiledProgram:
        return self._runtime.program

    @property
    def running(self) -> bool:
        return not self._runtime.finished

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the global variables."""
        return self._runtime.program.global_names

    def values(self, start: int, stop: int) -> list[Value]:
        """Values of a range of variables, in the order of the names; None for those without a value."""
        return self._runtime.values(start, stop)

    @property
    def labelled(self) -> bool:
        return bool(self._runtime.program.labels)

    @property
    def threads(self) -> tuple[ProgramThread, ...]:
        """Present label of each thread; number 0 and no text before its first label."""
        return tuple(
            ProgramThread(*(thread.label or (0, "")), thread.name.removeprefix("t_"))
            for thread in self._runtime.threads
        )

    @property
    def lines(self) -> tuple[tuple[str, int], ...]:
        """Name of each thread, "" for the program's body, and the line that it is executing; 0 before its first."""
        return tuple(
            (thread.name.removeprefix("t_") if thread.id else "", thread.line) for thread in self._runtime.threads
        )
