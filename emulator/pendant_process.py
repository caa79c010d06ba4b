"""The teach pendant of a running emulator: a process of its own, which is restarted when it ends."""

import asyncio
import importlib.util
import os
import signal
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from emulator.config import EmulatorConfig
from urproto.addresses import is_loopback, local_address
from urproto.compat import Self, module_command
from urproto.compat_asyncio import timeout
from urproto.extras import how_to_install

_MISSING: Final = "No teach pendant, as its packages are not installed; --no-pendant omits this line. To install them: "
_FAILED: Final = "No teach pendant: its process failed; see the lines above. --pendant-port selects another port."
_MANUAL_START: Final = "The robot keeps running. To start a pendant: ur-client pendant {options}"
_GOODBYE_S: Final = 3.0  # guess: time limit for a clean exit
_BACKOFF_S: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # before each restart after consecutive failures; then no more
_STEADY_S: Final = 60.0  # guess: a pendant that ran for this long did not fail because of its start


class Pendant:
    """The pendant of a running emulator while the context is entered.

    ports: of the emulator's servers, by name. port: of the pendant. announce: called with a line for each change. key:
    what browsers have to show, "" for nothing.
    """

    def __init__(
        self,
        config: EmulatorConfig,
        ports: Mapping[str, int],
        port: int,
        announce: Callable[[str], object],
        key: str = "",
    ) -> None:
        self._config = config
        self._ports = ports
        self._port = port
        self._announce = announce
        self._key = key
        self._process: Process | None = None
        self._keeping: asyncio.Task[None] | None = None
        self._state = "starting"
        self._starts = 0
        self._problem = ""

    async def __aenter__(self) -> Self:
        self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._keeping is not None
        self._keeping.cancel()
        await asyncio.gather(self._keeping, return_exceptions=True)
        process = self._process
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            async with timeout(_GOODBYE_S):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def report(self) -> dict[str, Any]:
        """The state of the process, as returned by the verb ``pendant`` of the control API."""
        process = self._process
        return {
            "state": self._state,
            "port": self._port,
            "pid": process.pid if process is not None and process.returncode is None else None,
            "starts": self._starts,
            "problem": self._problem,
        }

    async def _keep(self) -> None:
        """Run the pendant and restart it when it ends, until it fails too often in succession."""
        if importlib.util.find_spec("nicegui") is None:
            self._give_up(_MISSING + how_to_install("pendant"))
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
                if not served and status > 0:  # it has printed what the user must fix: a restart would not help
                    self._give_up(_FAILED)
                    return
                how = f"{_end(status)} after {now() - began:.0f} s"
            failures = 1 if now() - began > _STEADY_S else failures + 1
            if failures > len(_BACKOFF_S):
                manual = _MANUAL_START.format(options=" ".join(self._options()))
                self._give_up(f"The teach pendant {how}: it has failed {failures} times and is given up. {manual}")
                return
            wait_s = _BACKOFF_S[failures - 1]
            self._state, self._problem = "waiting", f"it {how}"
            self._announce(f"The teach pendant {how}: restarting it in {wait_s:g} s.")
            await asyncio.sleep(wait_s)

    async def _run_once(self) -> tuple[str, int]:
        """Run one process; return the line in which it announced its address ("" if it did not) and its exit status."""
        starting = asyncio.create_subprocess_exec(*self._command(), stdin=PIPE, stdout=PIPE, env=self._environment())
        process = self._process = await starting
        self._starts += 1
        assert process.stdout is not None
        line = (await process.stdout.readline()).decode().strip()
        if line:
            self._state = "running"
            self._announce(line if self._starts == 1 else f"{line} (restarted: start {self._starts})")
        return line, await process.wait()

    def _give_up(self, why: str) -> None:
        self._state, self._problem = "given up", why
        self._announce(why)

    def _command(self) -> list[str]:
        return [*module_command("client", "-u"), "pendant", *self._options(), "--with-parent"]

    def _options(self) -> list[str]:
        """The options of ``ur-client pendant``.

        A pendant that other machines can reach gets no control API, which it would open to them.
        """
        config, ports = self._config, self._ports
        local = is_loopback(config.host)
        options = {
            "--robot-ip": local_address(config.host),
            "--port-offset": config.port_offset,
            "--host": config.host,
            "--port": self._port,
            "--modbus-port": ports["modbus"],
            **({"--robot-api-port": ports["robot api"]} if "robot api" in ports else {}),
            "--camera-port": ports.get("cameras", 0),
            "--control-port": ports.get("control", 0) if local else 0,
        }
        return [str(word) for pair in options.items() for word in pair]

    def _environment(self) -> dict[str, str]:
        secrets = {"UR_EMULATOR_TOKEN": self._config.control_token, "UR_PENDANT_KEY": self._key}
        return {**os.environ, **{name: secret for name, secret in secrets.items() if secret}}


def _end(status: int) -> str:
    if status >= 0:
        return f"exited with status {status}"
    try:
        return f"was killed ({signal.Signals(-status).name})"
    except ValueError:
        return f"was killed by signal {-status}"
