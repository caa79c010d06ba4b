"""``ur-emulator fleet``: many robots on this machine, each on its own address."""

import signal
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.table import Table

from emulator.config import ConfigError, EmulatorConfig
from emulator.fleet.class_server import ClassPage, check_class, class_passwords
from emulator.fleet.plan import FIRST_HOST, MAX_ROBOTS, FleetFile, place
from emulator.fleet.supervisor import AllReady, Died, Event, GivenUp, Restarted, ShutDown, Supervisor
from emulator.logs import LogLevel, log_to_stderr
from emulator.options import ROBOT_OPTIONS, RobotOptions, configure, errors_in_one_line
from emulator.ports import PORTS
from emulator.realtime import usable_cores
from emulator.serve import write_ports
from urproto.commandline import application, console, with_options_of
from urproto.ports import LAST_PORT

_LOST: Final = 1
_DEFAULT_COUNT: Final = 4

app = application(completion=False)


@app.command()
@with_options_of(RobotOptions, without=["host"])
def _fleet(
    robot: Mapping[str, Any],
    *,
    count: Annotated[int | None, typer.Option(min=1, max=MAX_ROBOTS, help="Number of robots.")] = None,
    fleet: Annotated[
        Path | None,
        typer.Option(help="YAML file of different robots; the other options are defaults for what it leaves out."),
    ] = None,
    first_host: Annotated[
        str, typer.Option(help="Address of the first robot; the others get the addresses that follow.")
    ] = FIRST_HOST,
    processes: Annotated[
        int | None, typer.Option(min=1, help="Number of processes that share the robots (default: one per core).")
    ] = None,
    restart: Annotated[bool, typer.Option("--restart", help="Restart robots whose process died.")] = False,
    ports_file: Annotated[
        Path | None, typer.Option(help="Write hosts and ports to this file, as JSON, once all are ready.")
    ] = None,
    log_level: Annotated[
        LogLevel,
        typer.Option(help="How much to log; debug explains each transition, stop, refusal and fault, with robot time."),
    ] = LogLevel.WARNING,
    exit_when_ready: Annotated[bool, typer.Option("--exit-when-ready", help="Exit once every port answers.")] = False,
    class_port: Annotated[
        int | None,
        typer.Option(min=1, max=LAST_PORT, help="Serve a page of all robots, for a class, at this port."),
    ] = None,
    teacher_password: Annotated[
        str, typer.Option(envvar="UR_TEACHER_PASSWORD", help="Password of the teacher (default: a new one).")
    ] = "",
    student_password: Annotated[
        str, typer.Option(envvar="UR_STUDENT_PASSWORD", help="Password of the students (default: a new one).")
    ] = "",
) -> None:
    """Run many robots on this machine, each on its own address."""
    log_to_stderr(log_level)
    with errors_in_one_line():
        configs = place(_robots(robot, fleet, count), configure, first_host)
        passwords = class_passwords(teacher_password, student_password)
        if class_port is not None:
            check_class(configs)
        shown = _Screen(configs, ports_file)
        with ExitStack() as running:
            supervisor = running.enter_context(Supervisor(configs, processes or usable_cores(), restart=restart))
            _stop_on_signals(supervisor)
            for event in supervisor.watch():
                if class_port is not None and isinstance(event, AllReady):
                    running.enter_context(ClassPage(configs, supervisor.ports, class_port, passwords))
                    shown.show_class(f"http://{configs[0].host}:{class_port}", passwords)
                shown.show(event, supervisor)
                if exit_when_ready and isinstance(event, AllReady):
                    break
        shown.finish()


def _robots(robot: Mapping[str, Any], fleet: Path | None, count: int | None) -> list[Mapping[str, Any]]:
    if fleet is None:
        return [robot] * (count or _DEFAULT_COUNT)
    if count is not None:
        raise ConfigError(f"{fleet} determines the number of robots: leave out --count")
    return [{**robot, **entry} for entry in FleetFile(ROBOT_OPTIONS).read(fleet)]


def _stop_on_signals(supervisor: Supervisor) -> None:
    """Stop cleanly on the first Ctrl-C; a second one interrupts."""

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        supervisor.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)


class _Screen:
    """Prints what happens in a fleet, and writes its ports file."""

    def __init__(self, configs: Sequence[EmulatorConfig], ports_file: Path | None) -> None:
        self._configs = configs
        self._ports_file = ports_file
        self._console = console()
        self._lost: set[int] = set()

    def show(self, event: Event, supervisor: Supervisor) -> None:
        """Show an event. Raises ConfigError when the fleet cannot be started."""
        match event:
            case AllReady():
                self._ready(supervisor)
            case ShutDown(robot):
                self._console.print(f"{self._hosts((robot,))} was shut down by a client.")
            case Died(pid, robots, how):
                self._lost |= set(robots)
                self._console.print(f"Process {pid} {how}: lost {self._hosts(robots)}.", style="bold red")
            case Restarted(robots):
                self._lost -= set(robots)
                self._write(supervisor)
                self._console.print(f"Restarted, with new state: {self._hosts(robots)}.", style="bold green")
            case GivenUp(robots, reason):
                if not self._lost:
                    raise ConfigError(f"not ready: {self._hosts(robots)}: {reason}")
                self._console.print(f"Cannot restart {self._hosts(robots)}: {reason}.", style="bold red")

    def show_class(self, address: str, passwords: Mapping[str, str]) -> None:
        self._console.print(f"Class page: {address}, with a link for each student.")
        for role, password in passwords.items():
            self._console.print(f"  password for the {role}: {password}", markup=False, highlight=False)

    def finish(self) -> None:
        """Print the last line. Raises typer.Exit if robots were lost."""
        self._console.print("Stopped.")
        if self._lost:
            raise typer.Exit(_LOST)

    def _ready(self, supervisor: Supervisor) -> None:
        self._write(supervisor)
        self._console.print(self._table(supervisor))
        count = len(self._configs)
        self._console.print(f"Ready: every port of {count} robots answers. Ctrl-C ends it.", style="bold green")

    def _write(self, supervisor: Supervisor) -> None:
        if self._ports_file is None:
            return
        rows = zip(self._configs, supervisor.ports, strict=True)
        write_ports(
            self._ports_file,
            [{"host": config.host, "model": config.controller.model.name, "ports": ports} for config, ports in rows],
        )

    def _table(self, supervisor: Supervisor) -> Table:
        table = Table("host", "arm", "PolyScope", "process", "unusual ports", box=None, padding=(0, 2))
        for config, ports, pid in zip(self._configs, supervisor.ports, supervisor.pids, strict=True):
            controller = config.controller
            table.add_row(config.host, controller.model.title, str(controller.version), str(pid), _unusual(ports))
        return table

    def _hosts(self, robots: Sequence[int]) -> str:
        return ", ".join(self._configs[index].host for index in robots)


def _unusual(ports: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {port}" for name, port in ports.items() if port != PORTS[name])
