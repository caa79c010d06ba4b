"""One emulator in the foreground of a terminal: first screen, ready line, teach pendant, shutdown."""

import asyncio
import importlib.util
import json
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from pathlib import Path
from shutil import which
from types import TracebackType
from typing import Any, Final, TextIO, cast

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig, is_loopback
from emulator.logs import ERROR, OUTPUT
from emulator.ports import PORTS
from emulator.readiness import check_ready
from emulator.realtime import RealTime, claim_real_time, freeze_heap, yield_under_overload
from urproto.commandline import console
from urproto.compat import Self, module_command
from urproto.compat_asyncio import timeout
from urproto.dashboard import COMMANDS
from urproto.durable import write_file
from urproto.extras import how_to_install
from urproto.robotapi import AVAILABLE as ROBOT_API
from urproto.robotapi import BASE, GET_PROGRAM_STATE, PUT_STATE

_LOOPBACK = "127.0.0.1"
_ABOUT = {
    "robot api": "power, brakes, programs: HTTP (/universal-robots/robot-api)",
    "dashboard": "power, brakes, programs: text commands",
    "primary": "state and messages at 10 Hz; accepts URScript",
    "secondary": "state at 10 Hz; accepts URScript",
    "realtime": "state at the control rate; accepts URScript",
    "rtde": "variables of your choice, in both directions",
    "modbus": "registers and coils (Modbus/TCP)",
    "interpreter": "statements for a program in interpreter_mode()",
    "control": "this emulator's own API: inputs, faults, time (ur-emulator ctl)",
    "cameras": "images of the scene: HTTP, also for a browser",
    "tool line": "the tool's serial line",
    "gripper": "text commands",
}
_ANY: Final = "0.0.0.0"
_REMOTE_CONTROL: Final = COMMANDS["is in remote control"].available
_SIMULATOR_ADDRESSES: Final = ("127.0.0.1", "localhost", "192.168.56.101")  # what ur_rtde takes for a simulator
_MISSING: Final = "No teach pendant, as its packages are not installed; --no-pendant omits this line. To install them: "
_FAILED: Final = "No teach pendant: its process failed; see the lines above. --pendant-port selects another port."
_MANUAL_START: Final = "The robot keeps running. To start a pendant: ur-client pendant {options}"
_GOODBYE_S: Final = 3.0  # guess: time limit for a clean exit
_BACKOFF_S: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # before each restart after consecutive failures; then no more
_STEADY_S: Final = 60.0  # guess: a pendant that ran for this long did not fail because of its start


def first_screen(emulator: Emulator) -> RenderableType:
    """Model, version, ports, and three things to try."""
    controller = emulator.controller
    title = f"{controller.model.title} with PolyScope {controller.version}, emulated"
    parts = (_ports(emulator), Text(), Text("Try next:", style="bold"), _first_steps(emulator))
    return Panel(Group(*parts), title=title, title_align="left", expand=False)


def ready_line(emulator: Emulator, granted: Sequence[str]) -> Text:
    """The line that is printed once every port has answered. granted: what `claim_real_time` returned."""
    state = "the brakes are released" if emulator.controller.power.running else "the arm is powered off"
    host = emulator.config.host
    punctual = f"in real time ({', '.join(granted)})" if granted else "without real-time priority"
    return Text(f"Ready: every port on {host} answers, {state}; {punctual}. Ctrl-C ends it.", style="bold green")


def _ports(emulator: Emulator) -> Table:
    table = Table.grid(padding=(0, 2))
    ports = emulator.ports
    for name, about in _ABOUT.items():
        if name not in ports:
            continue
        table.add_row(name, str(ports[name]), _about(emulator, name, about))
    read_only = ", ".join(str(port) for name, port in ports.items() if name.endswith("read-only"))
    table.add_row("read-only", read_only, "as primary, secondary, realtime")
    for reason in emulator.port_fallbacks.values():
        table.add_row("", "", f"{reason}; using a free port instead")
    return table


def _about(emulator: Emulator, name: str, about: str) -> str:
    if name == "tool line":
        return f"{about}, to {emulator.tool_device}"
    mounted = emulator.controller.gripper
    return f"{mounted.model.title}: {about}" if name == "gripper" and mounted else about


def _dashboard_line(emulator: Emulator) -> str:
    """A shell command that releases the brakes, or queries the robot mode if they are released."""
    command = "robotmode" if emulator.controller.power.running else "brake release"
    config = emulator.config
    if "dashboard" not in emulator.ports:
        return _api_line(emulator)
    if config.ephemeral_ports:
        return f"printf '{command}\\nquit\\n' | nc {_local_address(emulator.config)} {emulator.ports['dashboard']}"
    options = "" if _local_address(emulator.config) == _LOOPBACK else f" --robot-ip {_local_address(emulator.config)}"
    options += f" --port-offset {config.port_offset}" if config.port_offset else ""
    return f'{_client()} dashboard "{command}"{options}'


