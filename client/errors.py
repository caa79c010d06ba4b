"""Exceptions of the client library.

All of them, and those of urproto.errors at the end of the list, derive from `URError`: `except URError` catches every
error that the client raises for a known cause.

ClientError
├── RobotUnreachableError    no connection could be established
├── ConnectionLostError      the robot closed the connection, or the network failed
├── NoAnswerError            the robot did not answer in time
├── WaitTimeoutError         the awaited event has not happened yet; also a TimeoutError
├── CameraError              the camera does not exist, or delivers no picture
├── GripperError             the gripper does not answer, or cannot carry out a command
├── DeviceError              a serial device could not be created on this machine
├── RecordingError           a recording cannot be read, written or used for this purpose
│   └── MissingExtraError    a required package is not installed
├── Ros2Error                ROS 2, or a required package of it, is not available
├── FileError                a local file cannot be used
├── PortTakenError           a server of this library cannot listen on its port
├── ScriptFailedError        a script did not compile, or failed while running
├── ProgramNotRunningError   the robot's control program is not connected to the driver
├── ProgramEndedError        the control program ended during an operation
├── ProgramStaysError        the control program did not end when it was stopped
├── PlanningError            no path was found; the message says why
│   ├── SceneError           a planning scene, or its file, is invalid
│   └── PathBlockedError     an obstacle appeared on the path while the arm was following it
├── StateError               a state of the robot contains values that no arm has
├── StaleStateError          the newest state of the robot is too old to act on
├── ControllerError          a controller, or a change of controllers, is not possible
│   └── GoalRejectedError    a controller rejected a goal
├── ManagerError             a running controller manager is unreachable, or cannot carry out a request
│   └── NoManagerError       no controller manager is running for this robot
└── MotionError              the arm did not carry out a motion
    ├── OutOfReachError      a target beyond the joint limits, or without an inverse kinematics solution
    ├── MotionStoppedError   the motion was stopped
    ├── LateSetpointError    the robot stopped the arm because a setpoint came too late
    └── SafetyStopError      the robot stopped the arm for safety
        └── ProtectiveStopError

urproto.errors.RobotRefused           the robot understood the request and refused it
urproto.errors.RemoteProtocolError    the peer does not speak this protocol
urproto.errors.LocalProtocolError     the caller passed values that the protocol cannot carry
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from urproto.errors import URError
from urproto.extras import how_to_install
from urproto.modes import SafetyMode
from urproto.primary.messages import ErrorCodeMessage


class ClientError(URError):
    """Base class of the client's own exceptions."""


class RobotUnreachableError(ClientError):
    """There is no connection to ``host``:``port``; ``reason`` says why."""

    def __init__(
        self,
        host: str,
        port: int,
        reason: str,
        advice: str = "check the address, and that the controller is up and offers this port",
    ) -> None:
        super().__init__(f"no connection to {host}:{port} ({reason}): {advice}")
        self.host = host
        self.port = port
        self.reason = reason


class ConnectionLostError(ClientError):
    """The connection to ``host``:``port`` was closed; connect again to continue."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"{host}:{port} closed the connection: connect again to continue")
        self.host = host
        self.port = port


class NoAnswerError(ClientError):
    """An expected message, or any message at all, did not arrive from ``host``:``port`` within ``timeout_s`` [s]."""

    def __init__(self, host: str, port: int, timeout_s: float, what: str = "nothing") -> None:
        sent = "sent nothing" if what == "nothing" else f"has not sent {what}"
        super().__init__(f"{host}:{port} {sent} for {timeout_s:g} s: it may be busy, or speak another protocol")
        self.host = host
        self.port = port
        self.timeout_s = timeout_s


class WaitTimeoutError(ClientError, TimeoutError):
    """An awaited event did not happen within the caller's timeout. Any motion under way continues."""


class CameraError(ClientError):
    """The camera does not exist, or delivers no picture."""


class GripperError(ClientError):
    """The gripper at ``host``:``port`` does not answer its controller, or cannot carry out a command."""

    def __init__(self, host: str, port: int, why: str, advice: str) -> None:
        super().__init__(f"the gripper at {host}:{port} {why}: {advice}")
        self.host = host
        self.port = port


class DeviceError(ClientError):
    """The serial device ``path`` could not be created on this machine."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"cannot create the device {path} ({reason}): choose another path, in a writable folder")
        self.path = path
        self.reason = reason


class RecordingError(ClientError):
    """A recording cannot be read or written, or lacks the requested data."""


class MissingExtraError(RecordingError):
    """``what`` needs packages that are not installed; this project's ``extra`` installs them."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs packages that are not installed: {how_to_install(extra)}")
        self.extra = extra


class PortTakenError(ClientError):
    """A server of this library cannot listen on ``host``:``port``."""

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(f"cannot listen on {host} port {port}: {reason}; choose another --port, or --host")
        self.host = host
        self.port = port


class Ros2Error(ClientError):
    """ROS 2, or one of its packages, is not available, or rejected its arguments."""


