"""Options of robots and the report of wrong ones, for all commands that run emulators."""

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from emulator.realtime import RealTime
from emulator.robot.kinds import ArmKind
from emulator.services.sockets import ScriptNetwork
from urproto.commandline import completing, fail
from urproto.facts import Personality
from urproto.robots import MODELS

if TYPE_CHECKING:
    from emulator.config import EmulatorConfig
    from emulator.machine import ControllerConfig

_PROGRAM: Final = "ur-emulator"


@dataclass(frozen=True, kw_only=True)
class ControllerOptions:
    """Options of a robot, whatever runs it: a command, a fleet, a test in virtual time."""

    model: Annotated[
        str | None,
        typer.Option(
            help=f"Arm model: {', '.join(MODELS)} (default: ur3; ur3e if --polyscope names an e-Series version).",
            autocompletion=completing(lambda: MODELS),
        ),
    ] = None
    polyscope: Annotated[str | None, typer.Option(help="PolyScope version to report, for example 3.15.8.")] = None
    programs: Annotated[
        Path | None,
        typer.Option(
            help="Programs folder of the robot; its default.installation is loaded at boot. "
            "Without this option there is only external_control.urp."
        ),
    ] = None
    initial_positions: Annotated[
        Path | None, typer.Option(help="YAML file that maps joint names to radians (default: as URSim starts).")
    ] = None
    calibration: Annotated[
        Path | None, typer.Option(help="YAML file with the calibration of an arm, as written by ur-client calibration.")
    ] = None
    running: Annotated[bool, typer.Option("--running", help="Start with the brakes released.")] = False
    remote_control: Annotated[
        bool, typer.Option("--remote-control", help="Answer true to 'is in remote control' (e-Series).")
    ] = False
    enforce_remote_control: Annotated[
        bool, typer.Option("--enforce-remote-control", help="Refuse commands unless in remote control (e-Series).")
    ] = False
    external_control: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Driver from which External Control nodes request their program."),
    ] = None
    arm: Annotated[
        str,
        typer.Option(
            metavar="ideal|dynamic|FILE",
            help="ideal: follows its targets exactly; dynamic: moved by torques, with friction; FILE: dynamic, with "
            "the parameters that ur-client identify found in a recording.",
        ),
    ] = ArmKind.IDEAL
    personality: Annotated[
        Personality,
        typer.Option(
            "--as",
            "--personality",
            help="ursim: what a simulator of this model and version reports (serial number, start pose, voltages, no "
            "boot); arm: what a real arm does. How the arm moves is --arm.",
        ),
    ] = Personality.URSIM
    seed: Annotated[int, typer.Option(help="Seed of random(), and of a dynamic arm's noise.")] = 0
    encoder0_speed: Annotated[float, typer.Option(help="Speed of the conveyor at encoder 0, in ticks per second.")] = (
        0.0
    )
    encoder1_speed: Annotated[float, typer.Option(help="Speed of the conveyor at encoder 1, in ticks per second.")] = (
        0.0
    )
    gripper: Annotated[
        str | None, typer.Option(help="Gripper mounted on the arm: robotiq-2f-85, robotiq-2f-140 or robotiq-hand-e.")
    ] = None
    gripper_object: Annotated[
        float | None, typer.Option(help="Width of the object between the gripper's fingers, in mm.")
    ] = None
    safety: Annotated[
        Path | None,
        typer.Option(
            metavar="factory|FILE",
            help="Safety limits: factory, a YAML file, or a PolyScope .installation file (default: joint limits only).",
        ),
    ] = None
    self_collision: Annotated[
        bool, typer.Option("--self-collision", help="Stop when links of the arm touch each other.")
    ] = False
    world: Annotated[
        Path | None, typer.Option(help="Objects that the arm can touch: a YAML file, or an MJCF or URDF scene.")
    ] = None
    physics: Annotated[
        bool, typer.Option("--physics", help="Simulate parts, joints and grippers of the world (docs/physics.md).")
    ] = False


