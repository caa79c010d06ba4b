"""The script that is being edited on the pendant, and the errors that the checker and the robot report for it.

Like an editor, the client runs the command ``urscript check`` and does not import the URScript packages.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from client.pendant import processes
from client.programs import CheckerError, checker_command, read_problems
from client.scripts import Script, prepare
from urproto.errors import LocalProtocolError
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    KeyMessage,
    RuntimeExceptionMessage,
)
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion

_START_TIMEOUT_S: Final = 5.0  # guess: a program of 50 kB starts within 0.2 s
_MAX_LENGTH: Final = 2_000_000  # characters; a robot accepts no more either (guess)

Phase = Literal["", "sent", "running", "ended", "failed", "silent"]

_SYNTAX_ERROR: Final = "Syntax error: the controller cannot parse this line or the one before it"
_EXAMPLE: Final = """\
def hello():
  textmsg("the tool is at ", get_actual_tcp_pose())
end
"""
_DEBOUNCE_S: Final = 0.5  # guess: an author who pauses for so long wants the result
_POLL_PERIOD_S: Final = 0.2
_CHECK_TIMEOUT_S: Final = 20.0  # guess: 2 MB take a tenth of this


@dataclass(frozen=True, slots=True)
class ScriptError:
    """An error in a script, with its position in the text as it was written; line and column count from 1.

    found_by: "check" for the checker; "start" for the robot, which did not start the script; "run" while it was
    running.
    """

    line: int
    column: int
    text: str
    found_by: Literal["check", "start", "run"] = "check"
    severity: Literal["error", "warning"] = "error"


class Draft:
    """One script for all browsers. author: the page that wrote it last. revision: number of changes.

    phase: of the script that was sent last, "" before the first; "silent": it has not started, and no reason is known.
    error: the error that the robot reports for that script. diagnoses: the results of the checker for the present text.
    """

    def __init__(self) -> None:
        self.text = _EXAMPLE
        self.author = ""
        self.revision = 0
        self.phase: Phase = ""
        self.error: ScriptError | None = None
        self.diagnoses: tuple[ScriptError, ...] = ()
        self.script: Script | None = None
        self._sent_at_s = 0.0
        self._sent_revision = 0

    @property
    def has_user_text(self) -> bool:
        """Whether a user has written the text, so that losing it would matter."""
        return bool(self.text.strip()) and self.text != _EXAMPLE

    def write(self, text: str, author: str = "") -> None:
        """Replace the text. Raises ValueError if it is too long."""
        if len(text) > _MAX_LENGTH:
            raise ValueError(f"a script of {len(text)} characters is too long: at most {_MAX_LENGTH} are possible")
        if text != self.text:
            self.text, self.author, self.revision = text, author, self.revision + 1

    def prepared_script(self) -> Script:
        """The script to send; a secondary program has no name. Raises ValueError if the text is empty."""
        if not self.text.strip():
            raise ValueError("The editor is empty: there is no script to send.")
        try:
            return prepare(self.text)
        except LocalProtocolError:  # a secondary program: the robot reports only its errors
            return Script("", self.text)

    def mark_sent(self, script: Script, now_s: float) -> None:
        """Record that a script is being sent. now_s: time on any clock."""
        self.script, self._sent_at_s, self.phase, self.error = script, now_s, "sent", None
        self._sent_revision = self.revision

    def set_diagnoses(self, revision: int, diagnoses: tuple[ScriptError, ...]) -> None:
        """Store the checker's result for the text of a revision."""
        if revision != self.revision:
            return
        self.diagnoses = diagnoses
        if self.error is not None and self.error.found_by == "start" and revision != self._sent_revision:
            self.error = None  # it concerned an older text, and the checker has checked this one

    @property
    def problems(self) -> tuple[ScriptError, ...]:
        """All known problems. If a script does not start, the checker's reason is better than the robot's."""
        error = self.error
        if error is None or (
            error.found_by == "start" and any(diagnosis.severity == "error" for diagnosis in self.diagnoses)
        ):
            return self.diagnoses
        return (error, *(diagnosis for diagnosis in self.diagnoses if diagnosis.line != error.line))

    def handle_message(self, message: object) -> None:
        """Process a message of the robot about the script."""
        if isinstance(message, KeyMessage) and self.script is not None and message.text == (self.script.name or None):
            if message.title == PROGRAM_STARTED and self.phase in ("sent", "silent"):
                self.phase = "running"
            elif message.title == PROGRAM_STOPPED and self.phase == "running":
                self.phase = "ended"
        elif isinstance(message, RuntimeExceptionMessage) and self._concerns_script(message):
            self._set_failed(message)

    def check_start(self, now_s: float) -> None:
        """Give up waiting for the start of a script that was sent too long ago."""
        if self.phase == "sent" and now_s - self._sent_at_s > _START_TIMEOUT_S:
            self.phase = "silent" if self.script is not None and self.script.name else "ended"

    def _concerns_script(self, message: RuntimeExceptionMessage) -> bool:
        """Whether an error is about this script. Compile errors have no time; another script may be running."""
        return self.phase == ("sent" if message.timestamp_us == NO_TIMESTAMP_US else "running")

    def _set_failed(self, message: RuntimeExceptionMessage) -> None:
        assert self.script is not None
        line = min(self.script.line(message.line), self.text.count("\n") + 1)
        found_by: Literal["start", "run"] = "start" if self.phase == "sent" else "run"
        self.error = ScriptError(line, message.column, _readable_error(self.script.message(message.text)), found_by)
        self.phase = "failed"


def _readable_error(reported: str) -> str:
    """Replace the raw message of a syntax error, which repeats the line and its number."""
    return _SYNTAX_ERROR if reported.startswith("syntax_error_on_line") else reported


async def check(text: str, version: PolyscopeVersion) -> tuple[ScriptError, ...]:
    """Check a script for a controller of this version; returns all problems. Raises CheckerError, TimeoutError."""
    done = await processes.run(checker_command(version), to_bytes(text), _CHECK_TIMEOUT_S)
    problems = read_problems(*done)
    return tuple(
        ScriptError(problem.line, problem.column, problem.message, "check", "warning" if problem.warning else "error")
        for problem in problems
    )


async def check_forever(
    draft: Draft, version: Callable[[], PolyscopeVersion | None], on_problem: Callable[[str], object]
) -> None:
    """Check the draft after each change, forever. on_problem: called with the reason if it cannot be checked."""
    last_checked: object = None
    while True:
        await asyncio.sleep(_POLL_PERIOD_S)
        revision, polyscope = draft.revision, version()
        if polyscope is None or last_checked == (revision, polyscope):
            continue
        await asyncio.sleep(_DEBOUNCE_S)
        if draft.revision != revision:
            continue
        last_checked = (revision, polyscope)
        try:
            draft.set_diagnoses(revision, await check(draft.text, polyscope))
        except (CheckerError, TimeoutError, OSError) as error:
            on_problem(str(error) or "urscript check takes too long")
