"""Faults of programs."""

from typing import TYPE_CHECKING, Annotated, ClassVar

from msgspec import Meta

from emulator.faults.fault import Act, Fault, Site, Strikes, register
from urscript.errors import RuntimeFault

if TYPE_CHECKING:
    from emulator.builtins.host import ProgramHost
    from urscript.runtime import ScriptThread


@register
class ProgramNeverStarts(Fault):
    """Programs are accepted but do not start; the last one starts when the fault ends."""

    def claims(self, site: Site) -> set[str]:
        return {"the start of programs"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        programs = site.controller.programs
        programs.start_held = True
        try:
            while True:
                yield
        finally:
            programs.start_held = False


@register
class ProgramStuck(Fault):
    """The program is playing but makes no progress; a movement that has begun is completed."""

    def claims(self, site: Site) -> set[str]:
        return {"the frames of programs"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        programs = site.controller.programs
        programs.frames_held = True
        try:
            while True:
                yield
        finally:
            programs.frames_held = False


@register
class RuntimeException(Fault):
    """The program ends with a runtime exception when it is about to execute ``line``, once by default.

    It affects only programs that start while the fault is in force, because others do not check each line. Lines are
    counted from 1.
    """

    occasion: ClassVar[str] = "each time a program reaches the line"
    line: Annotated[int, Meta(ge=1)]
    message: str = "injected fault"
    once: bool = True

    def claims(self, site: Site) -> set[str]:
        return {"the steps of programs"}

    def act(self, site: Site, strikes: Strikes) -> Act:
        programs = site.controller.programs
        hook_before = programs.step_hook

        def check_line(host: "ProgramHost", line: int, column: int, thread: "ScriptThread") -> bool:
            if line == self.line and not host.secondary and strikes():
                raise RuntimeFault(self.message)
            return hook_before is not None and hook_before(host, line, column, thread)

        programs.step_hook = check_line
        try:
            while not strikes.spent:
                yield
        finally:
            if programs.step_hook is check_line:
                programs.step_hook = hook_before
