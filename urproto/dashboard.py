"""Dashboard server (TCP 29999): a line of text in each direction, ended by a line feed.

Sources of the texts: the vendor's dashboard manuals, console captures of a 3.15.8 and a 5.11 controller, and the reply
patterns of public clients. ``COMMANDS`` lists the commands for both ends, with their first versions and confirmations.
"""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeVar

from urproto.errors import RemoteProtocolError
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.text import from_bytes, lines, to_bytes
from urproto.versions import Availability, PolyscopeVersion

GREETING = "Connected: Universal Robots Dashboard Server"

POWERING_ON = "Powering on"
POWERING_OFF = "Powering off"
BRAKE_RELEASING = "Brake releasing"
STARTING = "Starting program"
STOPPED = "Stopped"
PAUSING = "Pausing program"
SHUTTING_DOWN = "Shutting down"
DISCONNECTED = "Disconnected"
SHOWING_POPUP = "showing popup"
CLOSING_POPUP = "closing popup"
CLOSING_SAFETY_POPUP = "closing safety popup"
LOG_ADDED = "Added log message"
LOG_SAVED = "Log saved to disk"
NO_LOG_MESSAGE = "No log message to add"
NO_PROGRAM_LOADED = "No program loaded"
RESTARTING_SAFETY = "Restarting safety"
UNLOCKING = "Protective stop releasing"
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
NOT_IN_REMOTE_CONTROL = (  # as quoted by users of e-Series arms
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port "
    "29999"
)
# Both modes in quotes: reply of URSim 5.25 to the second, quoted by a user; the pattern of the first in a Rust client.
# The ROS drivers expect the current mode, which is NONE without a password for it.
MODE_SET = "Operational mode '{}' is set"
NOT_CONTROLLING_MODE = "No longer controlling the operational mode. Current operational mode: 'NONE'."
_MODE_SET = ("Operational mode", "Setting operational mode")  # those of urcl and of the manual
_MODE_CLEARED = ("No longer controlling the operational mode", "operational mode is no longer controlled")
UNNAMED_PROGRAM = "<unnamed>"  # e-Series, in the answer to programState; CB3 says null

AVAILABLE: Final = Availability.since("3.0", "5.0", None)
"""PolyScope X has the Robot API instead."""

MAX_LINE = 65536  # bytes; guess: ample for a popup text, and limits the memory for an endless line


@dataclass(frozen=True, slots=True)
class Command:
    """A dashboard command.

    words: as documented; case does not matter.
    available: the first versions that have it.
    confirmations: how a reply on success may begin; none if the reply is a value, which ``parse_...`` reads.
    takes_argument: the rest of the line is its argument, verbatim.
    remote_only: an e-Series arm in local control refuses it.
    source: of the versions. cb and e are the vendor's dashboard manuals of the CB series and of the e-Series (2022),
        urcl is the table of the official C++ client, ua the documentation of UnderAutomation's client.
    """

    words: str
    available: Availability
    confirmations: tuple[str, ...]
    takes_argument: bool
    remote_only: bool
    source: str


def _command(
    words: str, cb3: str | None, e: str | None, source: str, *confirmations: str, argument: bool = False,
    remote: bool = False,
) -> tuple[str, Command]:  # fmt: skip
    return words.lower(), Command(words, Availability.since(cb3, e, None), confirmations, argument, remote, source)