@dataclass(frozen=True, kw_only=True)
class RobotOptions(ControllerOptions):
    """Options of a robot with ports, in addition to those of its controller."""

    host: Annotated[
        str, typer.Option(envvar="UR_EMULATOR_HOST", help="Address to listen on; 0.0.0.0 is open to other machines.")
    ] = "127.0.0.1"
    port_offset: Annotated[int, typer.Option(help="Number added to each of the usual ports.")] = 0
    ephemeral_ports: Annotated[bool, typer.Option("--ephemeral-ports", help="Use any free ports instead.")] = False
    script_network: Annotated[
        ScriptNetwork,
        typer.Option(
            help="Addresses that sockets and XML-RPC of scripts may connect to; any excludes emulators' control APIs."
        ),
    ] = ScriptNetwork.ANY
    modbus_unit_port: Annotated[
        int, typer.Option(help="Port at which programs reach Modbus units (modbus_add_signal).")
    ] = 502
    robot_api_port: Annotated[
        int | None,
        typer.Option(help="Port of the Robot API (PolyScope X); default: 80, or a free port if 80 is not available."),
    ] = None
    speed: Annotated[float, typer.Option(help="Simulated seconds per second of real time.")] = 1.0
    realtime: Annotated[
        RealTime,
        typer.Option(
            help="Real-time priority and locked memory (Linux). auto: if granted by the system, given up while "
            "clients without it overload the emulator; on: or exit, never given up; off."
        ),
    ] = RealTime.AUTO
    tool_device: Annotated[
        str | None,
        typer.Option(help="Device on the tool's serial line (e-Series): echo, pty, or the path of a serial port."),
    ] = None
    no_control: Annotated[bool, typer.Option("--no-control", help="Do not serve the control API.")] = False
    control_host: Annotated[
        str, typer.Option(help="Address of the control API; requires --control-token unless it is loopback.")
    ] = ""
    control_token: Annotated[
        str, typer.Option(envvar="UR_EMULATOR_TOKEN", help="Token that clients of the control API must present.")
    ] = ""
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND,NAME=VALUE,...", help="Fault to inject (docs/faults.md). Repeatable."),
    ] = None
    journal: Annotated[
        Path | None, typer.Option(help="Record the run in this file, for ur-emulator replay (docs/journal.md).")
    ] = None
    stop_journals: Annotated[
        bool,
        typer.Option(help="Write the journal of an unexpected stop, next to the programs or to a temporary folder."),
    ] = True
    most_clients: Annotated[int, typer.Option(help="Maximum number of clients of each port.")] = 256
    most_clients_per_address: Annotated[
        int | None, typer.Option(help="Maximum number of a port's clients from one address (default: half).")
    ] = None


ROBOT_OPTIONS: Final[Mapping[str, Parameter]] = signature(RobotOptions).parameters
CONTROLLER_OPTIONS: Final[Mapping[str, Parameter]] = signature(ControllerOptions).parameters


def help_of(name: str) -> str:
    option = ROBOT_OPTIONS[name].annotation.__metadata__[0]
    return str(option.help)


def configure(**options: Any) -> "EmulatorConfig":
    """The configuration that options of `RobotOptions` describe. Raises ConfigError."""
    from emulator.config import controller_config  # imports the whole emulator, which --help does not need

    given = vars(RobotOptions(**options)).copy()
    controller = {name: given.pop(name) for name in CONTROLLER_OPTIONS}
    return with_ports(controller_config(**controller, wall_clock_s=time.time()), **given)


def with_ports(controller: "ControllerConfig", **options: Any) -> "EmulatorConfig":
    """The configuration of a controller with the options that `RobotOptions` adds. Raises ConfigError."""
    from emulator import config as checked

    return checked.EmulatorConfig(
        controller=controller,
        control=not options.pop("no_control"),
        client_limits=checked.check_client_limits(options.pop("most_clients"), options.pop("most_clients_per_address")),
        faults=checked.read_faults(options.pop("fault", None) or ()),
        **options,
    )


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """Report errors that the user can fix in one line on standard error, with exit status 2."""
    from emulator.config import ConfigError
    from emulator.readiness import NotReady
    from emulator.realtime import RealTimeRefused

    try:
        yield
    except (ConfigError, RealTimeRefused) as error:
        fail(_PROGRAM, error)
    except NotReady as error:
        fail(_PROGRAM, f"not ready: {error}")
    except OSError as error:
        fail(_PROGRAM, error.strerror or error)
    except ImportError as error:
        if ".so" not in str(error):  # otherwise a system library is missing that the package does not include
            raise
        fail(
            _PROGRAM, f"{error}. Pinocchio needs the OpenMP runtime: apt install libgomp1 (Debian), dnf install libgomp"
        )
    except KeyboardInterrupt:
        if sys.platform != "win32":  # on Windows the event loop cannot handle signals, so Ctrl-C arrives here
            raise