class FileError(ClientError):
    """The file at ``path`` cannot be read or written, or has the wrong content."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason

    @classmethod
    @contextmanager
    def accessing(cls, path: Path) -> Iterator[None]:
        """Raise an OSError from the block as an error of this class."""
        try:
            yield
        except OSError as error:
            raise cls(path, error.strerror or str(error)) from error


class ScriptFailedError(ClientError):
    """The program ``name`` did not compile, failed, or was stopped before its end.

    line, column: position in the script, counted from 1; 0 when the error has no position. errors: the error codes
    that the robot reported while the program ran (messages of urproto.primary).
    """

    def __init__(
        self, line: int, column: int, text: str, name: str = "", errors: tuple[ErrorCodeMessage, ...] = ()
    ) -> None:
        place = f"{name or 'script'} line {line}, column {column}" if line else f"program {name}"
        super().__init__(f"{place}: {text}")
        self.line = line
        self.column = column
        self.text = text
        self.name = name
        self.errors = errors


class ProgramNotRunningError(ClientError):
    """No control program is connected to the driver's ``port``."""

    def __init__(self, port: int, hint: str) -> None:
        super().__init__(f"no control program is connected to port {port}: {hint}")
        self.port = port
        self.hint = hint


class ProgramEndedError(ClientError):
    """The control program disconnected from the driver's ``port`` during ``operation``; ``why`` is the known cause."""

    def __init__(
        self,
        port: int,
        operation: str,
        why: str = "the robot's log says why",
        advice: str = "start the program again",
    ) -> None:
        super().__init__(f"the control program left port {port} during {operation}: {why}; {advice}")
        self.port = port
        self.operation = operation
        self.why = why


class ProgramStaysError(ClientError):
    """The control program is still connected to the driver's ``port``, ``waited_s`` [s] after it was stopped."""

    def __init__(self, port: int, waited_s: float) -> None:
        super().__init__(
            f"the control program has not left port {port} within {waited_s:g} s: it may be paused, or the robot "
            "frozen; stop it on the pendant, then start it again"
        )
        self.port = port
        self.waited_s = waited_s


class StateError(ClientError):
    """The RTDE variable ``field`` of a received state is invalid: ``why``."""

    def __init__(self, field: str, why: str) -> None:
        super().__init__(f"a state of the robot cannot be used: {field} {why}")
        self.field = field
        self.why = why


class StaleStateError(ClientError):
    """The newest state of the robot at ``host`` may be ``age_s`` [s] old, which is more than ``max_age_s`` allows."""

    def __init__(self, host: str, age_s: float, max_age_s: float, why: str = "") -> None:
        advice = why or (
            f"find out what delays its states (ur-client doctor {host}), or permit older ones: "
            "Robot(host, max_age_s=...)"
        )
        super().__init__(
            f"the newest state of {host} may be {age_s:.2f} s old, and max_age_s is {max_age_s:g} s: {advice}"
        )
        self.host = host
        self.age_s = age_s
        self.max_age_s = max_age_s


class ControllerError(ClientError):
    """A request to ``controller`` (a name, or the file that describes it) is not possible: ``reason``."""

    def __init__(self, controller: str, reason: str) -> None:
        super().__init__(f"{controller}: {reason}")
        self.controller = controller
        self.reason = reason


class GoalRejectedError(ControllerError):
    """``controller`` rejected a goal; ``code`` is one of client.controllers.goals.ErrorCode."""

    def __init__(self, controller: str, code: int, reason: str) -> None:
        super().__init__(controller, reason)
        self.code = code


class ManagerError(ClientError):
    """A running controller manager is unreachable, or cannot carry out a request."""


class NoManagerError(ManagerError):
    """No controller manager is running for the robot at ``host``."""

    def __init__(self, host: str) -> None:
        super().__init__(
            f"no controller manager is running for {host}: start one in another terminal with "
            f"`ur-client controllers serve --robot-ip {host}`"
        )
        self.host = host


class MotionError(ClientError):
    """The motion ``operation`` was not carried out; ``why`` is the reason."""

    def __init__(self, operation: str, why: str) -> None:
        super().__init__(f"{operation} was not carried out: {why}")
        self.operation = operation
        self.why = why


class OutOfReachError(MotionError):
    """The arm cannot reach a target.

    point: index of the target within ``operation``, from 0; None when the robot reported the error without an index.
    """

    def __init__(self, operation: str, why: str, point: int | None = None) -> None:
        super().__init__(operation, why)
        self.point = point


class MotionStoppedError(MotionError):
    """The motion was stopped before its end. The control program still runs and accepts the next motion."""


class LateSetpointError(MotionError):
    """The next setpoint came too late, so the robot stopped the arm. The control program still runs."""

    def __init__(self, operation: str, why: str) -> None:
        super().__init__(
            operation,
            f"{why}. The arm is at rest and the program continues. Find out what keeps this machine busy "
            "(ur-client doctor), and allow real-time priority",
        )
        self.late = why


class SafetyStopError(MotionError):
    """The robot stopped for safety. ``mode``: its safety mode; ``cause``: what it reports, empty if it reports none."""

    def __init__(self, operation: str, mode: SafetyMode, cause: str, advice: str) -> None:
        super().__init__(operation, f"{mode.name}, {cause or 'the robot reports no cause'}: {advice}")
        self.mode = mode
        self.cause = cause


class ProtectiveStopError(SafetyStopError):
    """The robot is in a protective stop; see `client.AsyncRobot.recover`."""


class PlanningError(ClientError):
    """No path was found; the message says why."""


class PathBlockedError(PlanningError):
    """An obstacle appeared on the path while the arm was following it; the arm is at rest. The message names it."""


class SceneError(PlanningError):
    """A planning scene is invalid."""


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Guard the imports of an extra. Raises MissingExtraError if one of its packages is not installed.

    what: the feature that needs them, for the message.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(what, name) from error
