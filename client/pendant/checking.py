"""Checks a script with ``urscript check`` in a separate process.

Like an editor, the client runs the command and does not import the URScript packages.
"""

import asyncio
from collections.abc import Callable
from typing import Final

from client.pendant import processes
from client.pendant.draft import Draft, ScriptError
from client.programs import CheckerError, checker_command, read_problems
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion

_DEBOUNCE_S: Final = 0.5  # guess: an author who pauses for so long wants the result
_POLL_PERIOD_S: Final = 0.2
_TIMEOUT_S: Final = 20.0  # guess: 2 MB take a tenth of this


async def check(text: str, version: PolyscopeVersion) -> tuple[ScriptError, ...]:
    """Check a script for a controller of this version; returns all problems. Raises CheckerError, TimeoutError."""
    done = await processes.run(checker_command(version), to_bytes(text), _TIMEOUT_S)
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
