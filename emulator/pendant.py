"""Starts the teach pendant, which is a client in a process of its own, so that it never costs a control period.

It is told where the robot is and ends with this process: its standard input is a pipe that nobody writes to.
"""

import asyncio
import importlib.util
import os
import sys
from contextlib import suppress
from types import TracebackType
from typing import Final, Self

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
_GOODBYE_S: Final = 3.0  # guess: how long a clean end may take


class Pendant:
    """The pendant of a running emulator while the context is entered."""

    def __init__(self, emulator: Emulator, port: int) -> None:
        self._emulator = emulator
        self._port = port
        self._process: asyncio.subprocess.Process | None = None

    async def __aenter__(self) -> Self:
        if importlib.util.find_spec("nicegui") is not None:
            command = [sys.executable, "-P", "-u", "-m", "client", "pendant", *self._options()]
            pipe = asyncio.subprocess.PIPE
            self._process = await asyncio.create_subprocess_exec(
                *command, stdin=pipe, stdout=pipe, env=self._environment()
            )
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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

    async def told(self) -> str:
        """Wait until browsers may come; where they find it, or why there is none."""
        if self._process is None:
            return _MISSING
        assert self._process.stdout is not None
        line = (await self._process.stdout.readline()).decode().strip()
        return line or _FAILED

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
        return [*(str(word) for pair in options.items() for word in pair), "--with-parent"]

    def _environment(self) -> dict[str, str]:
        token = self._emulator.config.control_token
        return {**os.environ, "UR_EMULATOR_TOKEN": token} if token else dict(os.environ)
