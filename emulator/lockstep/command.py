"""``ur-emulator exec``: run a program with an emulator, in time of their own."""

import math
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Annotated, Any, Final

import typer

from emulator.config import ConfigError
from emulator.lockstep.clock import SharedClock, check_program
from emulator.options import RobotOptions, errors_in_one_line
from urproto.commandline import application, with_options_of
from urproto.testing.process import EmulatorError, EmulatorProcess, command_line

_SIGNALLED: Final = 128  # what shells add to the number of the signal that ended a program
_NICENESS: Final = -10  # with six busy processes on two cores, eight times as fast as without; more is no better
_WITHOUT: Final = ("speed", "realtime")  # the clock decides

app = application(completion=False)


@app.command(context_settings={"allow_interspersed_args": False})
@with_options_of(RobotOptions, without=_WITHOUT)
def _exec(
    robot: Mapping[str, Any],
    *,
    context: typer.Context,
    command: Annotated[list[str], typer.Argument(help="Program and its arguments, after --.", metavar="COMMAND...")],
    speed: Annotated[
        float, typer.Option(help="Times real time at most (default: as fast as everything can).")
    ] = math.inf,
    without_robot: Annotated[
        bool, typer.Option("--without-robot", help="Start no emulator: the program starts its own, as tests do.")
    ] = False,
) -> None:
    """Run a program and an emulator in time of their own, which passes as fast as both can: no program is changed."""
    with errors_in_one_line(), ExitStack() as running:
        check_program(command[0])
        clock = running.enter_context(SharedClock(speed))
        running.enter_context(_on_one_core())
        environment = {**os.environ, **clock.environment}
        if not without_robot:
            given = {name: value for name, value in robot.items() if _is_given(context, name) and name != "host"}
            emulator = EmulatorProcess(
                command_line(given), robot["host"], robot["control_token"], environment=clock.environment
            )
            try:
                running.enter_context(emulator)
            except EmulatorError as error:  # what the emulator printed is the whole answer to a wrong option
                raise ConfigError(str(error).rpartition("ur-emulator: ")[2].strip()) from error
        status = _run(command, environment, clock)
    raise typer.Exit(status)


def _is_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


def _run(command: Sequence[str], environment: Mapping[str, str], clock: SharedClock) -> int:
    """Run the program with this process's terminal; its exit status, as a shell reports it."""
    joined = clock.joined
    with subprocess.Popen(command, env=environment) as process:
        before = {
            number: signal.signal(number, lambda got, _: process.send_signal(got) if got == signal.SIGTERM else None)
            for number in (signal.SIGINT, signal.SIGTERM)  # the terminal sends SIGINT to both
        }
        try:
            clock.release(process, joined)
            status = process.wait()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    return _SIGNALLED - status if status < 0 else status


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Keep what is started on one core, where handing over is quick: only one of them runs at a time anyway.

    Each of them waits for others thousands of times per second, and would wait for any process of a busy machine then;
    so they go first, where that is allowed. A thread that wakes another goes on until it waits itself, as it would on a
    core of its own: in the middle of a callback, programs have shown errors that are rare otherwise.
    """
    if sys.platform != "linux":  # and there is no clock
        raise AssertionError
    cores, niceness = os.sched_getaffinity(0), os.getpriority(os.PRIO_PROCESS, 0)
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setaffinity(0, {random.choice(sorted(cores))})
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(niceness, _NICENESS))
    if policy == os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_BATCH, parameters)
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
        os.sched_setscheduler(0, policy, parameters)
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
