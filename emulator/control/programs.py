"""Verbs about programs and what they say."""

from collections.abc import Generator
from typing import Any

from emulator import dashboard
from emulator.control.base import ControlBase, Waiting
from emulator.control.verbs import verb
from emulator.programs.compiling import Submission

__all__ = ["ProgramVerbs"]


class ProgramVerbs(ControlBase):
    """Verbs about programs, the dashboard's lines and the log."""

    @verb
    def dashboard(self, line: str) -> str:
        """Carry out a line of the dashboard server; its answer."""
        return self._wait(_answered(dashboard.execute(self.controller, line)))

    @verb
    def send_script(self, text: str) -> bool:
        """Run a script as if it came on a script port; whether it starts, which the log explains."""
        return self._wait(_decided(self.controller.programs.submit(text)))

    @verb
    def variables(self) -> dict[str, Any]:
        """The global variables of the running program, as text."""
        return {name: str(value) for name, value in self.controller.programs.variables.items()}

    @verb
    def log(self, lines: int = 100) -> list[str]:
        """The last lines of the controller's log, oldest first."""
        history = self.controller.messages.history
        return list(history)[-lines:] if lines > 0 else []


def _answered(answer: str | Waiting[str | None] | None) -> Waiting[str]:
    if isinstance(answer, Generator):
        answer = yield from answer
    return answer or ""


def _decided(submission: Submission) -> Waiting[bool]:
    while submission.accepted is None:
        yield
    return submission.accepted
