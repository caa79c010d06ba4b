"""Secondary programs, which run alongside the main one, each within one control period."""

from typing import Final

from emulator.builtins.host import ProgramHost, ProgramServices
from emulator.machine import Machine
from urscript.compiler import CompiledProgram
from urscript.runtime import Runtime

_EXCEPTION: Final = "SECONDARY_PROGRAM_EXCEPTION_XXX"  # title observed on a real controller


class SecondaryPrograms:
    """Runs ``sec`` programs, each within one control period.

    Time stands still for a program whose socket is connecting. A controller waits for the peer's answer within its
    period; here, the answer arrives between two periods at the earliest.
    """

    def __init__(self, machine: Machine, services: ProgramServices) -> None:
        self._machine = machine
        self._services = services
        self._new: list[CompiledProgram] = []
        self._connecting: list[tuple[Runtime, ProgramHost]] = []

    def __bool__(self) -> bool:
        """Whether a program waits for its period, or for a connection."""
        return bool(self._new or self._connecting)

    def add(self, program: CompiledProgram) -> None:
        """Run a program in this period, or the next."""
        self._new.append(program)

    def clear(self) -> None:
        for _, host in self._connecting:
            host.sockets.close_all()
        self._new, self._connecting = [], []

    def run(self, main: "ProgramHost | None") -> None:
        """Run all programs; ``main``: host of the running main program, whose sockets they share."""
        if not self:
            return
        programs, self._new = self._new, []
        connecting, self._connecting = self._connecting, []
        for runtime, host in (*connecting, *(self._prepare(program, main) for program in programs)):
            runtime.step()
            if host.connecting and not runtime.finished:
                self._connecting.append((runtime, host))
            else:
                self._end(runtime, host, shared=main is not None and host.sockets is main.sockets)

    def _prepare(self, program: CompiledProgram, main: "ProgramHost | None") -> tuple[Runtime, ProgramHost]:
        host = ProgramHost(self._machine, self._services, name=program.name, secondary=True)
        if main is not None:
            host.sockets = main.sockets
        runtime = Runtime(program, host)
        host.attach(runtime)
        return runtime, host

    def _end(self, runtime: Runtime, host: ProgramHost, *, shared: bool) -> None:
        if (problem := _problem(runtime, runtime.program)) is not None:
            self._machine.messages.key(_EXCEPTION, problem)
        runtime.stop()
        host.withdraw_dialogues()
        if not shared:
            host.sockets.close_all()


def _problem(runtime: Runtime, program: CompiledProgram) -> str | None:
    if runtime.error is not None:
        return runtime.error.message
    return None if runtime.finished else f"{program.name} takes physical time: Runtime is too much behind"
