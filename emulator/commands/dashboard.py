"""The dashboard server's commands: one decorated function each.

``urproto.dashboard.COMMANDS`` lists the names of the commands, with the version that introduced each, and whether it
needs remote control. The functions here implement them: the docstring is the command's help, the argument the rest of
the line, verbatim. A function returns the reply, or yields once per control period until the reply is known. Reply
texts come from the vendor's dashboard manuals and the reply patterns of the official C++ client. Where those differ,
the reply matches the client's pattern, since simulators satisfy it in the vendor's own tests.

A command answers as the manual says even if there is nothing to do, because drivers send "close popup", "stop" and
"unlock protective stop" blindly.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final, Literal, TypeVar

from emulator import reports
from emulator.controller import Controller
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.runstate import is_running
from emulator.lifecycle.safety import SafetyEvent
from emulator.programs.loading import DRIVER_PROGRAMS
from emulator.workshare import in_periods
from urproto import dashboard as replies
from urproto.facts import release_of
from urproto.modes import RuntimeState, SafetyMode
from urproto.text import lower, strip
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import read_installation_steps

_T = TypeVar("_T")
_Waiting = Generator[None, None, str]
_Answer = str | _Waiting

_MODES_TO_SET: Final = (replies.OperationalMode.MANUAL.name, replies.OperationalMode.AUTOMATIC.name)
_SHOWN_ROOT: Final = "/programs"
# PolyScope answers when program and installation are loaded. Drivers wait 1 s for that, which simulators keep to unless
# the machine is slow (an issue of the ROS 2 driver tells of one). How long it takes is a guess.
_LOAD_S: Final = 0.6
_MAX_WORDS: Final = 4  # of a command's name
_START_WITHIN_S: Final = 0.1  # then it counts as started: one shorter than a period never seems to play (guess)


@dataclass(frozen=True, slots=True)
class DashboardCommand:
    """A command of the protocol, and the function that implements it."""

    form: replies.Command
    function: Callable[..., _Answer]


COMMANDS: Final[dict[str, DashboardCommand]] = {}  # by lower-case words


def available_commands(version: PolyscopeVersion) -> list[DashboardCommand]:
    """The commands that a controller of this version supports."""
    return [command for command in COMMANDS.values() if command.form.available.covers(version)]


def execute(
    controller: Controller, line: str, *, restricted: bool = False, at_pendant: bool = False
) -> str | _Waiting | None:
    """Execute a line; return the reply, a generator that returns it, or None for an empty line.

    ``restricted``: commands that need remote control are refused. ``at_pendant``: a person does it at the pendant, so
    that local control permits it, and PolyScope X, which has no dashboard, accepts what other e-Series arms do.
    """
    text = strip(line)
    if not text:
        return None
    version = controller.version
    if at_pendant and version.is_polyscope_x:
        version = DEFAULT_VERSION[Series.E]
    found = _find(text, version)
    if found is None:
        return replies.not_understood(text)
    entry, argument = found
    if restricted and entry.form.remote_only:
        return replies.NOT_IN_REMOTE_CONTROL
    if entry is COMMANDS["play"] and controller.play_refused and not at_pendant:
        return replies.failed("play")
    return entry.function(controller, argument) if entry.form.takes_argument else entry.function(controller)


def _find(text: str, version: PolyscopeVersion) -> tuple[DashboardCommand, str] | None:
    """The longest command that begins the line, and the rest of the line."""
    words = text.split(" ", _MAX_WORDS)
    for count in range(min(len(words), _MAX_WORDS), 0, -1):
        entry = COMMANDS.get(lower(" ".join(words[:count])))
        argument = strip(" ".join(words[count:]))
        if entry and entry.form.available.covers(version) and (entry.form.takes_argument or not argument):
            return entry, argument
    return None


def command(words: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register the function for a command. Raises KeyError if it is not in `urproto.dashboard.COMMANDS`."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        COMMANDS[words.lower()] = DashboardCommand(replies.COMMANDS[words.lower()], function)
        return function

    return register


# Programs and installations


@command("load")
def load(controller: Controller, name: str) -> _Waiting:
    """Load a program from the programs directory; a running program is stopped."""
    path = _existing(controller, name)
    if path is None:
        return f"File not found: {name}"
    try:
        yield from loading(controller, path)
    except (OSError, ValueError) as error:
        controller.messages.text(f"loading {name} failed: {error}")
        return f"Error while loading program: {name}"
    loaded = f"Loading program: {_as_named(controller, path, name)}"
    return f"{loaded}, {_installation(controller)}" if controller.version.series is Series.E else loaded


def loading(controller: Controller, path: Path) -> Generator[None, None, None]:
    """Load a file; yields while it takes time. Raises OSError or ValueError, and then keeps the loaded program."""
    controller.programs.stop("another program is loaded")
    yield from _until(controller, RuntimeState.STOPPED)
    for _ in range(round(_LOAD_S / controller.period_s)):
        yield
    yield from in_periods(controller.programs.load_steps(path), controller.work)


@command("play")
def play(controller: Controller) -> _Waiting:
    """Start the loaded program, or resume a paused one. The brakes must be released."""
    programs = controller.programs
    if not controller.may_play or is_running(programs.state):
        return replies.failed("play")
    controller.startup.allow_start(True)
    submission = programs.play()
    while submission.accepted is None:
        yield
    if not submission.accepted:
        return replies.failed("play")
    for _ in range(round(_START_WITHIN_S / controller.period_s)):
        if programs.state is RuntimeState.PLAYING:
            break
        yield
    return replies.STARTING


@command("stop")
def stop(controller: Controller) -> _Waiting:
    """Stop the running program; the reply is the same if none runs."""
    controller.programs.stop("dashboard")
    controller.startup.allow_start(False)
    yield from _until(controller, RuntimeState.STOPPED)
    return replies.STOPPED


@command("pause")
def pause(controller: Controller) -> _Waiting:
    """Pause the running program."""
    if not is_running(controller.programs.state):
        return replies.failed("pause")
    controller.programs.pause()
    yield from _until(controller, RuntimeState.PAUSED)
    return replies.PAUSING


@command("running")
def running(controller: Controller) -> str:
    """Whether a program is running."""
    return f"Program running: {str(is_running(controller.programs.state)).lower()}"


@command("get loaded program")
def get_loaded_program(controller: Controller) -> str:
    """The path of the loaded program; a new, unnamed one counts as loaded on e-Series."""
    loaded = controller.programs.loaded
    if loaded is not None:
        return f"Loaded program: {_shown(controller, loaded.path)}"
    if controller.version.series is Series.CB3:
        return replies.NO_PROGRAM_LOADED  # console of a 3.15.8 simulator
    return f"Loaded program: {_SHOWN_ROOT}/{replies.UNNAMED_PROGRAM}.urp"  # transcript of a UR10e, 5.11.9


@command("isProgramSaved")
def is_program_saved(controller: Controller) -> str:
    """Whether the loaded program has no unsaved changes: always true, since there is no editor."""
    loaded = controller.programs.loaded
    return f"true {loaded.path.name if loaded else _no_program(controller)}"


@command("programState")
def program_state(controller: Controller) -> str:
    """STOPPED, PLAYING or PAUSED, and the name of the loaded program.

    It knows nothing of a program that a client sent: that is STOPPED (test suite of a driver, URSim 5.25.2, which reads
    RTDE's runtime_state instead; for CB3 a guess).
    """
    loaded = controller.programs.loaded
    name = loaded.path.name if loaded else _no_program(controller)
    return f"{program_state_word(controller) if controller.programs.loaded_ran else 'STOPPED'} {name}"


def program_state_word(controller: Controller) -> Literal["STOPPED", "PLAYING", "PAUSED"]:
    state = controller.programs.state
    if state in (RuntimeState.STOPPED, RuntimeState.STOPPING):
        return "STOPPED"
    return "PAUSED" if state is RuntimeState.PAUSED else "PLAYING"


@command("load installation")
def load_installation(controller: Controller, name: str) -> _Waiting:
    """Load TCP and payload from an installation file in the programs directory."""
    path = _existing(controller, name)
    if path is None:
        return f"File not found: {name}"
    try:
        file = yield from in_periods(read_installation_steps(path), controller.work)
    except (OSError, ValueError) as error:
        controller.messages.note(f"loading {name} failed: {error}")
        return f"Failed to load installation: {name}"
    assert file is not None, "the work is done"
    controller.apply_installation(path, file)
    return f"Loading installation: {_as_named(controller, path, name)}"


# Power and safety


@command("power on")
def power_on(controller: Controller) -> str:
    """Switch the arm on; the robot mode becomes IDLE later."""
    return replies.POWERING_ON if controller.power_event(PowerEvent.POWER_ON) else replies.failed("power on")


@command("power off")
def power_off(controller: Controller) -> str:
    """Switch the arm off; a running program is stopped."""
    controller.power_event(PowerEvent.POWER_OFF)
    return replies.POWERING_OFF


@command("brake release")
def brake_release(controller: Controller) -> str:
    """Release the brakes; an arm that is off is switched on first."""
    accepted = controller.power_event(PowerEvent.BRAKE_RELEASE)
    return replies.BRAKE_RELEASING if accepted else replies.failed("brake release")


@command("unlock protective stop")
def unlock_protective_stop(controller: Controller) -> str:
    """Unlock a protective stop, at the earliest 5 s after it occurred."""
    if not controller.safety.may_unlock_remotely:
        return replies.UNLOCK_TOO_EARLY
    controller.safety_event(SafetyEvent.UNLOCK)
    return replies.UNLOCKING


@command("restart safety")
def restart_safety(controller: Controller) -> str:
    """Restart the safety system after a violation or fault; the arm is then switched off."""
    if controller.safety.mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
        controller.power_event(PowerEvent.POWER_OFF)
        controller.safety_event(SafetyEvent.RESTART)
    return replies.RESTARTING_SAFETY


@command("robotmode")
def robotmode(controller: Controller) -> str:
    """The robot mode."""
    return f"Robotmode: {controller.power.robot_mode.name}"


@command("safetymode")
def safetymode(controller: Controller) -> str:
    """The safety mode."""
    return f"Safetymode: {controller.safety.mode.name}"


@command("safetystatus")
def safetystatus(controller: Controller) -> str:
    """The safety status, which is more detailed than the safety mode on e-Series arms."""
    return f"Safetystatus: {controller.safety.status.name}"


@command("close safety popup")
def close_safety_popup(controller: Controller) -> str:
    """Close the dialogue of a safety stop."""
    controller.safety_board.safety_popup = ""
    return replies.CLOSING_SAFETY_POPUP


# Pendant


@command("popup")
def popup(controller: Controller, text: str) -> str:
    """Show a popup."""
    controller.popups.show(text)
    return replies.SHOWING_POPUP


@command("close popup")
def close_popup(controller: Controller) -> str:
    """Close all popups; a program that waits for one continues."""
    controller.popups.close_all()
    return replies.CLOSING_POPUP


@command("addToLog")
def add_to_log(controller: Controller, text: str) -> str:
    """Add a line to the log."""
    if not text:
        return replies.NO_LOG_MESSAGE
    controller.messages.note(text)
    return replies.LOG_ADDED


@command("setUserRole")
def set_user_role(controller: Controller, role: str) -> str:
    """Set the role of the pendant's user: programmer, operator, none, locked, restricted."""
    if lower(role).upper() not in replies.UserRole.__members__:
        return f"Failed setting user role: {role}"
    controller.user_role = role.upper()
    return f"Setting user role: {role}"


@command("getUserRole")
def get_user_role(controller: Controller) -> str:
    """The pendant's user role."""
    return controller.user_role


@command("set operational mode")
def set_operational_mode(controller: Controller, mode: str) -> str:
    """Set the operational mode, manual or automatic; from then on the dashboard controls it."""
    if lower(mode).upper() not in _MODES_TO_SET:
        return f"Failed setting operational mode: {mode}"
    controller.operational_mode = mode.upper()
    return replies.MODE_SET.format(mode)


@command("get operational mode")
def get_operational_mode(controller: Controller) -> str:
    """MANUAL, AUTOMATIC, or NONE if nothing controls it."""
    return controller.operational_mode


@command("clear operational mode")
def clear_operational_mode(controller: Controller) -> str:
    """Return control of the operational mode to the pendant."""
    controller.operational_mode = "NONE"
    return replies.NOT_CONTROLLING_MODE


@command("is in remote control")
def is_in_remote_control(controller: Controller) -> str:
    """Whether the pendant is set to remote control. Commands are accepted either way unless that is enforced."""
    return str(controller.remote_control).lower()


# About the controller


@command("PolyscopeVersion")
def polyscope_version(controller: Controller) -> str:
    """Software version with its release date."""
    return f"URSoftware {controller.version} ({release_of(controller.version).date})"


@command("version")
def version(controller: Controller) -> str:
    """Software version."""
    return str(controller.version)


@command("get serial number")
def get_serial_number(controller: Controller) -> str:
    """Serial number of the arm."""
    return controller.serial_number


@command("get robot model")
def get_robot_model(controller: Controller) -> str:
    """Model of the arm, without the e of the e-Series."""
    return controller.model.title.removesuffix("e")


@command("generate flight report")
def generate_flight_report(controller: Controller, kind: str) -> _Waiting:
    """Write a flight report (controller, software or system, the default) to the programs directory."""
    steps = reports.write_flight_report(controller, kind or "system")
    return _written("generate flight report", steps, lambda report_id: f"Flight Report generated with id: {report_id}")


@command("generate support file")
def generate_support_file(controller: Controller, directory: str) -> _Waiting:
    """Write log, state and all flight reports, including a new one, to a zip file in the programs directory."""
    steps = reports.write_support_file(controller, directory)
    return _written("generate support file", steps, lambda path: f"Completed successfully: {path.name}")


@command("saveLog")
def save_log(controller: Controller) -> _Waiting:
    """Write the log to the programs directory."""
    return _written("save log", reports.write_log(controller), lambda _: replies.LOG_SAVED)


@command("shutdown")
def shutdown(controller: Controller) -> str:
    """Switch the arm off and shut the controller down."""
    controller.power_event(PowerEvent.POWER_OFF)
    controller.shutdown_requested = True
    return replies.SHUTTING_DOWN


@command("quit")
def disconnect(controller: Controller) -> str:
    """Close this connection; the server closes it after the reply."""
    return replies.DISCONNECTED


# Helpers


def _written(action: str, steps: reports.Waiting[_T], reply: Callable[[_T], str]) -> _Waiting:
    """The reply to a command that writes a file, or why it failed."""
    try:
        return reply((yield from steps))
    except (OSError, ValueError) as error:
        return f"Failed to {action}: {error}"


def _until(controller: Controller, state: RuntimeState) -> Generator[None, None, None]:
    """Wait until the program is in this state, or is over."""
    while controller.programs.state not in (state, RuntimeState.STOPPED):
        yield


def _no_program(controller: Controller) -> str:
    """The text in place of the name if there is none, as captured from 3.15.8 and 5.11.9."""
    return "null" if controller.version.series is Series.CB3 else replies.UNNAMED_PROGRAM


def _existing(controller: Controller, name: str) -> Path | None:
    """The file in the programs directory that a client names; None if it does not exist."""
    return ProgramsFolder(_programs(controller)).find(name)


def _programs(controller: Controller) -> Path:
    """The programs directory; by default one with an ``external_control.urp``, as users of drivers have it."""
    return controller.config.programs_dir or DRIVER_PROGRAMS


def _installation(controller: Controller) -> str:
    """Path of the installation in use: that of the loaded program, if it has one."""
    loaded = controller.programs.loaded
    if loaded is not None and loaded.installation is not None:
        return _shown(controller, loaded.installation[0])
    return f"{_SHOWN_ROOT}/{controller.installation.name}"


def _as_named(controller: Controller, path: Path, name: str) -> str:
    """Return a full path as the client gave it, because clients search the reply for it."""
    return name if PurePosixPath(name).is_absolute() else _shown(controller, path)


def _shown(controller: Controller, path: Path) -> str:
    """The path as the controller shows it to clients."""
    root = _programs(controller)
    if path.resolve().is_relative_to(root.resolve()):
        path = path.resolve().relative_to(root.resolve())
    return f"{_SHOWN_ROOT}/{PurePosixPath(path).as_posix().lstrip('/')}"
