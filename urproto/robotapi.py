"""The Robot API of PolyScope X: HTTP with JSON bodies, in the place that the dashboard server has on older software.

Paths, bodies and answers: the official C++ client (``dashboard_client_implementation_x``) and its tests, and what users
of robots and simulators with 10.11 to 10.13 have published of the API's own documentation: statuses, the names of
modes, 403 in local control. What requests there are, and since when, is in ``ENDPOINTS``, for both ends.
"""

from dataclasses import dataclass
from typing import Final, Literal
from urllib.parse import quote

from urproto.compat import StrEnum
from urproto.modes import RobotMode, SafetyMode
from urproto.versions import Availability, PolyscopeVersion

BASE: Final = "/universal-robots/robot-api"
OPENAPI: Final = f"{BASE}/openapi.json"
URCAPS: Final = "/universal-robots/urservice/api/v1/urcaps"
"""Another service of the same port: what start scripts ask until the robot is up."""

WEB_SERVER: Final = Availability.since(None, None, "10.0")
"""Port 80."""
AVAILABLE: Final = Availability.since(None, None, "10.11")
"""The API; so the documentation of the C++ client."""
_READING: Final = Availability.since(None, None, "10.12")

DEFAULT_PROGRAM: Final = "Default program"
"""What is loaded when a robot was switched on, and always there."""
MOST_UPLOAD: Final = 4 * 1024 * 1024
"""Bytes of a request's body (guess); the programs of public repositories have some 100 kB."""

Method = Literal["GET", "PUT", "POST"]


class StateAction(StrEnum):
    """What can be done to the arm."""

    POWER_ON = "POWER_ON"
    POWER_OFF = "POWER_OFF"
    BRAKE_RELEASE = "BRAKE_RELEASE"
    UNLOCK_PROTECTIVE_STOP = "UNLOCK_PROTECTIVE_STOP"
    RESTART_SAFETY = "RESTART_SAFETY"


class ProgramAction(StrEnum):
    """What can be done to the loaded program."""

    PLAY = "play"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """What both ends know of a request.

    path: below ``BASE``; a part in braces is any name. remote_only: refused (403) by a robot in local control.
    """

    method: Method
    path: str
    available: Availability
    remote_only: bool = False


PUT_STATE: Final = Endpoint("PUT", "/robotstate/v1/state", AVAILABLE, remote_only=True)
GET_ROBOT_MODE: Final = Endpoint("GET", "/robotstate/v1/robotmode", _READING)
GET_SAFETY_MODE: Final = Endpoint("GET", "/robotstate/v1/safetymode", _READING)
GET_CONTROL_MODE: Final = Endpoint("GET", "/system/v1/controlmode", _READING)
GET_OPERATIONAL_MODE: Final = Endpoint("GET", "/system/v1/operationalmode", _READING)
PUT_LOAD: Final = Endpoint("PUT", "/program/v1/load", AVAILABLE, remote_only=True)  # that it stays in 10.12: guess
PUT_LOADED: Final = Endpoint("PUT", "/program/v1/loaded", _READING, remote_only=True)
GET_LOADED: Final = Endpoint("GET", "/program/v1/loaded", _READING)
PUT_PROGRAM_STATE: Final = Endpoint("PUT", "/program/v1/state", AVAILABLE, remote_only=True)
GET_PROGRAM_STATE: Final = Endpoint("GET", "/program/v1/state", AVAILABLE)
GET_PROGRAMS: Final = Endpoint("GET", "/programs/v1/", _READING)
# the vendor's tests upload in local control
POST_PROGRAM: Final = Endpoint("POST", "/programs/v1/", _READING)
PUT_PROGRAM: Final = Endpoint("PUT", "/programs/v1/", _READING)
GET_PROGRAM: Final = Endpoint("GET", "/programs/v1/{name}", _READING)

ENDPOINTS: Final = (
    PUT_STATE,
    GET_ROBOT_MODE,
    GET_SAFETY_MODE,
    GET_CONTROL_MODE,
    GET_OPERATIONAL_MODE,
    PUT_LOAD,
    PUT_LOADED,
    GET_LOADED,
    PUT_PROGRAM_STATE,
    GET_PROGRAM_STATE,
    GET_PROGRAMS,
    POST_PROGRAM,
    PUT_PROGRAM,
    GET_PROGRAM,
)


def api_version(version: PolyscopeVersion) -> str:
    """The API's own version, by which clients know what it has.

    3.1.4 came with 10.12.0 (C++ client), 3.1.6 is what a simulator of 2026 says; that it came with 10.13, and 3.0.0
    with 10.11, is a guess.
    """
    if version >= PolyscopeVersion(10, 13):
        return "3.1.6"
    return "3.1.4" if version >= PolyscopeVersion(10, 12) else "3.0.0"


_UPDATING: Final = "UPDATING"
ROBOT_MODES: Final = (
    "NO_CONTROLLER",
    "DISCONNECTED",
    "CONFIRM_SAFETY",
    "BOOTING",
    "POWER_OFF",
    "POWER_ON",
    "IDLE",
    "BACKDRIVE",
    "RUNNING",
    _UPDATING,
)
SAFETY_MODES: Final = ("NORMAL", "REDUCED", "FAULT", "PROTECTIVE_STOP", "EMERGENCY_STOP")


def safety_word(mode: SafetyMode) -> str:
    """A safety mode as the API names it, which has five words; which is which beyond its own names is a guess."""
    if mode.name in SAFETY_MODES:
        return mode.name
    if mode.name.endswith("EMERGENCY_STOP"):
        return "EMERGENCY_STOP"
    return "FAULT" if mode in (SafetyMode.VIOLATION, SafetyMode.UNDEFINED_SAFETY_MODE) else "PROTECTIVE_STOP"


def parse_safety_word(word: str) -> SafetyMode:
    """The safety mode of a word, of several the plainest. Raises ValueError for one that there is not."""
    if word not in SAFETY_MODES:
        raise ValueError(f"{word!r} is not a safety mode of the Robot API")
    return SafetyMode.ROBOT_EMERGENCY_STOP if word == "EMERGENCY_STOP" else SafetyMode[word]


def robot_word(mode: RobotMode) -> str:
    """A robot mode as the API names it."""
    return _UPDATING if mode is RobotMode.UPDATING_FIRMWARE else mode.name


def parse_robot_word(word: str) -> RobotMode:
    """The robot mode of a word. Raises ValueError for one that there is not."""
    try:
        return RobotMode.UPDATING_FIRMWARE if word == _UPDATING else RobotMode[word]
    except KeyError:
        raise ValueError(f"{word!r} is not a robot mode") from None


def program_path(name: str) -> str:
    """Where a program is, below ``BASE``."""
    return GET_PROGRAM.path.format(name=quote(name, safe=""))
