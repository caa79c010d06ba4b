"""What can be asked of a dashboard: one row for each command, constants and functions.

A row has the line, how its answer is read, the first versions that know it, and what to do
when the robot says no. Sources of texts and versions: the vendor's dashboard manuals and
the reply patterns of the official C++ client.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

from urproto import dashboard as wire
from urproto.dashboard import OperationalMode, ProgramState, UserRole
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import Availability, PolyscopeVersion

Answer = TypeVar("Answer")

_ALWAYS: Final = Availability.since("3.0", "5.0")  # or before: what came in 1.x is in every version of both series
_FROM_3_1: Final = Availability.since("3.1", "5.0")
_REPORTS: Final = Availability.since("3.13", "5.8")
_REPORT_TIMEOUT_S: Final = 600.0  # the manual: a support file may take ten minutes

_REMOTE_CONTROL: Final = "switch the robot to Remote Control on its teach pendant, then connect again"
_UNKNOWN: Final = "this controller does not know the command"
_POWER: Final = "look at the safety mode: an emergency stop, a violation or a fault has to be cleared first"
_PROGRAM: Final = "load a program first, release the brakes, clear any stop; log and pendant say more"
_NO_PROGRAM: Final = "there is no running program to pause"
_PATH: Final = (
    "give a path below the controller's programs folder; the file and its installation must open on the robot"
)
_UNLOCK: Final = "wait until 5 s after the stop, look for its cause, then ask again"
_ROLE: Final = "look at the roles set up on the pendant"


@dataclass(frozen=True, slots=True)
class Operation(Generic[Answer]):
    """A line to send and how to read its answer; ``read`` may raise RemoteProtocolError.

    timeout_s: how long the answer may take, None for the connection's usual limit.
    """

    line: str
    read: Callable[[str], Answer]
    available: Availability = _ALWAYS
    advice: str = ""
    timeout_s: float | None = None

    def answer(self, reply: str) -> Answer:
        """What the reply says; RobotRefused when it is not an answer of success."""
        try:
            return self.read(reply)
        except RemoteProtocolError as error:
            raise RobotRefused(self.line, reply, self._advice(reply)) from error

    @property
    def in_every_version(self) -> bool:
        """True when no controller of either series lacks it."""
        return self.available == _ALWAYS

    def check(self, version: PolyscopeVersion) -> None:
        """Raise RobotRefused when a controller of this version does not know the command."""
        if not self.available.covers(version):
            raise RobotRefused(
                self.line,
                f"PolyScope {version} does not know it",
                f"it exists on {self.available}: update the controller, or do without",
            )

    def _advice(self, reply: str) -> str:
        if wire.is_not_understood(reply):
            return f"{_UNKNOWN}; it exists on {self.available}"
        return _REMOTE_CONTROL if "remote control" in reply.lower() else self.advice


def _says(*beginnings: str) -> Callable[[str], None]:
    """Success is an answer that begins with one of these."""

    def read(reply: str) -> None:
        if not reply.lower().startswith(tuple(beginning.lower() for beginning in beginnings)):
            raise RemoteProtocolError(f"{reply!r} does not begin with {' or '.join(map(repr, beginnings))}")

    return read


def _number(reply: str) -> str:
    if not (reply.isascii() and reply.isdigit()):
        raise RemoteProtocolError(f"{reply!r} is not a serial number")
    return reply


def _model(reply: str) -> str:
    if not reply.startswith("UR"):
        raise RemoteProtocolError(f"{reply!r} is not a robot model")
    return reply


# Power and safety

POWER_ON = Operation("power on", _says(wire.POWERING_ON), advice=_POWER)
POWER_OFF = Operation("power off", _says(wire.POWERING_OFF), advice=_POWER)
BRAKE_RELEASE = Operation("brake release", _says(wire.BRAKE_RELEASING), advice=_POWER)
UNLOCK_PROTECTIVE_STOP = Operation("unlock protective stop", _says(wire.UNLOCKING), _FROM_3_1, _UNLOCK)
RESTART_SAFETY = Operation(
    "restart safety", _says(wire.RESTARTING_SAFETY), Availability.since("3.7", "5.1"), "look at the safety mode"
)
ROBOT_MODE: Operation[RobotMode] = Operation("robotmode", wire.parse_robot_mode)
SAFETY_MODE: Operation[SafetyMode] = Operation("safetymode", wire.parse_safety_mode)
SAFETY_STATUS: Operation[SafetyStatus] = Operation(
    "safetystatus", wire.parse_safety_status, Availability.since("3.11", "5.4")
)

# Programs and installations

PLAY = Operation("play", _says(wire.STARTING), advice=_PROGRAM)
PAUSE = Operation("pause", _says(wire.PAUSING), advice=_NO_PROGRAM)
STOP = Operation("stop", _says(wire.STOPPED))
IS_RUNNING: Operation[bool] = Operation("running", wire.parse_boolean)
PROGRAM_STATE: Operation[tuple[ProgramState, str | None]] = Operation("programState", wire.parse_program_state)
LOADED_PROGRAM: Operation[str | None] = Operation("get loaded program", wire.parse_loaded_program)
IS_PROGRAM_SAVED: Operation[tuple[bool, str | None]] = Operation("isProgramSaved", wire.parse_program_saved)


def load(program: str) -> Operation[str]:
    """Load a program by its name below the controller's program folder; answers with its path there."""
    return Operation(f"load {program}", wire.parse_loading, advice=_PATH)


def load_installation(installation: str) -> Operation[str]:
    """Load an installation file; answers with its path on the controller."""
    since = Availability.since("3.2.18654", "5.0")
    return Operation(f"load installation {installation}", wire.parse_loading, since, _PATH)


