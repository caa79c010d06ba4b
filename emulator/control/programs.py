"""Verbs about programs and what they say."""

from collections.abc import Generator
from dataclasses import replace
from typing import Any

from emulator import dashboard
from emulator.control.base import ControlBase, Waiting
from emulator.control.verbs import BadArguments, verb
from emulator.programs.compiling import Submission
from emulator.programs.urcap import DriverAddress

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

    @verb
    def external_control(self) -> dict[str, str | int]:
        """Where External Control nodes ask for their program when they are played: host and port of the driver."""
        host, port = self.controller.external_control.complete
        return {"host": host, "port": port}

    @verb
    def set_external_control(self, host: str | None = None, port: int | None = None) -> None:
        """Fill in the URCap's page: where External Control nodes ask for their program from now on.

        What is left out is the installation's, or else the URCap's own, 192.168.56.1 and 50002.
        """
        if host is not None and (not host.strip() or any(letter.isspace() for letter in host.strip())):
            raise BadArguments(f"{host!r} is no host: give an address or a name")
        if port is not None and not 0 < port < 65536:
            raise BadArguments(f"there is no port {port}: they are 1 to 65535")
        address = DriverAddress(None if host is None else host.strip(), port)
        self.controller.config = replace(self.controller.config, external_control=address)


def _answered(answer: str | Waiting[str | None] | None) -> Waiting[str]:
    if isinstance(answer, Generator):
        answer = yield from answer
    return answer or ""


def _decided(submission: Submission) -> Waiting[bool]:
    while submission.accepted is None:
        yield
    return submission.accepted