# Versions before 3.0 belong to controllers that are not emulated; they mean that every CB3 controller has the command.
# Where urcl gives a later version than a manual, we follow the manual: setUserRole (3.1), and load installation without
# its build. In urcl, no CB3 controller has safetystatus, and version exists from 5.0 on; ua and the manual differ.
COMMANDS: Final[dict[str, Command]] = dict(
    (
        _command("load", "1.4", "5.0", "cb e urcl", argument=True, remote=True),
        _command("play", "1.4", "5.0", "cb e urcl", STARTING, remote=True),
        _command("stop", "1.4", "5.0", "cb e urcl", STOPPED, remote=True),
        _command("pause", "1.4", "5.0", "cb e urcl", PAUSING, remote=True),
        _command("quit", "1.4", "5.0", "cb e urcl", DISCONNECTED),
        _command("shutdown", "1.4", "5.0", "cb e urcl", SHUTTING_DOWN, remote=True),
        _command("running", "1.6", "5.0", "cb e urcl"),
        _command("robotmode", "1.6", "5.0", "cb e urcl"),
        _command("get loaded program", "1.6", "5.0", "cb e urcl"),
        _command("popup", "1.6", "5.0", "cb e urcl", SHOWING_POPUP, argument=True),
        _command("close popup", "1.6", "5.0", "cb e urcl", CLOSING_POPUP),
        _command("addToLog", "1.8.11657", "5.0", "cb e", LOG_ADDED, argument=True),
        _command("isProgramSaved", "1.8.11997", "5.0", "cb e"),
        _command("programState", "1.8.11997", "5.0", "cb e"),
        _command("PolyscopeVersion", "1.8.14035", "5.0", "cb e"),
        _command("setUserRole", "1.8.14035", None, "cb", "Setting user role", argument=True),
        _command("getUserRole", "3.1", None, "urcl"),
        _command("power on", "3.0", "5.0", "cb e urcl", POWERING_ON, remote=True),
        _command("power off", "3.0", "5.0", "cb e urcl", POWERING_OFF, remote=True),
        _command("brake release", "3.0", "5.0", "cb e urcl", BRAKE_RELEASING, remote=True),
        _command("safetymode", "3.0", "5.0", "cb e urcl"),
        _command("unlock protective stop", "3.1", "5.0", "cb e urcl", UNLOCKING, remote=True),
        _command("close safety popup", "3.1", "5.0", "cb e urcl", CLOSING_SAFETY_POPUP, remote=True),
        _command("load installation", "3.2.18654", "5.0", "cb e", argument=True, remote=True),
        _command("restart safety", "3.7", "5.1", "cb e urcl", RESTARTING_SAFETY, remote=True),
        _command("safetystatus", "3.11", "5.4", "ua e"),
        _command("get serial number", "3.12", "5.6", "cb e urcl"),
        _command("get robot model", "3.12", "5.6", "cb e urcl"),
        _command("generate flight report", "3.13", "5.8", "e urcl", argument=True),
        _command("generate support file", "3.13", "5.8", "e urcl", argument=True),
        _command("saveLog", "3.13", "5.8", "urcl", LOG_SAVED),
        _command("set operational mode", None, "5.0", "e urcl", *_MODE_SET, argument=True, remote=True),
        _command("clear operational mode", None, "5.0", "urcl e", *_MODE_CLEARED, remote=True),
        _command("get operational mode", None, "5.6", "e urcl"),
        _command("is in remote control", None, "5.6", "e urcl"),
        _command("version", None, "5.13", "e"),
    )
)  # by their words in lower case


class ProgramState(Enum):
    """First word of the answer to ``programState``."""

    STOPPED = "STOPPED"
    PLAYING = "PLAYING"
    PAUSED = "PAUSED"


class UserRole(Enum):
    """Role of the user at the pendant (CB3)."""

    PROGRAMMER = "programmer"
    OPERATOR = "operator"
    NONE = "none"
    LOCKED = "locked"
    RESTRICTED = "restricted"


class OperationalMode(Enum):
    """Operational mode (e-Series); NONE when neither a password nor the dashboard controls it."""

    MANUAL = "manual"
    AUTOMATIC = "automatic"
    NONE = "none"


_Member = TypeVar("_Member", bound=Enum)


def failed(command: str) -> str:
    """The reply to a command that was understood but failed."""
    return f"Failed to execute: {command}"


def not_understood(line: str) -> str:
    """The reply to an unknown command; the kind of quotes is uncertain."""
    return f"could not understand: '{line}'"


def is_not_understood(reply: str) -> bool:
    """True for the reply to an unknown command, with any kind of quotation marks."""
    return reply.lower().startswith("could not understand")


def encode_line(text: str) -> bytes:
    """The bytes of a line. Line breaks inside become spaces, because a reply is one line."""
    return to_bytes(" ".join(lines(text))) + b"\n"


class LineDecoder:
    """Splits a stream into lines; its chunks may be of any size. A CR before the LF is dropped."""

    def __init__(self, max_line: int = MAX_LINE) -> None:
        self._max_line = max_line
        self._buffer = bytearray()
        self.error: RemoteProtocolError | None = None

    def feed(self, data: bytes) -> list[str]:
        """Add bytes; returns the lines they complete, in the form of `urproto.text`.

        A line over the limit ends the stream: lines before it are still returned, and this call, or the next one if
        there were any, raises RemoteProtocolError; ``error`` is set immediately.
        """
        lines: list[str] = []
        start = 0
        while self.error is None and start <= len(data):
            end = data.find(b"\n", start)
            self._buffer += data[start:] if end < 0 else data[start:end]
            if len(self._buffer) > self._max_line:
                self.error = RemoteProtocolError(f"a dashboard line is longer than {self._max_line} bytes")
                self._buffer.clear()
            elif end >= 0:
                lines.append(from_bytes(self._buffer.removesuffix(b"\r")))
                self._buffer.clear()
            start = len(data) + 1 if end < 0 else end + 1
        if self.error is not None and not lines:
            raise self.error
        return lines


