"""Secondary programs: beside the main one, each for one control period.

Such a program uses the sockets of the main program that runs, since the Script Manual allows it a single send but no
time to open one.
"""

from typing import TYPE_CHECKING, Final

from emulator.programs.host import ProgramHost
from urscript.compiler import CompiledProgram
from urscript.runtime import Runtime

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["SecondaryPrograms"]

_EXCEPTION: Final = "SECONDARY_PROGRAM_EXCEPTION_XXX"  # title seen on a real controller


class SecondaryPrograms:
    """waiting: for the next control period."""

    def __init__(self, controller: "Controller") -> None:
        self._controller = controller
        self.waiting: list[CompiledProgram] = []

    def add(self, program: CompiledProgram) -> None:
        """Run a program in this period, or the next."""
        self.waiting.append(program)

    def run(self, main: ProgramHost | None) -> None:
        """All that wait; ``main``: the host of the main program that runs."""
        if not self.waiting:
            return
        programs, self.waiting = self.waiting, []
        for program in programs:
            self._run_one(program, main)

    def _run_one(self, program: CompiledProgram, main: ProgramHost | None) -> None:
        host = ProgramHost(self._controller, name=program.name, secondary=True)
        if main is not None:
            host.sockets = main.sockets
        runtime = Runtime(program, host)
        host.attach(runtime)
        runtime.step()
        if (wrong := _what_went_wrong(runtime, program)) is not None:
            self._controller.messages.key(_EXCEPTION, wrong)
        runtime.stop()
        host.withdraw_dialogues()
        if main is None:
            host.sockets.close_all()


def _what_went_wrong(runtime: Runtime, program: CompiledProgram) -> str | None:
    if runtime.error is not None:
        return runtime.error.message
    return None if runtime.finished else f"{program.name} takes physical time: Runtime is too much behind"
