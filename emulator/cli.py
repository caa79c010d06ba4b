"""The command line: ``ur-emulator``, or ``python -m emulator``.

``python -m`` searches the current folder first: started in a folder with its own ``emulator`` package, it runs that
one. The console script does not.
"""

import asyncio
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from emulator.logs import LogLevel, log_to_stderr
from emulator.options import RobotOptions, configure, errors_in_one_line
from urproto.commandline import Deferred, application, load_from, version_of, with_options_of
from urproto.ports import LAST_PORT, PENDANT_PORT

_COMMANDS: Final = (
    (
        "explore",
        "emulator.explore.command:app",
        "Search for the schedule of faults, inputs and delays that breaks a program.",
    ),
    (
        "campaign",
        "emulator.campaign.command:app",
        "Run programs or tests many times in virtual time, on all cores or a cluster.",
    ),
    (
        "evaluate",
        "emulator.evaluation.command:app",
        "Evaluate a policy in episodes of a task, in virtual time.",
    ),
    ("facts", "emulator.facts_command:app", "Print what is known and what is guessed about a PolyScope version."),
    (
        "exec",
        "emulator.lockstep.command:app",
        "Run an unmodified program with an emulator, faster than real time, on a clock that waits for both.",
    ),
    ("ctl", "emulator.ctl:app", "Use the control API of a running emulator: inputs, buttons, faults, time."),
    (
        "replay",
        "emulator.replay_command:app",
        "Execute a recorded run again, compare it, and go on from any moment of it.",
    ),
    (
        "trace",
        "emulator.trace_command:app",
        "Show a recorded run as a page for browsers, which works without a network and a server.",
    ),
)

app = application()


def main() -> None:
    app()


@app.callback(invoke_without_command=True, subcommand_metavar="[COMMAND [ARGS]...]")
@with_options_of(RobotOptions)
def _run(
    robot: Mapping[str, Any],
    *,
    context: typer.Context,
    ports_file: Annotated[Path | None, typer.Option(help="Write the ports to this file, as JSON, once ready.")] = None,
    log_level: Annotated[
        LogLevel,
        typer.Option(help="How much to log; debug explains each transition, stop, refusal and fault, with robot time."),
    ] = LogLevel.WARNING,
    exit_when_ready: Annotated[bool, typer.Option("--exit-when-ready", help="Exit once every port answers.")] = False,
    no_pendant: Annotated[bool, typer.Option("--no-pendant", help="Do not start the teach pendant.")] = False,
    pendant_port: Annotated[
        int, typer.Option(min=1, max=LAST_PORT, help="Port of the teach pendant, for browsers.")
    ] = PENDANT_PORT,
    version: Annotated[bool, version_of("ur-emulator")] = False,
) -> None:
    """Emulate a Universal Robots controller on this machine. Not for validating safety."""
    if context.invoked_subcommand is not None:
        _refuse_options_before(context)
        return
    log_to_stderr(log_level)
    with errors_in_one_line():
        from emulator.serve import serve

        config = configure(**robot)
        without = exit_when_ready or no_pendant or config.ephemeral_ports
        asyncio.run(serve(config, ports_file, None if without else pendant_port, exit_when_ready=exit_when_ready))


def _refuse_options_before(context: typer.Context) -> None:
    """Refuse options in front of a subcommand: they would have no effect, because each command has its own."""
    for name in context.params:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            option = f"--{name.replace('_', '-')}"
            raise typer.BadParameter(f"{option} must follow {context.invoked_subcommand}, if that command has it")


def _fleet() -> Any:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read on import; a process with threads must not fork
    return load_from("emulator.fleet.command:app")()


app.command("fleet", cls=Deferred, help="Run many robots on this machine, each on its own address.")(_fleet)
for _name, _place, _help in _COMMANDS:
    app.command(_name, cls=Deferred, help=_help)(load_from(_place))
