"""Verbs about programs and what they say."""

from collections.abc import Generator
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from emulator.commands import dashboard
from emulator.control.verbs import BadArguments, Verbs, Waiting, verb
from emulator.programs.compiling import Submission, in_periods
from emulator.programs.loading import DRIVER_PROGRAMS, program_files
from emulator.services.urcap import DriverAddress
from urscript.polyscope.outline import OutlineNode, outline_steps
from urscript.polyscope.tree import TreeError
from urscript.work import Steps

if TYPE_CHECKING:
    from emulator.controller import Controller


class ProgramVerbs(Verbs):
    """Verbs about programs, the dashboard's lines and the log."""

    @verb
    def dashboard(self, line: str) -> str:
        """Carry out a line of the dashboard server; returns its answer."""
        return self._wait(_answered(dashboard.execute(self.controller, line)))

    @verb
    def send_script(self, text: str) -> bool:
        """Run a script as if it came on a script port; returns whether it starts, which the log explains."""
        return self._wait(_decided(self.controller.programs.submit(text)))

    @verb
    def programs(self) -> list[str]:
        """The program files of the programs folder, as ``load`` of the dashboard takes them."""
        folder = self.controller.config.programs_dir or DRIVER_PROGRAMS
        return self._wait(program_files(folder.resolve()))

    @verb
    def program(self) -> dict[str, Any]:
        """The main program that runs, else the loaded one.

        ``file``: the loaded one's, None when this is another; ``running``; ``text``: its script, whose lines
        ``script_control_line`` counts, empty while a program tree was not played; ``tree``: the nodes of a program
        tree with number (by which labels name them), depth, text and whether they are suppressed.
        """
        return self._wait(_shown_program(self.controller))

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
            raise BadArguments(f"{host!r} is not a host: give an address or a name")
        if port is not None and not 0 < port < 65536:
            raise BadArguments(f"there is no port {port}: they are 1 to 65535")
        address = DriverAddress(None if host is None else host.strip(), port)
        self.controller.config = replace(self.controller.config, external_control=address)


def _answered(answer: str | Waiting[str | None] | None) -> Waiting[str]:
    if isinstance(answer, Generator):
        answer = yield from answer
    return answer or ""


def _shown_program(controller: "Controller") -> Waiting[dict[str, Any]]:
    programs = controller.programs
    view, loaded = programs.view, programs.loaded
    running = view is not None and view.running
    of_file = loaded is not None and (not running or programs.loaded_ran)
    text = view.program.source if view is not None and (running or programs.loaded_ran or loaded is None) else ""
    shown = {"file": None, "running": running, "text": text, "tree": list[dict[str, Any]]()}
    if loaded is not None and of_file:
        shown |= {"file": loaded.path.name, "text": text or loaded.script}
        if loaded.tree is not None:
            steps = outline_steps(loaded.tree, controller.installation.file, controller.version)
            nodes = yield from in_periods(_or_nothing(steps), controller.period_s)
            shown["tree"] = [asdict(node) for node in nodes or ()]
    return shown


def _or_nothing(steps: Steps[list[OutlineNode]]) -> Steps[list[OutlineNode]]:
    """Another installation may have taken away what the tree needs."""
    try:
        return (yield from steps)
    except TreeError:
        return []


def _decided(submission: Submission) -> Waiting[bool]:
    while submission.accepted is None:
        yield
    return submission.accepted
