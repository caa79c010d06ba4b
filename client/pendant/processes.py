"""Commands in separate processes, which delay neither the motion of the arm nor the pages."""

import asyncio
import os
import sys
from asyncio.subprocess import PIPE
from collections.abc import Sequence
from typing import Final, NamedTuple

from urproto.compat_asyncio import timeout

_NICENESS: Final = 10  # a robot on the same machine has priority


class Done(NamedTuple):
    """What a process that has ended leaves."""

    status: int
    output: bytes
    errors: bytes


async def run(command: Sequence[str], data: bytes, timeout_s: float) -> Done:
    """Run a command with this input. Raises OSError, TimeoutError; the process has ended in any case."""
    process = await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE, stderr=PIPE)
    try:
        if sys.platform != "win32":
            os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS)
        async with timeout(timeout_s):
            output, errors = await process.communicate(data)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return Done(process.returncode or 0, output, errors)