def _api_line(emulator: Emulator) -> str:
    """The same for PolyScope X, whose first versions can be controlled from their pendant only."""
    if not ROBOT_API.covers(emulator.controller.version):
        return "# this version has no Robot API yet: switch the arm on with its pendant, or start with --running"
    base = f"http://{emulator.config.host}:{emulator.ports['robot api']}{BASE}"
    if emulator.controller.power.running:
        return f"curl {base}{GET_PROGRAM_STATE.path}"
    body = '{"action": "BRAKE_RELEASE"}'
    return f"curl -X PUT -H 'Content-Type: application/json' -d '{body}' {base}{PUT_STATE.path}"


def _client() -> str:
    """The command ``ur-client`` as this terminal can call it: with its path if that is not in PATH."""
    return "ur-client" if which("ur-client") else str(Path(sys.executable).with_name("ur-client"))


def _local_address(config: EmulatorConfig) -> str:
    """The emulator's address for clients on this machine."""
    return _LOOPBACK if config.host == _ANY else config.host


def _first_steps(emulator: Emulator) -> Text:
    host = _local_address(emulator.config)
    steps = f"  {_dashboard_line(emulator)}\n"
    if "rtde" not in emulator.ports:
        return Text(f"{steps}  ur_rtde needs RTDE, which this version does not have yet")
    if emulator.config.wanted_ports["rtde"] != PORTS["rtde"]:
        return Text(
            f"{steps}  ur_rtde connects to the usual ports only: give each of several robots its own --host 127.0.0.x"
        )
    controller = emulator.controller
    has_remote_control = _REMOTE_CONTROL.covers(controller.version) and "dashboard" in emulator.ports
    is_required = has_remote_control and host not in _SIMULATOR_ADDRESSES and not controller.remote_control
    remote = "  ur_rtde requires remote control at this address: start with --remote-control\n" if is_required else ""
    return Text(
        f"{steps}{remote}"
        "  pip install ur-rtde    # then in Python, once the brakes are released:\n"
        "    from rtde_control import RTDEControlInterface\n"
        f'    robot = RTDEControlInterface("{host}")\n'
        "    robot.moveJ([0.3, -1.2, 1.0, -1.4, -1.57, 0.0])"
    )


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
            "--robot-ip": _local_address(config),
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


async def serve(
    config: EmulatorConfig, ports_file: Path | None, pendant_port: int | None, *, exit_when_ready: bool
) -> None:
    """Run the emulator until it is stopped, or until every port answers. pendant_port: None for no pendant.

    Raises ConfigError, NotReady, OSError.
    """
    screen = console(cast(TextIO, OUTPUT))
    emulator = Emulator(replace(config, faults=()))  # faults begin once the emulator has proven to be ready
    async with AsyncExitStack() as running:
        running.enter_context(OUTPUT.in_background())
        running.enter_context(ERROR.in_background())
        granted = claim_real_time(config.realtime if config.speed == 1.0 else RealTime.OFF)
        await running.enter_async_context(emulator)
        if granted:
            watching = asyncio.create_task(yield_under_overload(config.realtime))
            running.callback(watching.cancel)
        _stop_on_signals(emulator.stop)
        screen.print(first_screen(emulator))
        await check_ready(config.host, emulator.ports, elsewhere={"control": config.host_of("control")})
        freeze_heap()  # again: the emulator has been created since the first time
        if ports_file is not None:
            write_ports(ports_file, emulator.ports)
        emulator.inject(config.faults)
        screen.print(ready_line(emulator, granted))
        if pendant_port is not None:
            # the robot runs already: it does not wait for the pendant
            pendant = Pendant(emulator.config, emulator.ports, pendant_port, screen.print)
            emulator.control.pendant_report = pendant.report
            await running.enter_async_context(pendant)
        if not exit_when_ready:
            await emulator.stopped.wait()
    screen.print("Stopped.")


def _stop_on_signals(stop: Callable[[], None]) -> None:
    """Stop cleanly on the first Ctrl-C; a second one interrupts."""
    loop = asyncio.get_running_loop()

    def stop_once(number: signal.Signals) -> None:
        loop.remove_signal_handler(number)
        stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        if sys.platform != "win32":
            loop.add_signal_handler(number, stop_once, number)


def write_ports(path: Path, ports: object) -> None:
    """Write the file completely or not at all, because other processes wait for it. Raises ConfigError."""
    try:
        write_file(path, json.dumps(ports, indent=2) + "\n")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
