"""Dashboard server (TCP 29999): one line of text each way, ended by a line feed.

Texts: the vendor's dashboard manuals, console captures of a 3.15.8 and 5.11 controller and
the reply patterns of public clients.
"""

import re
from enum import Enum
from typing import TypeVar

from urproto.errors import RemoteProtocolError
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.text import from_bytes, lines, to_bytes
from urproto.versions import PolyscopeVersion

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
NO_LOG_MESSAGE = "No log message to add"
NO_PROGRAM_LOADED = "No program loaded"
RESTARTING_SAFETY = "Restarting safety"
UNLOCKING = "Protective stop releasing"
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
NOT_IN_REMOTE_CONTROL = (  # as users of e-Series arms quote it
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port "
    "29999"
)
UNNAMED_PROGRAM = "<unnamed>"  # e-Series, in the answer to programState; CB3 says null

MAX_LINE = 65536  # bytes; guess: ample for a popup text, bounds what an endless line can cost


class ProgramState(Enum):
    """First word of the answer to ``programState``."""

    STOPPED = "STOPPED"
    PLAYING = "PLAYING"
    PAUSED = "PAUSED"


class UserRole(Enum):
    """Who the pendant's user is (CB3)."""

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
    """The answer to a command that was understood and could not be done."""
    return f"Failed to execute: {command}"


def not_understood(line: str) -> str:
    """The answer to an unknown command; that the quotes are these is uncertain."""
    return f"could not understand: '{line}'"


def is_not_understood(reply: str) -> bool:
    """True for the answer to an unknown command, whatever its quotes."""
    return reply.lower().startswith("could not understand")


def encode_line(text: str) -> bytes:
    """A line on the wire. Line breaks inside become spaces: an answer is one line."""
    return to_bytes(" ".join(lines(text))) + b"\n"


class LineDecoder:
    """Cuts lines out of a stream that arrives in any split. A CR before the LF is dropped."""

    def __init__(self, max_line: int = MAX_LINE) -> None:
        self._max_line = max_line
        self._buffer = bytearray()
        self.error: RemoteProtocolError | None = None

    def feed(self, data: bytes) -> list[str]:
        """Take bytes, give the lines they complete, as `urproto.text` holds them.

        A line over the limit ends the stream: lines before it are still given, and this
        call, or the next one if there were any, raises RemoteProtocolError; ``error`` is
        set at once.
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
        raise RemoteProtocolError(f"{name!r} is no {members.__name__}") from None


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
    """``Loaded program: /programs/x.urp`` as a path; None when no program is loaded."""
    if reply == NO_PROGRAM_LOADED:
        return None
    return _after("Loaded program", reply)


def parse_boolean(reply: str) -> bool:
    """The truth in ``true``, ``false`` and ``Program running: true``, in any case of letters."""
    word = reply.rpartition(":")[2].strip().lower()
    if word not in ("true", "false"):
        raise RemoteProtocolError(f"{reply!r} says neither true nor false")
    return word == "true"


def parse_polyscope_version(reply: str) -> PolyscopeVersion:
    """The number in ``URSoftware 3.15.8.106339 (Jun 20 2022)``."""
    match = re.search(r"[0-9]{1,9}\.[0-9]{1,9}(\.[0-9]{1,9}){0,2}", reply)
    if match is None:
        raise RemoteProtocolError(f"there is no version number in {reply!r}")
    return PolyscopeVersion.parse(match[0])


def parse_loading(reply: str) -> str:
    """The path in ``Loading program: /programs/x.urp`` and in the answer about an installation.

    e-Series controllers name the installation behind the program: ``..., /programs/default.installation``.
    """
    match = re.fullmatch(r"Loading (?:program|installation): *(.+?)(?:, [^,]+\.installation)?", reply)
    if match is None:
        raise RemoteProtocolError(f"{reply!r} does not say that something is loaded")
    return match[1]


def parse_program_saved(reply: str) -> tuple[bool, str | None]:
    """``true pick.urp`` as truth and program name; early CB3 software sends no name."""
    word, _, name = reply.partition(" ")
    return parse_boolean(word), None if name in ("", "null", UNNAMED_PROGRAM) else name


def parse_user_role(reply: str) -> UserRole:
    """``PROGRAMMER`` and the like."""
    return _member(UserRole, reply.strip().upper())


def parse_operational_mode(reply: str) -> OperationalMode:
    """``MANUAL`` and the like."""
    return _member(OperationalMode, reply.strip().upper())


def parse_flight_report(reply: str) -> str:
    """The id in ``Flight Report generated with id: 7``, the form simulators answer."""
    return _after("Flight Report generated with id", reply)


def parse_support_file(reply: str) -> str:
    """The file name in ``Completed successfully: x.zip``."""
    return _after("Completed successfully", reply)
