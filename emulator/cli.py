"""The command line: ``ur-emulator``, or ``python -m emulator``.

``python -m`` looks for modules in the current folder first, so started from a folder that
has an ``emulator`` of its own it runs that one. The console script does not.
"""

import asyncio
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn

import typer

from emulator.logs import LogLevel, log_to_stderr
from emulator.realtime import RealTime
from emulator.robot.kinds import ArmKind
from emulator.services.sockets import ScriptNetwork
from urproto.commandline import Deferred, application, completing, load_from, version_of, with_options_of
from urproto.ports import PENDANT_PORT

if TYPE_CHECKING:
    from emulator.config import EmulatorConfig


_USAGE_ERROR = 2

app = application()


def main() -> None:
    """Run the command line."""
    app()


def _models() -> Iterable[str]:
    from urproto.robots import MODELS  # only a shell that completes a model's name waits for it

    return MODELS


def configure(
    *,
    model: Annotated[
        str | None,
        typer.Option(
            help="The arm, for example ur3 or ur5e (default ur3, ur3e for an e-Series --polyscope).",
            autocompletion=completing(_models),
        ),
    ] = None,
    polyscope: Annotated[str | None, typer.Option(help="PolyScope version to report, for example 3.15.8.")] = None,
    host: Annotated[
        str, typer.Option(envvar="UR_EMULATOR_HOST", help="Address to listen on; 0.0.0.0 lets other machines in.")
    ] = "127.0.0.1",
    port_offset: Annotated[int, typer.Option(help="Added to each of the usual ports.")] = 0,
    ephemeral_ports: Annotated[bool, typer.Option("--ephemeral-ports", help="Use free ports instead.")] = False,
    programs: Annotated[
        Path | None,
        typer.Option(
            help="Programs folder of the robot; default.installation in it is loaded at boot. "
            "Without one: external_control.urp alone."
        ),
    ] = None,
    initial_positions: Annotated[
        Path | None, typer.Option(help="YAML file: joint names to radians (default: URSim's).")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="YAML file: an arm's calibration, as ur-client calibration writes it.")
    ] = None,
    running: Annotated[bool, typer.Option("--running", help="Start with the brakes released.")] = False,
    remote_control: Annotated[
        bool, typer.Option("--remote-control", help="Answer true to 'is in remote control' (e-Series).")
    ] = False,
    enforce_remote_control: Annotated[
        bool, typer.Option("--enforce-remote-control", help="Refuse commands unless in remote control (e-Series).")
    ] = False,
    script_network: Annotated[
        ScriptNetwork,
        typer.Option(
            help="Addresses that sockets and XML-RPC of scripts may connect to; any excludes control APIs of emulators."
        ),
    ] = ScriptNetwork.ANY,
    external_control: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Where External Control nodes get their program from."),
    ] = None,
    modbus_unit_port: Annotated[int, typer.Option(help="Port of the Modbus units whose signals programs add.")] = 502,
    robot_api_port: Annotated[
        int | None,
        typer.Option(help="Port of the Robot API (PolyScope X); default: 80, else a free one."),
    ] = None,
    arm: Annotated[
        str,
        typer.Option(
            metavar="ideal|dynamic|FILE",
            help="ideal: follows its targets exactly; dynamic: moved by torques, with friction; FILE: dynamic, as the "
            "arm that ur-client identify found in a recording.",
        ),
    ] = ArmKind.IDEAL,
    seed: Annotated[int, typer.Option(help="Seed seed of a dynamic arm's measurement noise.")] = 0,
    speed: Annotated[float, typer.Option(help="Simulated seconds per second.")] = 1.0,
    realtime: Annotated[
        RealTime,
        typer.Option(
            help="Real-time priority and locked memory (Linux): auto, if the system grants them; on, or exit; off."
        ),
    ] = RealTime.AUTO,
    encoder0_speed: Annotated[
        float, typer.Option(help="Speed of the conveyor at encoder 0, in ticks per second.")
    ] = 0.0,
    encoder1_speed: Annotated[
        float, typer.Option(help="Speed of the conveyor at encoder 1, in ticks per second.")
    ] = 0.0,
    tool_device: Annotated[
        str | None,
        typer.Option(help="Device on the tool's serial line (e-Series): echo, pty, or the path of a serial port."),
    ] = None,
    gripper: Annotated[
        str | None, typer.Option(help="Gripper mounted on the arm: robotiq-2f-85 or robotiq-2f-140.")
    ] = None,
    gripper_object: Annotated[
        float | None, typer.Option(help="Width of the object between the gripper's fingers, in mm.")
    ] = None,
    safety: Annotated[
        Path | None,
        typer.Option(
            metavar="factory|FILE",
            help="Safety limits: factory, or a YAML file or PolyScope .installation; joint limits only if not given.",
        ),
    ] = None,
    self_collision: Annotated[
        bool, typer.Option("--self-collision", help="Stop when links of the arm touch each other.")
    ] = False,
    control_host: Annotated[
        str, typer.Option(help="Address the control API listens on; other than loopback requires --control-token.")
    ] = "",
    control_token: Annotated[
        str, typer.Option(envvar="UR_EMULATOR_TOKEN", help="Token that clients of the control API must present.")
    ] = "",
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND,NAME=VALUE,...", help="Fault to inject (docs/faults.md). Repeatable."),
    ] = None,
    most_clients: Annotated[int, typer.Option(help="Most clients a port accepts at a time.")] = 256,
    most_clients_per_address: Annotated[
        int | None, typer.Option(help="Most clients from one address (default: half of --most-clients).")
    ] = None,
    no_control: Annotated[bool, typer.Option("--no-control", help="Do not serve the control API.")] = False,
    world: Annotated[
        Path | None, typer.Option(help="YAML file of objects around the arm that push back, or an MJCF or URDF scene.")
    ] = None,
    physics: Annotated[
        bool, typer.Option("--physics", help="Let the world move: parts, joints, grippers (docs/physics.md).")
    ] = False,
) -> "EmulatorConfig":
    """A robot as the options of the command line say. Raises ConfigError."""
    from emulator import config as checked  # the whole emulator, which a look at the options does not wait for

    controller = checked.controller_config(
        model,
        polyscope=polyscope,
        calibration=calibration,
        initial_positions=initial_positions,
        running=running,
        programs=programs,
        remote_control=remote_control,
        enforce_remote_control=enforce_remote_control,
        encoder0_speed=encoder0_speed,
        encoder1_speed=encoder1_speed,
        gripper=gripper,
        gripper_object=gripper_object,
        safety=safety,
        self_collision=self_collision,
        wall_clock_s=time.time(),
        arm=arm,
        seed=seed,
        external_control=external_control,
        world=world,
        physics=physics,
    )
    return checked.EmulatorConfig(
        controller=controller,
        host=host,
        port_offset=port_offset,
        ephemeral_ports=ephemeral_ports,
        speed=speed,
        realtime=realtime,
        script_network=script_network,
        modbus_unit_port=modbus_unit_port,
        robot_api_port=robot_api_port,
        tool_device=tool_device,
        control=not no_control,
        control_host=control_host,
        control_token=control_token,
        client_limits=checked.check_client_limits(most_clients, most_clients_per_address),
        faults=checked.read_faults(fault or ()),
    )


