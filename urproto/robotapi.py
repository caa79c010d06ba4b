"""The Robot API of PolyScope X: HTTP with JSON bodies, which replaces the dashboard server of older software.

Sources of paths, bodies and responses: the official C++ client (``dashboard_client_implementation_x``) and its tests,
and parts of the API's own documentation published by users of robots and simulators with 10.11 to 10.13 (statuses,
names of modes, 403 in local control). ``ENDPOINTS`` lists the requests for both ends, with their first versions.
"""

from dataclasses import dataclass
from typing import Final, Literal
from urllib.parse import quote

from urproto.compat import StrEnum
from urproto.facts.scope import Situation
from urproto.facts.tables import find
from urproto.modes import RobotMode, SafetyMode
from urproto.versions import Availability, PolyscopeVersion

BASE: Final = "/universal-robots/robot-api"
OPENAPI: Final = f"{BASE}/openapi.json"
URCAPS: Final = "/universal-robots/urservice/api/v1/urcaps"
"""Another service on the same port, which start scripts poll until the robot is up."""

WEB_SERVER: Final = Availability.since(None, None, "10.0")
"""Port 80."""
AVAILABLE: Final = Availability.since(None, None, "10.11")
"""Versions with the API, according to the documentation of the C++ client."""
_READING: Final = Availability.since(None, None, "10.12")

PROGRAM_LOADED: Final = "Program loaded successfully"
"""Message of a load (quoted in issue 551 of the official C++ client)."""
DEFAULT_PROGRAM: Final = "Default program"
"""The program that is loaded after power-up; it always exists."""
MAX_UPLOAD: Final = 1024 * 1024 + 64 * 1024
"""Maximum size of a request's body [bytes] (guess); programs in public repositories have some 100 kB."""

Method = Literal["GET", "PUT", "POST"]

_UPDATING: Final = "UPDATING"
SAFETY_MODES: Final = ("NORMAL", "REDUCED", "FAULT", "PROTECTIVE_STOP", "EMERGENCY_STOP")


class StateAction(StrEnum):
    """Actions on the arm."""

    POWER_ON = "POWER_ON"
    POWER_OFF = "POWER_OFF"
    BRAKE_RELEASE = "BRAKE_RELEASE"
    UNLOCK_PROTECTIVE_STOP = "UNLOCK_PROTECTIVE_STOP"
    RESTART_SAFETY = "RESTART_SAFETY"


class ProgramAction(StrEnum):
    """Actions on the loaded program."""

    PLAY = "play"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A request of the API.

    path: below ``BASE``; a part in braces is a placeholder. remote_only: refused (403) by a robot in local control.
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
PUT_LOAD: Final = Endpoint("PUT", "/program/v1/load", AVAILABLE, remote_only=True)  # a client for 10.12 uses it
PUT_LOADED: Final = Endpoint("PUT", "/program/v1/loaded", _READING, remote_only=True)
GET_LOADED: Final = Endpoint("GET", "/program/v1/loaded", _READING)
PUT_PROGRAM_STATE: Final = Endpoint("PUT", "/program/v1/state", AVAILABLE, remote_only=True)
GET_PROGRAM_STATE: Final = Endpoint("GET", "/program/v1/state", AVAILABLE)
GET_PROGRAMS: Final = Endpoint("GET", "/programs/v1/", _READING)
# the vendor's tests upload in local control
POST_PROGRAM: Final = Endpoint("POST", "/programs/v1/", _READING)
PUT_PROGRAM: Final = Endpoint("PUT", "/programs/v1/", _READING)
GET_PROGRAM: Final = Endpoint("GET", "/programs/v1/{name}", _READING)

ENDPOINTS: Final = tuple(each for each in globals().values() if isinstance(each, Endpoint))


def api_version(version: PolyscopeVersion) -> str:
    """The version of the API, from which clients derive its features."""
    return find("robot_api.version", Situation(version)).value


def safety_word(mode: SafetyMode) -> str:
    """The API's word for a safety mode. It has five words; the mapping is a guess except where the names are equal."""
    if mode.name in SAFETY_MODES:
        return mode.name
    if mode.name.endswith("EMERGENCY_STOP"):
        return "EMERGENCY_STOP"
    return "FAULT" if mode in (SafetyMode.VIOLATION, SafetyMode.UNDEFINED_SAFETY_MODE) else "PROTECTIVE_STOP"


def parse_safety_word(word: str) -> SafetyMode:
    """The safety mode of a word; the most general one if there are several. Raises ValueError for an unknown word."""
    if word not in SAFETY_MODES:
        raise ValueError(f"{word!r} is not a safety mode of the Robot API")
    return SafetyMode.ROBOT_EMERGENCY_STOP if word == "EMERGENCY_STOP" else SafetyMode[word]


def robot_word(mode: RobotMode) -> str:
    """The API's word for a robot mode."""
    return _UPDATING if mode is RobotMode.UPDATING_FIRMWARE else mode.name


ROBOT_MODES: Final = tuple(map(robot_word, RobotMode))


def parse_robot_word(word: str) -> RobotMode:
    """The robot mode of a word. Raises ValueError for an unknown word."""
    try:
        return RobotMode.UPDATING_FIRMWARE if word == _UPDATING else RobotMode[word]
    except KeyError:
        raise ValueError(f"{word!r} is not a robot mode") from None


def program_path(name: str) -> str:
    """The path of a program, below ``BASE``."""
    return GET_PROGRAM.path.format(name=quote(name, safe=""))