def _after(prefix: str, reply: str) -> str:
    head, separator, value = reply.partition(":")
    if not separator or head.lower() != prefix.lower():
        raise RemoteProtocolError(f"{reply!r} does not begin with {prefix!r}")
    return value.strip()


def _member(members: type[_Member], name: str) -> _Member:
    try:
        return members[name]
    except KeyError:
        raise RemoteProtocolError(f"{name!r} is not a {members.__name__}") from None


def parse_robot_mode(reply: str) -> RobotMode:
    """``Robotmode: RUNNING`` and the like; RemoteProtocolError for anything else."""
    return _member(RobotMode, _after("Robotmode", reply))


def parse_safety_mode(reply: str) -> SafetyMode:
    """``Safetymode: NORMAL`` and the like; RemoteProtocolError for anything else."""
    return _member(SafetyMode, _after("Safetymode", reply))


def parse_safety_status(reply: str) -> SafetyStatus:
    """``Safetystatus: NORMAL`` and the like; RemoteProtocolError for anything else."""
    return _member(SafetyStatus, _after("Safetystatus", reply))


def parse_program_state(reply: str) -> tuple[ProgramState, str | None]:
    """``PLAYING pick.urp`` as state and program name, the name None when there is no program."""
    word, _, name = reply.partition(" ")
    return _member(ProgramState, word), None if name in ("", "null", UNNAMED_PROGRAM) else name


def parse_loaded_program(reply: str) -> str | None:
    """``Loaded program: /programs/x.urp`` as a path; None without a saved one.

    PolyScope shows a new program in angle brackets, in the language of the pendant: ``/programs/<unnamed>.urp``.
    """
    if reply == NO_PROGRAM_LOADED:
        return None
    path = _after("Loaded program", reply)
    return None if re.fullmatch(r"(.*/)?<.*>(\.urp)?", path) else path


def parse_boolean(reply: str) -> bool:
    """The value of ``true``, ``false`` or ``Program running: true``; case does not matter."""
    word = reply.rpartition(":")[2].strip().lower()
    if word not in ("true", "false"):
        raise RemoteProtocolError(f"{reply!r} is neither true nor false")
    return word == "true"


def parse_polyscope_version(reply: str) -> PolyscopeVersion:
    """The number in ``URSoftware 3.15.8.106339 (Jun 20 2022)``."""
    match = re.search(r"[0-9]{1,9}\.[0-9]{1,9}(\.[0-9]{1,9}){0,2}", reply)
    if match is None:
        raise RemoteProtocolError(f"{reply!r} does not contain a version number")
    return PolyscopeVersion.parse(match[0])


def parse_loading(reply: str) -> str:
    """The path in ``Loading program: /programs/x.urp`` and in the answer about an installation.

    e-Series controllers append the installation to the program: ``..., /programs/default.installation``.
    """
    match = re.fullmatch(r"Loading (?:program|installation): *(.+?)(?:, [^,]+\.installation)?", reply)
    if match is None:
        raise RemoteProtocolError(f"{reply!r} does not report that something is loading")
    return match[1]


def parse_program_saved(reply: str) -> tuple[bool, str | None]:
    """``true pick.urp`` as a bool and the program name; early CB3 software sends no name."""
    word, _, name = reply.partition(" ")
    return parse_boolean(word), None if name in ("", "null", UNNAMED_PROGRAM) else name


def parse_user_role(reply: str) -> UserRole:
    """``PROGRAMMER`` and the like."""
    return _member(UserRole, reply.strip().upper())


def parse_operational_mode(reply: str) -> OperationalMode:
    """``MANUAL`` and the like."""
    return _member(OperationalMode, reply.strip().upper())


def parse_flight_report(reply: str) -> str:
    """The id in ``Flight Report generated with id: 7``, the form sent by simulators."""
    return _after("Flight Report generated with id", reply)


def parse_support_file(reply: str) -> str:
    """The file name in ``Completed successfully: x.zip``."""
    return _after("Completed successfully", reply)
