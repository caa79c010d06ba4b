"""Compiling what clients submit, a share in every control period, so that no period gets long.

The share is counted in the compiler's units of work and not in time, so that a script starts
in the same period on every machine.
"""

import gc
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from emulator.builtins import LIBRARIES
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet
from urscript.compiler import CompiledProgram, compile_steps
from urscript.errors import CompileError
from urscript.parser import is_secondary
from urscript.polyscope.tree import TreeError
from urscript.work import Steps

LIBRARY_SET: Final = LibrarySet(LIBRARIES)

WORK_PER_SECOND: Final = 400_000
"""Work done on compiling per second of controller time [units of `urscript.work`], in equal shares per period.

About a third of a period on an idle machine; the official control script (48 kB) takes a quarter of a second, and
its driver expects the program to call back within 0.5 s.
"""

_MANY_VARIABLES: Final = 1000

ResultT = TypeVar("ResultT")


class Job(Generic[ResultT]):
    """Work in steps, and what came of it once a `WorkShare` says it is done."""

    def __init__(self, steps: Steps[ResultT]) -> None:
        self.steps = steps
        self.price = 0  # of the work ahead
        self.result: ResultT | None = None


class WorkShare:
    """How much compiling a control period bears."""

    def __init__(self, period_s: float) -> None:
        self._share = round(WORK_PER_SECOND * period_s)
        self._left = self._share

    def new_period(self) -> None:
        """Another control period, another share, of which what was overdrawn is paid back first."""
        self._left = min(self._share, self._left + self._share)

    def work(self, job: Job[ResultT]) -> bool:
        """Go on with a job; True when it is done, False when it needs a later period. Raises what the job raises.

        A piece that is more than a whole share is done in a period of its own, and nothing in some after it.
        """
        while job.price <= self._left or self._left == self._share:
            self._left -= job.price
            try:
                job.price = next(job.steps)
            except StopIteration as end:
                job.result = end.value
                return True
        return False


def in_periods(steps: Steps[ResultT], period_s: float) -> Generator[None, None, ResultT | None]:
    """Work in shares of control periods of its own: yields once for each. Returns the result."""
    share, job = WorkShare(period_s), Job(steps)
    while not share.work(job):
        share.new_period()
        yield
    return job.result


@dataclass(eq=False, slots=True)
class Submission:
    """A text that a client wants to run. ``accepted`` is None until it is decided whether it will.

    ``translation``: makes the text of something else, a program tree. ``refusal``: why that failed.
    """

    text: str
    version: PolyscopeVersion
    stepped: bool = False
    accepted: bool | None = None
    program: CompiledProgram | None = None
    error: CompileError | None = None
    translation: Steps[str] | None = None
    refusal: str = ""

    @property
    def main(self) -> bool:
        """False for a ``sec`` program, which runs beside the main one."""
        return not is_secondary(self.text)


class Compiling:
    """Submissions on their way to being programs, in their order."""

    def __init__(self, share: WorkShare) -> None:
        self._share = share
        self._waiting: deque[Submission] = deque()
        self._job: Job[CompiledProgram] | None = None  # compiles the first that waits

    @property
    def waiting(self) -> tuple[Submission, ...]:
        """What is not compiled yet, oldest first."""
        return tuple(self._waiting)

    def add(self, submission: Submission) -> None:
        """Compile a text when those before it are done."""
        self._waiting.append(submission)

    def drop_main(self) -> bool:
        """Refuse every main program that waits; False when there is none."""
        dropped = [submission for submission in self._waiting if submission.main]
        if self._waiting and self._waiting[0].main:
            self._leave_job()
        for submission in dropped:
            self._waiting.remove(submission)
            submission.accepted = False
        return bool(dropped)

    def abandon(self) -> None:
        """Refuse everything that waits."""
        self._leave_job()
        waiting = tuple(self._waiting)
        self._waiting.clear()
        for submission in waiting:
            submission.accepted = False

    def _leave_job(self) -> None:
        if self._job is not None:
            self._job.steps.close()
            self._job = None

    def next(self) -> Submission | None:
        """The next submission that is compiled, or has an error; None when it needs a later period."""
        if not self._waiting:
            return None
        submission = self._waiting[0]
        if self._job is None:
            self._job = Job(_work(submission))
        try:
            if not self._share.work(self._job):
                return None
            submission.program = self._job.result
        except CompileError as error:
            submission.error = error.with_traceback(None)  # whose frames hold all that was found out
        except TreeError as error:
            submission.refusal = str(error)
        self._job = None
        return self._waiting.popleft()


@contextmanager
def uncollected() -> Iterator[None]:
    """Without the garbage collector, which would go through every token and node of a large program, at once.

    Nothing of them is garbage before the program is compiled, and most of it is gone at once after that.
    """
    global _resting
    _resting += 1
    gc.disable()
    try:
        yield
    finally:
        _resting -= 1
        if not _resting:
            gc.enable()


_resting = 0  # jobs on their way, of all controllers of this process


def _work(submission: Submission) -> Steps[CompiledProgram]:
    with uncollected():
        program = yield from _compile(submission)
    if len(program.global_names) > _MANY_VARIABLES:
        yield len(program.global_names)  # a start gives each of them its place: not in the period of the collector
    return program


def _compile(submission: Submission) -> Steps[CompiledProgram]:
    if submission.translation is not None:
        submission.text = yield from submission.translation
    return (yield from compile_steps(submission.text, LIBRARY_SET, submission.version, stepped=submission.stepped))
