"""The loaded program: choosing it, and making of it what is submitted when it is played.

A program with External Control nodes can be compiled when its driver has sent what they do
(`emulator.programs.urcap`). A stop, or another program, ends the waiting.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from emulator.programs.compiling import Submission
from emulator.programs.loading import LoadedProgram, load_steps
from emulator.programs.trees.program import ProgramTree, script_steps
from emulator.programs.urcap import ProgramRequest
from urscript.compiler import CompiledProgram
from urscript.work import Steps

if TYPE_CHECKING:
    from emulator.controller import Controller

__all__ = ["Player"]


@dataclass(frozen=True, slots=True)
class _Asked:
    """A program that waits for what a driver sends."""

    submission: Submission
    tree: ProgramTree
    request: ProgramRequest


class Player:
    """What ``play`` starts. ``loaded``: the chosen program."""

    def __init__(self, controller: "Controller") -> None:
        self.loaded: LoadedProgram | None = None
        self._played: Submission | None = None
        self._controller = controller
        self._asked: _Asked | None = None

    @property
    def waiting(self) -> Submission | None:
        """The submission that waits for its driver."""
        return None if self._asked is None else self._asked.submission

    def load_steps(self, path: Path, *, by_default: bool = False) -> Steps[None]:
        """Choose a program, in pieces for a control loop. by_default: unless another one is chosen by then.

        The installation that a program tree was saved with is loaded too, if it is in the programs
        folder. Raises ProgramLoadError or OSError; then what was loaded remains.
        """
        controller = self._controller
        loaded = yield from load_steps(
            path, controller.config.programs_dir, controller.installation.file, controller.version
        )
        if by_default and self.loaded is not None:
            return
        for note in loaded.notes:
            controller.messages.note(note)
        if loaded.installation is not None:
            controller.apply_installation(*loaded.installation)
        self.loaded, self._played = loaded, None

    def made(self, program: CompiledProgram) -> bool:
        """Whether this program is the loaded one, as it was last played."""
        return self._played is not None and self._played.program is program

    def submission(self, *, stepped: bool) -> Submission | None:
        """What to compile now, or ``waiting`` if its driver has to be asked first; None without a loaded program."""
        if self.loaded is None:
            return None
        tree = self.loaded.tree
        submission = self._played = Submission(self.loaded.script, self._controller.version, stepped)
        if tree is None:
            return submission
        if tree.needs_external_control:
            self._ask(tree, submission)
        else:
            file, version = self._controller.installation.file, self._controller.version
            submission.translation = script_steps(tree, file, version=version)
        return submission

    def step(self) -> Submission | None:
        """Once a control period: the submission whose driver has answered by now."""
        asked = self._asked
        code = None if asked is None else asked.request.step()
        if asked is None or code is None:
            return None
        self._asked = None
        file, version = self._controller.installation.file, self._controller.version
        asked.submission.translation = script_steps(asked.tree, file, version=version, external_control=code)
        return asked.submission

    def drop(self) -> bool:
        """Wait for no driver any more; False when none was asked."""
        asked, self._asked = self._asked, None
        if asked is None:
            return False
        asked.request.close()
        asked.submission.accepted = False
        return True

    def _ask(self, tree: ProgramTree, submission: Submission) -> None:
        controller = self._controller
        address = controller.external_control.complete
        controller.messages.note(f"External Control asks {address[0]}:{address[1]} for its program")
        request = ProgramRequest(controller.programs.socket_backend, address, controller.period_s)
        self._asked = _Asked(submission, tree, request)
