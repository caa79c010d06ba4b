"""Operations of the dashboard server, one for each command, as constants and functions.

An operation consists of the command line, how its answer is read, the first versions that have it, and advice for a
refusal. ``urproto.dashboard.COMMANDS`` lists the commands, their versions and their confirmations.
"""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final, Generic, TypeVar

from client.quantities import checked_call
from urproto import dashboard as wire
from urproto.dashboard import COMMANDS, OperationalMode, ProgramState, UserRole
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import Availability, PolyscopeVersion

Answer = TypeVar("Answer")

_ALWAYS: Final = Availability.since("3.0", "5.0", None)
_FIRST: Final = (PolyscopeVersion(3, 0), PolyscopeVersion(5, 0))  # of each series
_REPORT_TIMEOUT_S: Final = 600.0  # source: dashboard manual, a support file may take ten minutes

_REMOTE_CONTROL: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
_UNKNOWN: Final = "this controller does not know the command"
POWER_ADVICE: Final = "check the safety mode: an emergency stop, a violation or a fault must be cleared first"
PROGRAM_ADVICE: Final = "load a program first, release the brakes, clear any stop; see the log and the pendant"
_NO_PROGRAM: Final = "there is no running program to pause"
_PATH: Final = (
    "give a path below the controller's programs folder; the file and its installation must open on the robot"
)
_UNLOCK: Final = "wait until 5 s after the stop, find its cause, then try again"
_ROLE: Final = "check the roles that are set up on the pendant"
_REFUSALS: Final = ("could not understand", "failed", "error", "file not found", "cannot", "command is not allowed")
WORDS: Final = (*(COMMANDS[phrase].words for phrase in sorted(COMMANDS)),)
"""All commands in alphabetical order, without arguments, which follow the command."""


@dataclass(frozen=True, slots=True)
class Operation(Generic[Answer]):
    """A command line and how to read its answer; ``read`` may raise RemoteProtocolError.

    available: the versions that have it. advice: what to do if the robot refuses. timeout_s: how long the answer may
    take [s]; None for the connection's timeout.
    """

    line: str
    read: Callable[[str], Answer]
    available: Availability = _ALWAYS
    advice: str = ""
    timeout_s: float | None = None

    def answer(self, reply: str) -> Answer:
        """Return the value in a reply. Raises RobotRefused if the reply does not report success."""
        try:
            return self.read(reply)
        except RemoteProtocolError as error:
            raise RobotRefused(self.line, reply, self._advice(reply)) from error

    @property
    def in_every_version(self) -> bool:
        """True if every controller of both series has the command."""
        return all(self.available.covers(version) for version in _FIRST)

    def check(self, version: PolyscopeVersion) -> None:
        """Raise RobotRefused if a controller of this version does not have the command."""
        if not self.available.covers(version):
            raise RobotRefused(
                self.line,
                f"PolyScope {version} does not know it",
                f"it exists on {self.available}: update the controller, or do without it",
            )

    def _advice(self, reply: str) -> str:
        if wire.is_not_understood(reply):
            return f"{_UNKNOWN}; it exists on {self.available}"
        return _REMOTE_CONTROL if "remote control" in reply.lower() else self.advice


def _expect(*prefixes: str) -> Callable[[str], None]:
    """Return a reader that accepts answers beginning with one of these texts."""

    def read(reply: str) -> None:
        if not reply.lower().startswith(tuple(prefix.lower() for prefix in prefixes)):
            raise RemoteProtocolError(f"{reply!r} does not begin with {' or '.join(map(repr, prefixes))}")

    return read


def _confirmed(phrase: str, advice: str = "", argument: str = "") -> Operation[None]:
    """A command whose answer only confirms it."""
    row = COMMANDS[phrase.lower()]
    return Operation(f"{phrase}{argument}", _expect(*row.confirmations), row.available, advice)


def _query(
    phrase: str,
    read: Callable[[str], Answer],
    advice: str = "",
    argument: str = "",
    timeout_s: float | None = None,
) -> Operation[Answer]:
    """A command whose answer contains a value."""
    return Operation(f"{phrase}{argument}", read, COMMANDS[phrase.lower()].available, advice, timeout_s)


def _number(reply: str) -> str:
    if not (reply.isascii() and reply.isdigit()):
        raise RemoteProtocolError(f"{reply!r} is not a serial number")
    return reply


def _model(reply: str) -> str:
    if not reply.startswith("UR"):
        raise RemoteProtocolError(f"{reply!r} is not a robot model")
    return reply


# Power and safety

POWER_ON = _confirmed("power on", POWER_ADVICE)
POWER_OFF = _confirmed("power off", POWER_ADVICE)
BRAKE_RELEASE = _confirmed("brake release", POWER_ADVICE)
UNLOCK_PROTECTIVE_STOP = _confirmed("unlock protective stop", _UNLOCK)
RESTART_SAFETY = _confirmed("restart safety", "check the safety mode")
ROBOT_MODE: Operation[RobotMode] = _query("robotmode", wire.parse_robot_mode)
SAFETY_MODE: Operation[SafetyMode] = _query("safetymode", wire.parse_safety_mode)
SAFETY_STATUS: Operation[SafetyStatus] = _query("safetystatus", wire.parse_safety_status)

# Programs and installations

