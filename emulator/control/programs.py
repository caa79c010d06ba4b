"""Verbs about programs, their files, variables and log."""

import base64
import binascii
from collections.abc import Generator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from emulator.commands import dashboard
from emulator.control.verbs import Verbs, Waiting, verb
from emulator.programs.compiling import Submission
from emulator.programs.loading import DRIVER_PROGRAMS, ensure_programs_folder, program_files
from emulator.programs.runner import Programs
from emulator.services.urcap import DriverAddress
from emulator.workshare import in_periods
from urproto.controlapi import BadArguments, NotPossible
from urproto.durable import writing
from urproto.modes import RuntimeState
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.program import OutlineNode, outline_steps
from urscript.polyscope.starting import StartingNode
from urscript.polyscope.tree import TreeError
from urscript.work import Steps

if TYPE_CHECKING:
    from emulator.controller import Controller


_SAVED: Final = (".urp", ".urpx", ".script", ".txt", ".variables", ".installation")  # the files that PolyScope writes
_LARGEST: Final = 2 << 20  # bytes of a file, which must fit into a request in base64; programs take about 10 kB


class ProgramVerbs(Verbs):
    """Verbs about programs, dashboard commands and the log."""

    @verb
    def dashboard(self, line: str) -> str:
        """Execute a dashboard command as if at the pendant, also on PolyScope X; returns its answer."""
        return self._wait(_answered(dashboard.execute(self.controller, line, at_pendant=True)))

    @verb
    def send_script(self, text: str) -> bool:
        """Run a script as if it came through a script port; returns whether it starts (the log says why not)."""
        return self._wait(_decided(self.controller.programs.submit(text)))

    @verb
    def programs(self) -> list[str]:
        """List the program files of the programs folder, with paths as for the dashboard's ``load``."""
        folder = self.controller.config.programs_dir or DRIVER_PROGRAMS
        return self._wait(program_files(folder.resolve()))

    @verb
    def save_program(self, path: str, data: str) -> str:
        """Write a file to the programs folder, completely or not at all; returns its path as for ``load``.

        ``path``: relative to the folder, ending in .urp, .script, .txt, .variables or .installation; subfolders are
        created as needed. ``data``: the content in base64, at most 2 MiB before encoding. A loaded program is not
        affected until it is loaded again. An emulator without ``--programs`` creates a temporary folder, which its log
        names.
        """
        ensure_programs_folder(self.controller)
        place = self._place(path)
        try:
            content = base64.b64decode(data, validate=True)
        except (binascii.Error, ValueError) as error:
            raise BadArguments(f"data is not base64: {error}") from error
        if len(content) > _LARGEST:
            raise BadArguments(f"{path}: files must not exceed {_LARGEST >> 20} MiB")
        return self._wait(self._stored(place, content, path))

    @verb
    def read_program(self, path: str) -> str:
        """Read a file of the programs folder; returns its content in base64. ``path`` as for ``save_program``."""
        place = self._place(path)
        try:
            if place.stat().st_size > _LARGEST:
                raise NotPossible(f"{path} is larger than {_LARGEST >> 20} MiB")
            return base64.b64encode(place.read_bytes()).decode()
        except OSError as error:
            raise NotPossible(f"{path} cannot be read: {error.strerror or error}") from error

    @verb
    def delete_program(self, path: str) -> bool:
        """Delete a file of the programs folder; returns whether it existed. ``path`` as for ``save_program``."""
        place = self._place(path)
        try:
            place.unlink()
        except FileNotFoundError:
            return False
        except OSError as error:
            raise NotPossible(f"{path} cannot be deleted: {error.strerror or error}") from error
        return True

    def _stored(self, place: Path, content: bytes, path: str) -> Waiting[str]:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            yield from writing(place, content)
        except OSError as error:
            raise NotPossible(f"{path} cannot be written: {error.strerror or error}") from error
        return self._name(place)

    def _place(self, path: str) -> Path:
        root = self.controller.config.programs_dir
        if root is None:
            raise NotPossible(f"{path}: this emulator has no programs folder: start it with --programs")
        place = ProgramsFolder(root).place(path)
        if place is None:
            raise BadArguments(f"{path!r} is not in the programs folder: give a path below it, for example job.urp")
        if place.suffix not in _SAVED:
            raise BadArguments(f"{path}: the name of a file in the programs folder must end in {', '.join(_SAVED)}")
        return place

    def _name(self, place: Path) -> str:
        root = self.controller.config.programs_dir
        assert root is not None
        return place.relative_to(root.resolve()).as_posix()

    @verb
    def breakpoints(self) -> list[int]:
        """List the breakpoints of the main program: numbers of nodes in the program tree."""
        return sorted(self.controller.programs.breakpoints.numbers)

    @verb
    def set_breakpoints(self, nodes: list[int]) -> None:
        """Replace the breakpoints: the main program pauses whenever it reaches one of these nodes.

        ``nodes``: numbers in the program tree, as in the program's labels (``$ 4 "Wait"``). At a waypoint the program
        pauses after reaching it, before it continues from there. ``play`` resumes the program. Loading another file
        clears the breakpoints.
        """
        if not all(0 < node < 1_000_000_000 for node in nodes):
            raise BadArguments(f"{nodes}: numbers of nodes begin at 1")
        self.controller.programs.breakpoints.set(nodes)

    @verb
    def step_program(self) -> bool:
        """Single step: resume or start the loaded program, and pause at the next node; returns whether it runs.

        Only labels mark nodes, so a script without labels runs to its end.
        """
        programs = self.controller.programs
        if programs.state is RuntimeState.PLAYING:
            raise NotPossible("the program is running: pause it first")
        return self._wait(_stepped(programs))

    @verb
    def play_from(self, node: int) -> bool:
        """Start the loaded program tree at a node, by its number; returns whether it starts (the log says why not).

        Nodes before it are skipped, at its own level and at each enclosing level; loops return to them. Variables have
        their initial values, BeforeStart is executed, threads and events run. Refused for nodes that are suppressed,
        outside the robot program, or inside a node that can only be started as a whole.
        """
        programs = self.controller.programs
        tree = None if programs.loaded is None else programs.loaded.tree
        if tree is None:
            raise NotPossible("no program tree is loaded: load a .urp file first")
        if programs.busy:
            raise NotPossible("a program is running or paused: stop it first")
        try:
            StartingNode(tree, node)
        except TreeError as error:
            raise NotPossible(str(error)) from error
        return self._wait(_decided(programs.play(node)))

    @verb
    def program(self) -> dict[str, Any]:
        """The main program that is running, otherwise the loaded one.

        ``file``: the loaded file, None if another program is running; ``running``: whether it runs; ``text``: its
        script, to whose lines ``script_control_line`` refers, empty until a program tree is played; ``tree``: the nodes
        of a program tree with number (as in labels), depth, text, and whether they are suppressed.
        """
        return self._wait(_shown_program(self.controller))

    @verb
    def variables(self) -> dict[str, Any]:
        """The global variables of the running program, with their values as text."""
        return {name: str(value) for name, value in self.controller.programs.variables.items()}

    @verb
    def log(self, lines: int = 100) -> list[str]:
        """The last lines of the controller's log, oldest first."""
        history = self.controller.messages.history
        return list(history)[-lines:] if lines > 0 else []

    @verb
    def external_control(self) -> dict[str, str | int]:
        """Host and port of the driver from which External Control nodes request their program."""
        host, port = self.controller.external_control.complete
        return {"host": host, "port": port}

    @verb
    def set_external_control(self, host: str | None = None, port: int | None = None) -> None:
        """Set the driver (host, port) from which External Control nodes request their program, as on the URCap's page.

        Omitted values are those of the installation, or else the URCap's defaults, 192.168.56.1 and 50002.
        """
        if host is not None and (not host.strip() or any(letter.isspace() for letter in host.strip())):
            raise BadArguments(f"{host!r} is not a host: give an address or a name")
        if port is not None and not 0 < port < 65536:
            raise BadArguments(f"there is no port {port}: choose 1 to 65535")
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
            nodes = yield from in_periods(_empty_if_unfit(steps), controller.work)
            shown["tree"] = [asdict(node) for node in nodes or ()]
        else:
            shown["tree"] = [asdict(node) for node in loaded.outline]
    return shown


def _empty_if_unfit(steps: Steps[list[OutlineNode]]) -> Steps[list[OutlineNode]]:
    """No nodes if the tree does not fit the installation, which may have changed since the tree was loaded."""
    try:
        return (yield from steps)
    except TreeError:
        return []


def _stepped(programs: Programs) -> Waiting[bool]:
    programs.breakpoints.step()
    accepted = yield from _decided(programs.play())
    if not accepted:
        programs.breakpoints.program_stopped()
    return accepted


def _decided(submission: Submission) -> Waiting[bool]:
    while submission.accepted is None:
        yield
    return submission.accepted
