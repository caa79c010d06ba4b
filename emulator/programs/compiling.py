"""Compiles the texts that clients submit, in slices, so that no control period takes too long."""

from collections import deque
from dataclasses import dataclass
from typing import Final

from emulator.builtins import LIBRARIES
from emulator.workshare import Job, WorkShare
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.compiler import CompiledProgram, CompiledPrograms, compile_steps, let_go
from urscript.errors import CompileError
from urscript.parser import is_secondary
from urscript.polyscope.tree import TreeError
from urscript.work import Steps, gc_paused

LIBRARY_SET: Final = LibrarySet(LIBRARIES)

_MANY_VARIABLES: Final = 1000


@dataclass(eq=False, slots=True)
class Submission:
    """A text submitted by a client. ``accepted`` is None until it is decided whether it runs.

    ``of_file``: it is that of the loaded program, which is played. ``translation``: creates the text from a program
    tree. ``refusal``: reason why that failed. ``origin``: what it is and who sent it, for the log; empty if nobody has
    to be told that it was refused.
    """

    text: str
    version: PolyscopeVersion
    stepped: bool = False
    of_file: bool = False
    accepted: bool | None = None
    program: CompiledProgram | None = None
    error: CompileError | None = None
    translation: Steps[str] | None = None
    refusal: str = ""
    origin: str = ""

    @property
    def main(self) -> bool:
        """False for a ``sec`` program, which runs alongside the main one."""
        return not is_secondary(self.text)


class CompiledTexts:
    """What a robot has compiled: the same text takes it no time again, as drivers send it again and again.

    libraries: the functions that its programs can call.
    """

    def __init__(self) -> None:
        self.libraries = LIBRARY_SET
        self._programs = CompiledPrograms()

    def compile(self, text: str, version: PolyscopeVersion, *, stepped: bool = False) -> Steps[CompiledProgram]:
        """Compile a program for this robot, in steps. Raises CompileError."""
        key = (text, self.libraries, version, stepped)
        program = self._programs.get(key)
        if program is None:
            program = yield from compile_steps(*key[:3], stepped=stepped)
            let_go(self._programs.add(key, program))
        return program


class Compiling:
    """Queue of submissions to be compiled, in order. texts: what this robot has compiled."""

    def __init__(self, share: WorkShare) -> None:
        self.texts = CompiledTexts()
        self._share = share
        self._waiting: deque[Submission] = deque()
        self._job: Job[CompiledProgram] | None = None  # compiles the first waiting submission

    @property
    def waiting(self) -> tuple[Submission, ...]:
        """Submissions that are not compiled yet, oldest first."""
        return tuple(self._waiting)

    def add(self, submission: Submission) -> None:
        """Compile a text after those already waiting."""
        self._waiting.append(submission)

    def drop_main(self) -> bool:
        """Refuse every waiting main program; returns False if there is none."""
        dropped = [submission for submission in self._waiting if submission.main]
        if self._waiting and self._waiting[0].main:
            self._cancel_job()
        for submission in dropped:
            self._waiting.remove(submission)
            submission.accepted = False
        return bool(dropped)

    def abandon(self) -> None:
        """Refuse all waiting submissions."""
        self._cancel_job()
        waiting = tuple(self._waiting)
        self._waiting.clear()
        for submission in waiting:
            submission.accepted = False

    def _cancel_job(self) -> None:
        if self._job is not None:
            self._job.steps.close()
            self._job = None

    def next(self) -> Submission | None:
        """The next submission that is compiled or has an error; None if it needs another period."""
        if not self._waiting:
            return None
        submission = self._waiting[0]
        if self._job is None:
            self._job = Job(self._work(submission))
        try:
            if not self._share.work(self._job):
                return None
            submission.program = self._job.result
        except CompileError as error:
            submission.error = error.with_traceback(None)  # its frames would keep all intermediate results alive
        except TreeError as error:
            submission.refusal = str(error)
        self._job = None
        return self._waiting.popleft()

    def _work(self, submission: Submission) -> Steps[CompiledProgram]:
        with gc_paused():
            if submission.translation is not None:
                submission.text = yield from submission.translation
            program = yield from self.texts.compile(submission.text, submission.version, stepped=submission.stepped)
        if len(program.global_names) > _MANY_VARIABLES:
            yield len(program.global_names)  # a start allocates each of them: not in the collector's period
        return program