# Pendant

CLOSE_POPUP = Operation("close popup", _says(wire.CLOSING_POPUP))
CLOSE_SAFETY_POPUP = Operation("close safety popup", _says(wire.CLOSING_SAFETY_POPUP), _FROM_3_1)
USER_ROLE: Operation[UserRole] = Operation("getUserRole", wire.parse_user_role, Availability.since("3.1", None))
OPERATIONAL_MODE: Operation[OperationalMode] = Operation(
    "get operational mode", wire.parse_operational_mode, Availability.since(None, "5.6")
)
CLEAR_OPERATIONAL_MODE = Operation(
    "clear operational mode",
    _says("No longer controlling the operational mode", "operational mode is no longer controlled"),
    Availability.since(None, "5.0"),
)
IS_IN_REMOTE_CONTROL: Operation[bool] = Operation(
    "is in remote control", wire.parse_boolean, Availability.since(None, "5.6")
)


def popup(text: str) -> Operation[None]:
    """Show a popup on the teach pendant."""
    return Operation(f"popup {text}", _says(wire.SHOWING_POPUP))


def add_to_log(text: str) -> Operation[None]:
    """Write a line into the controller's log."""
    return Operation(f"addToLog {text}", _says(wire.LOG_ADDED), advice="give a text that is not empty")


def set_user_role(role: UserRole) -> Operation[None]:
    """Choose who the pendant's user is (CB3)."""
    since = Availability.since("3.0", None)  # or before
    return Operation(f"setUserRole {role.value}", _says("Setting user role"), since, _ROLE)


def set_operational_mode(mode: OperationalMode) -> Operation[None]:
    """Take control of the operational mode (e-Series): MANUAL or AUTOMATIC."""
    if mode is OperationalMode.NONE:
        raise LocalProtocolError("nobody can set the operational mode NONE: ask CLEAR_OPERATIONAL_MODE")
    read = _says(f"Operational mode {mode.value} is set", f"Setting operational mode: {mode.value}")
    return Operation(f"set operational mode {mode.value}", read, Availability.since(None, "5.0"))


# About the controller

POLYSCOPE_VERSION: Operation[PolyscopeVersion] = Operation("PolyscopeVersion", wire.parse_polyscope_version)
VERSION: Operation[PolyscopeVersion] = Operation(
    "version", wire.parse_polyscope_version, Availability.since(None, "5.13")
)
SERIAL_NUMBER: Operation[str] = Operation("get serial number", _number, Availability.since("3.12", "5.6"))
ROBOT_MODEL: Operation[str] = Operation("get robot model", _model, Availability.since("3.12", "5.6"))
SAVE_LOG = Operation("saveLog", _says("Log saved to disk"), _REPORTS, "look at the space on the controller's disk")
SHUTDOWN = Operation("shutdown", _says(wire.SHUTTING_DOWN))
QUIT = Operation("quit", _says(wire.DISCONNECTED))


def generate_flight_report(kind: str = "system") -> Operation[str]:
    """Write a report: controller, software or system. Answers with its id; takes minutes."""
    advice = "ask for controller, software or system, and at most once in 30 s"
    return Operation(
        f"generate flight report {kind}", wire.parse_flight_report, _REPORTS, advice, timeout_s=_REPORT_TIMEOUT_S
    )


def generate_support_file(directory: str) -> Operation[str]:
    """Write a zip file into a directory below the programs folder. Answers with its name; takes minutes."""
    advice = "give a directory that exists below the programs folder, and see that its disk has space"
    return Operation(
        f"generate support file {directory}", wire.parse_support_file, _REPORTS, advice, timeout_s=_REPORT_TIMEOUT_S
    )


# Any line

_WITHOUT_ARGUMENT: Final = {row.line.lower(): row for row in tuple(globals().values()) if isinstance(row, Operation)}
_WITH_ARGUMENT: Final[dict[str, Callable[[str], Operation[str] | Operation[None]]]] = {
    "load installation": load_installation,
    "load": load,
    "popup": popup,
    "addToLog": add_to_log,
    "generate flight report": generate_flight_report,
    "generate support file": generate_support_file,
}
_REFUSALS: Final = ("could not understand", "failed", "error", "file not found", "cannot", "command is not allowed")

_ROLES_AND_MODES: Final = {"setUserRole", "set operational mode"}  # refusals of them begin with "Failed"

WORDS: Final = (
    *sorted({row.line for row in _WITHOUT_ARGUMENT.values()} | _WITH_ARGUMENT.keys() | _ROLES_AND_MODES, key=str.lower),
)
"""The commands by their words, in alphabetical order; arguments go behind them."""


def command(line: str) -> Operation[str]:
    """Any line; the answer is whatever the robot says."""
    return Operation(line, str)


def judged(line: str) -> Operation[str]:
    """Any line; the answer is what the robot says, unless that is no answer of success."""
    known = _known(line.strip())

    def read(reply: str) -> str:
        if known is not None:
            known.answer(reply)
        elif reply.lower().startswith(_REFUSALS):
            raise RobotRefused(line, reply, _UNKNOWN if wire.is_not_understood(reply) else "")
        return reply

    return Operation(line, read, timeout_s=known.timeout_s if known is not None else None)


def _known(line: str) -> Operation[Any] | None:
    if (row := _WITHOUT_ARGUMENT.get(line.lower())) is not None:
        return row
    for words, of in _WITH_ARGUMENT.items():
        if line.lower().startswith(f"{words.lower()} "):
            return of(line[len(words) :].strip())
    return None