PLAY = _confirmed("play", PROGRAM_ADVICE)
PAUSE = _confirmed("pause", _NO_PROGRAM)
STOP = _confirmed("stop")
IS_RUNNING: Operation[bool] = _query("running", wire.parse_boolean)
PROGRAM_STATE: Operation[tuple[ProgramState, str | None]] = _query("programState", wire.parse_program_state)
LOADED_PROGRAM: Operation[str | None] = _query("get loaded program", wire.parse_loaded_program)
IS_PROGRAM_SAVED: Operation[tuple[bool, str | None]] = _query("isProgramSaved", wire.parse_program_saved)


@checked_call
def load(program: str) -> Operation[str]:
    """Load a program, given by its path in the controller's programs folder; returns its path on the controller."""
    return _query("load", wire.parse_loading, _PATH, f" {program}")


@checked_call
def load_installation(installation: str) -> Operation[str]:
    """Load an installation file; returns its path on the controller."""
    return _query("load installation", wire.parse_loading, _PATH, f" {installation}")


# Pendant

CLOSE_POPUP = _confirmed("close popup")
CLOSE_SAFETY_POPUP = _confirmed("close safety popup")
USER_ROLE: Operation[UserRole] = _query("getUserRole", wire.parse_user_role)
OPERATIONAL_MODE: Operation[OperationalMode] = _query("get operational mode", wire.parse_operational_mode)
CLEAR_OPERATIONAL_MODE = _confirmed("clear operational mode")
IS_IN_REMOTE_CONTROL: Operation[bool] = _query("is in remote control", wire.parse_boolean)


@checked_call
def popup(text: str) -> Operation[None]:
    """Show a popup on the teach pendant."""
    return _confirmed("popup", argument=f" {text}")


@checked_call
def add_to_log(text: str) -> Operation[None]:
    """Write a line to the controller's log."""
    return _confirmed("addToLog", "the text must not be empty", f" {text}")


@checked_call
def set_user_role(role: UserRole | str) -> Operation[None]:
    """Set the user role on the pendant (CB3). A string is sent unchanged."""
    return _confirmed("setUserRole", _ROLE, f" {role if isinstance(role, str) else role.value}")


@checked_call
def set_operational_mode(mode: OperationalMode | str) -> Operation[None]:
    """Take control of the operational mode (e-Series): MANUAL or AUTOMATIC. A string is sent unchanged."""
    if mode is OperationalMode.NONE:
        raise LocalProtocolError("the operational mode NONE cannot be set: use CLEAR_OPERATIONAL_MODE")
    return _confirmed("set operational mode", argument=f" {mode if isinstance(mode, str) else mode.value}")


# About the controller

POLYSCOPE_VERSION: Operation[PolyscopeVersion] = _query("PolyscopeVersion", wire.parse_polyscope_version)
VERSION: Operation[PolyscopeVersion] = _query("version", wire.parse_polyscope_version)
SERIAL_NUMBER: Operation[str] = _query("get serial number", _number)
ROBOT_MODEL: Operation[str] = _query("get robot model", _model)
SAVE_LOG = _confirmed("saveLog", "check the free space on the controller's disk")
SHUTDOWN = _confirmed("shutdown")
QUIT = _confirmed("quit")


@checked_call
def generate_flight_report(kind: str = "system") -> Operation[str]:
    """Generate a flight report (controller, software or system); returns its id. Takes minutes."""
    advice = "request controller, software or system, at most once in 30 s"
    return _query("generate flight report", wire.parse_flight_report, advice, f" {kind}", _REPORT_TIMEOUT_S)


@checked_call
def generate_support_file(directory: str) -> Operation[str]:
    """Generate a support file (zip) in a directory below the programs folder; returns its name. Takes minutes."""
    advice = "give an existing directory below the programs folder, and check the free space on its disk"
    return _query("generate support file", wire.parse_support_file, advice, f" {directory}", _REPORT_TIMEOUT_S)


# Any line

_WITHOUT_ARGUMENT: Final = {row.line.lower(): row for row in tuple(globals().values()) if isinstance(row, Operation)}
_WITH_ARGUMENT: Final[dict[str, Callable[[str], Operation[str] | Operation[None]]]] = {
    "load installation": load_installation,
    "load": load,
    "popup": popup,
    "addToLog": add_to_log,
    "setUserRole": set_user_role,
    "set operational mode": set_operational_mode,
    "generate flight report": generate_flight_report,
    "generate support file": generate_support_file,
}


@checked_call
def command(line: str) -> Operation[str]:
    """Any command line; the answer is returned unchanged."""
    return Operation(line, str)


@checked_call
def checked_command(line: str) -> Operation[str]:
    """Any command line; the answer is returned unchanged, or raises RobotRefused if it does not report success."""
    known = _find_operation(line.strip())

    def read(reply: str) -> str:
        if known is not None:
            known.answer(reply)
        elif reply.lower().startswith(_REFUSALS):
            raise RobotRefused(line, reply, _advice_if_unknown(line) if wire.is_not_understood(reply) else "")
        return reply

    return Operation(line, read, timeout_s=known.timeout_s if known is not None else None)


def _advice_if_unknown(line: str) -> str:
    close = get_close_matches(line.strip(), WORDS, 1)
    return f"{_UNKNOWN}; did you mean {close[0]!r}?" if close else _UNKNOWN


def _find_operation(line: str) -> Operation[Any] | None:
    if (row := _WITHOUT_ARGUMENT.get(line.lower())) is not None:
        return row
    for phrase, operation in _WITH_ARGUMENT.items():
        if line.lower().startswith(f"{phrase.lower()} "):
            return operation(line[len(phrase) :].strip())
    return None