ROBOT_OPTIONS: Final[Mapping[str, Parameter]] = signature(configure).parameters


def with_robot_options(*, without: Sequence[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Let a command have the options of ``configure`` before its own; it gets them as a mapping, first of all."""
    return with_options_of(configure, without=without)


@app.callback(invoke_without_command=True, subcommand_metavar="[COMMAND [ARGS]...]")
@with_robot_options()
def _run(
    robot: Mapping[str, Any],
    *,
    context: typer.Context,
    ports_file: Annotated[Path | None, typer.Option(help="Write the ports here as JSON once ready.")] = None,
    log_level: Annotated[
        LogLevel,
        typer.Option(help="How much to log; debug explains each transition, stop, refusal and fault, with robot time."),
    ] = LogLevel.WARNING,
    exit_when_ready: Annotated[bool, typer.Option("--exit-when-ready", help="Stop once every port answers.")] = False,
    no_pendant: Annotated[bool, typer.Option("--no-pendant", help="Do not start the teach pendant.")] = False,
    pendant_port: Annotated[int, typer.Option(help="Port of the teach pendant, for browsers.")] = PENDANT_PORT,
    version: Annotated[bool, version_of("ur-emulator")] = False,
) -> None:
    """Stand in for a Universal Robots controller on this machine. Not for validating safety."""
    if context.invoked_subcommand is not None:
        _refuse_options_before(context)
        return
    log_to_stderr(log_level)
    with mistakes_in_one_line():
        from emulator.serve import serve

        config = configure(**robot)
        without = exit_when_ready or no_pendant or config.ephemeral_ports
        asyncio.run(serve(config, ports_file, None if without else pendant_port, exit_when_ready=exit_when_ready))


def _refuse_options_before(context: typer.Context) -> None:
    """They would be without effect: each command has its own."""
    for name in context.params:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            option = f"--{name.replace('_', '-')}"
            raise typer.BadParameter(f"{option} goes after {context.invoked_subcommand}, or is not an option of it")


def _fleet() -> Any:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read on import; a process with threads must not fork
    return load_from("emulator.fleet.command:app")()


app.command("fleet", cls=Deferred, help="Run many robots on this machine, each on an address of its own.")(_fleet)
app.command(
    "campaign", cls=Deferred, help="Run programs or tests many times in virtual time, on all cores or a cluster."
)(load_from("emulator.campaign.command:app"))
app.command("ctl", cls=Deferred, help="Use the control API of a running emulator: inputs, buttons, faults, time.")(
    load_from("emulator.ctl:app")
)


@contextmanager
def mistakes_in_one_line() -> Iterator[None]:
    """Turn what the user can mend into one line on standard error and exit status 2."""
    from emulator.config import ConfigError
    from emulator.readiness import NotReady
    from emulator.realtime import RealTimeRefused

    try:
        yield
    except ConfigError as error:
        _fail(str(error))
    except RealTimeRefused as error:
        _fail(str(error))
    except NotReady as error:
        _fail(f"not ready: {error}")
    except OSError as error:
        _fail(error.strerror or str(error))
    except ImportError as error:
        if ".so" not in str(error):  # else it is a library of the system that a package did not bring
            raise
        _fail(f"{error}. Pinocchio needs the OpenMP runtime: apt install libgomp1 (Debian), dnf install libgomp")
    except KeyboardInterrupt:
        if sys.platform != "win32":  # there the event loop cannot handle signals, and this is how it ends
            raise


def _fail(message: str) -> NoReturn:
    typer.echo(f"ur-emulator: {message}", err=True)
    raise typer.Exit(_USAGE_ERROR)
