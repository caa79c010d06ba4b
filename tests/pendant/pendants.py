"""Pendants in separate processes."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

GOODBYE_S = 10.0
ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def pendant(
    host: str, *options: str, errors: IO[str] | None = None, program: Sequence[str] = ("-m", "client")
) -> Iterator["subprocess.Popen[str]"]:
    """Start a pendant for the robot at an address, at the same address; it may be killed in the meantime.

    errors: file for its log. program: arguments of Python that run ``ur-client``.
    """
    process = subprocess.Popen(
        [
            *(sys.executable, "-u", *program, "pendant", "--robot-ip", host, "--host", host),
            *("--with-parent", *options),
        ],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        assert "Teach pendant" in process.stdout.readline()
        yield process
    finally:
        process.stdin.close()
        try:
            process.wait(GOODBYE_S)
        except subprocess.TimeoutExpired:  # under load
            process.kill()
            process.wait()
        process.stdout.close()
