"""Protocol between a running controller manager and other processes of the same user: JSON, one message per line.

Manager and client run on the same machine. They use a Unix socket, named after the robot's address, in a folder that
only this user can enter. Without Unix sockets, a file in that folder contains the port on the loopback interface, and
the token that the first line must contain.

Client: {"protocol": 1, "token": ""}, then requests {"id": 1, "do": "list_controllers", ...arguments}
Manager: {"protocol": 1, "robot": "192.168.1.10", "pid": 4711}, then {"id": 1, "result": ...} or {"id": 1, "error": ...}
"""

import json
import os
import re
import socket
import stat
import tempfile
from collections.abc import Mapping
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any, Final

from client.errors import ControllerError, FileError, GoalRejectedError, ManagerError
from urproto.errors import URError
from urproto.ports import CONTROLLER_PORTS
from urproto.text import quoted

VERSION: Final = 1
MAX_REQUEST: Final = 2**18  # bytes: a trajectory of a thousand points; parsed within a few milliseconds
MAX_ANSWER: Final = 2**22
HAS_UNIX_SOCKETS: Final = hasattr(socket, "AF_UNIX")
_MAX_PATH: Final = 100  # bytes: of a Unix socket, 104 with its end on macOS, 108 on Linux
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9.-]")

Message = dict[str, Any]


# location of the socket


def rendezvous_path(robot_ip: str, rtde_port: int) -> Path:
    """Path of the socket or port file of a robot's manager, without its suffix. Raises FileError."""
    robot = _numeric(robot_ip)
    if rtde_port != CONTROLLER_PORTS["rtde"]:
        robot += f"-{rtde_port}"
    name = _UNSAFE.sub("_", robot)
    if name != robot or len(name) > 40:  # keeps the names of different robots distinct
        name = f"{name[:20]}-{sha256(robot.encode()).hexdigest()[:12]}"
    place = _private_folder() / name
    if len(os.fsencode(place)) + len(".sock") > _MAX_PATH:
        raise FileError(place, "the path is too long for a Unix socket: set XDG_RUNTIME_DIR to a shorter one")
    return place


def _numeric(host: str) -> str:
    """Resolve a host name, so that a robot's name and its address give the same path."""
    try:
        return str(socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][4][0])
    except (OSError, UnicodeError):
        return host.lower()


def _private_folder() -> Path:
    """This user's private folder, created if necessary. Raises FileError if other users may enter it."""
    folder = _runtime_folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid"):
            found = os.lstat(folder)
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
                raise FileError(folder, "it is not a folder of this user: remove it, or set XDG_RUNTIME_DIR")
            if found.st_mode & 0o077:
                folder.chmod(0o700)
    except OSError as error:
        raise FileError(
            folder, f"it cannot be used ({error.strerror}): set XDG_RUNTIME_DIR to a folder that you own"
        ) from None
    return folder


def _runtime_folder() -> Path:
    if given := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(given) / "ur-client"
    if not hasattr(os, "getuid"):
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "ur-client"
    usual = Path(f"/run/user/{os.getuid()}")  # from systemd, which does not set the variable in every shell
    return usual / "ur-client" if usual.is_dir() else Path(tempfile.gettempdir()) / f"ur-client-{os.getuid()}"


# messages


def encoded(message: Mapping[str, Any]) -> bytes:
    """Encode a message as a line; numbers that JSON cannot represent become null."""
    return json.dumps(_plain(message), separators=(",", ":")).encode() + b"\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return str(value) if isinstance(value, str) else value  # enumerations become plain strings


def decoded(line: bytes) -> Message:
    """Decode a line. Raises ManagerError if it is not a message."""
    try:
        message = json.loads(line, parse_constant=_refuse)
    except (ValueError, RecursionError):  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise ManagerError(f"this is not a JSON message: {quoted(line[:80])}") from None
    if not isinstance(message, dict):
        raise ManagerError(f"a message must be a JSON object, not {quoted(line[:80])}")
    return message


def _refuse(constant: str) -> None:
    raise ValueError(constant)


def described_error(error: URError) -> Message:
    if isinstance(error, GoalRejectedError):
        return {"controller": error.controller, "code": int(error.code), "reason": error.reason}
    if isinstance(error, ControllerError):
        return {"controller": error.controller, "reason": error.reason}
    return {"text": str(error)}


def error_of(message: Any) -> ManagerError | ControllerError:
    if not isinstance(message, Mapping):
        return ManagerError(f"the controller manager sent an error without text: {quoted(message)}")
    if "controller" not in message:
        return ManagerError(str(message.get("text")))
    controller, reason = str(message["controller"]), str(message.get("reason"))
    if isinstance(code := message.get("code"), int):
        return GoalRejectedError(controller, code, reason)
    return ControllerError(controller, reason)
