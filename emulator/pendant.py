"""Starts the teach pendant, which is a client in a process of its own, so that it never costs a control period.

It is told where the robot is and ends with this process: its standard input is a pipe that nobody writes to. One that
ends before, killed or crashed, is started anew.
"""

import asyncio
import importlib.util
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self

from emulator.app import Emulator
from emulator.config import is_loopback

__all__ = ["Pendant"]

_ANY: Final = "0.0.0.0"
_LOCALHOST: Final = "127.0.0.1"
_MISSING: Final = (
    "No teach pendant: its packages are not installed. In the folder of ur-emulator, pip install '.[pendant]' brings "
    "them; --no-pendant leaves this line out."
)
_FAILED: Final = "No pendant: its process ended; the lines above say why. --pendant-port chooses another port."
_BY_HAND: Final = "The robot goes on. For a pendant: ur-client pendant {options}"
_GOODBYE_S: Final = 3.0  # guess: how long a clean end may take
_WAITS_S: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # before the next start, of ends in a row; after as many it is given up
_STEADY_S: Final = 60.0  # guess: a pendant that was there for so long did not die of its start


class Pendant:
    """The pendant of a running emulator while the context is entered. tell: told in a line what becomes of it."""

    def __init__(self, emulator: Emulator, port: int, tell: Callable[[str], object]) -> None:
        self._emulator = emulator
        self._port = port
        self._tell = tell
        self._process: Process | None = None
        self._keeping: asyncio.Task[None] | None = None
        self._state = "starting"
        self._starts = 0
        self._trouble = ""

    async def __aenter__(self) -> Self:
        self._emulator.control.pendant_report = self.report
        self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._keeping is not None
        self._keeping.cancel()
        await asyncio.gather(self._keeping, return_exceptions=True)
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _GOODBYE_S)
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def report(self) -> dict[str, Any]:
        """How it is: see the verb ``pendant`` of the control API."""
        process = self._process
        return {
            "state": self._state,
            "port": self._port,
            "pid": process.pid if process is not None and process.returncode is None else None,
            "starts": self._starts,
            "trouble": self._trouble,
        }

    async def _keep(self) -> None:
        """Have one process after the other until that is hopeless."""
        if importlib.util.find_spec("nicegui") is None:
            self._give_up(_MISSING)
            return
        now = asyncio.get_running_loop().time
        failures, served = 0, False
        while True:
            self._state, began = "starting", now()
            try:
                line, status = await self._run_once()
            except OSError as error:  # no memory, no descriptors
                how = f"could not be started ({error.strerror or error})"
            else:
                served = served or bool(line)
                if not served and status > 0:  # it has said what somebody has to mend: another start changes nothing
                    self._give_up(_FAILED)
                    return
                how = f"{_end(status)} after {now() - began:.0f} s"
            failures = 1 if now() - began > _STEADY_S else failures + 1
            if failures > len(_WAITS_S):
                by_hand = _BY_HAND.format(options=" ".join(self._options()))
                self._give_up(f"The teach pendant {how}, as {failures - 1} times before: it is given up. {by_hand}")
                return
            wait_s = _WAITS_S[failures - 1]
            self._state, self._trouble = "waiting", f"it {how}"
            self._tell(f"The teach pendant {how}: it is started anew in {wait_s:g} s.")
            await asyncio.sleep(wait_s)

    async def _run_once(self) -> tuple[str, int]:
        """The line with which it says where browsers find it, "" if it never did, and its exit status."""
        starting = asyncio.create_subprocess_exec(*self._command(), stdin=PIPE, stdout=PIPE, env=self._environment())
        process = self._process = await starting
        self._starts += 1
        assert process.stdout is not None
        line = (await process.stdout.readline()).decode().strip()
        if line:
            self._state = "running"
            self._tell(line if self._starts == 1 else f"{line} (started anew: start {self._starts})")
        return line, await process.wait()

    def _give_up(self, why: str) -> None:
        self._state, self._trouble = "given up", why
        self._tell(why)

    def _command(self) -> list[str]:
        return [sys.executable, "-P", "-u", "-m", "client", "pendant", *self._options(), "--with-parent"]

    def _options(self) -> list[str]:
        """Whoever reaches a pendant can do what it can: other machines get one without the control API."""
        emulator, config = self._emulator, self._emulator.config
        local = is_loopback(config.host)
        options = {
            "--robot-ip": config.host if config.host != _ANY else _LOCALHOST,
            "--port-offset": config.port_offset,
            "--host": config.host,
            "--port": self._port,
            "--modbus-port": emulator.ports["modbus"],
            "--control-port": emulator.ports.get("control", 0) if local else 0,
        }
        return [str(word) for pair in options.items() for word in pair]

    def _environment(self) -> dict[str, str]:
        token = self._emulator.config.control_token
        return {**os.environ, "UR_EMULATOR_TOKEN": token} if token else dict(os.environ)


def _end(status: int) -> str:
    if status >= 0:
        return f"ended with status {status}"
    try:
        return f"was killed ({signal.Signals(-status).name})"
    except ValueError:
        return f"was killed by signal {-status}"
