"""What can go wrong while talking to a robot.

ClientError
├── RobotUnreachableError    no connection came about
├── ConnectionLostError      the robot closed it, or the network did
├── NoAnswerError            the robot keeps silent
├── DeviceError              a device of this machine cannot be made
└── ScriptFailedError        a script did not compile or failed while running

urproto.errors.RobotRefused           the robot understood and said no
urproto.errors.RemoteProtocolError    the peer does not speak this protocol
urproto.errors.LocalProtocolError     we were asked to send what the protocol cannot carry
"""

from pathlib import Path

__all__ = [
    "ClientError",
    "ConnectionLostError",
    "DeviceError",
    "NoAnswerError",
    "RobotUnreachableError",
    "ScriptFailedError",
]


class ClientError(Exception):
    """Base of what the client raises itself."""


class RobotUnreachableError(ClientError):
    """No connection to ``host``:``port``."""

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(
            f"no connection to {host}:{port} ({reason}): check the address, and that the controller is up and "
            "offers this port"
        )
        self.host = host
        self.port = port
        self.reason = reason


class ConnectionLostError(ClientError):
    """The connection to ``host``:``port`` ended; connect again to go on."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"{host}:{port} closed the connection: connect again to go on")
        self.host = host
        self.port = port


class NoAnswerError(ClientError):
    """Nothing came from ``host``:``port`` for ``timeout_s`` seconds."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        super().__init__(f"{host}:{port} sent nothing for {timeout_s:g} s: it may be busy, or speak something else")
        self.host = host
        self.port = port
        self.timeout_s = timeout_s


class DeviceError(ClientError):
    """The serial device ``path`` cannot be made on this machine."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"cannot make the device {path} ({reason}): choose another path, in a folder you may write to")
        self.path = path
        self.reason = reason


class ScriptFailedError(ClientError):
    """The controller reports an error at ``line`` and ``column`` (from 1) of the script it was sent."""

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(f"script line {line}, column {column}: {text}")
        self.line = line
        self.column = column
        self.text = text
