"""What can go wrong while talking to a robot.

Every one of these is a `URError`, and so are those of urproto.errors below: `except URError` catches whatever a call
of the client raises for a reason that it knows.

ClientError
├── RobotUnreachableError    no connection came about
├── ConnectionLostError      the robot closed it, or the network did
├── NoAnswerError            the robot keeps silent
├── WaitTimeoutError         what was waited for has not happened yet; a TimeoutError too
├── CameraError              there is no such camera, or no picture of it
├── DeviceError              a device of this machine cannot be made
├── RecordingError           a file of a recording cannot be read, written, or used for this
│   └── MissingExtraError    a package it needs is not installed
├── Ros2Error                ROS 2, or a package of it that is needed, is not there
├── FileError                a file of this machine cannot be used
├── ScriptFailedError        a script did not compile or failed while running
├── ProgramNotRunningError   the robot's control program is not connected to the driver
├── ProgramEndedError        it ended while something was under way
├── ProgramStaysError        it was told to end, and does not
├── PlanningError            no way was found, for a reason that it tells
│   ├── SceneError           a planning scene, or a file of one, that cannot be
│   └── WayBlockedError      something has come into the way that the arm was on
├── StateError               a state of the robot holds numbers that no arm has
├── ControllerError          a controller, or a change of controllers, that cannot be had
│   └── GoalRejectedError    a controller does not take a goal
├── ManagerError             a running controller manager cannot be talked to, or cannot do what it is asked
│   └── NoManagerError       none runs for this robot
└── MotionError              the arm did not do what it was asked to
    ├── OutOfReachError      a target beyond the joints' limits, or without joint angles
    ├── MotionStoppedError   somebody stopped the arm
    ├── LateSetpointError    the robot did, since this machine was late
    └── SafetyStopError      the robot did, for safety
        └── ProtectiveStopError

urproto.errors.RobotRefused           the robot understood and said no
urproto.errors.RemoteProtocolError    the peer does not speak this protocol
urproto.errors.LocalProtocolError     we were asked to send what the protocol cannot carry
"""

from pathlib import Path

from urproto.errors import URError
from urproto.modes import SafetyMode
from urproto.primary.messages import ErrorCodeMessage


class ClientError(URError):
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
    """What was due, or anything, did not come from ``host``:``port`` for ``timeout_s`` seconds."""

    def __init__(self, host: str, port: int, timeout_s: float, what: str = "nothing") -> None:
        sent = "sent nothing" if what == "nothing" else f"has not sent {what}"
        super().__init__(f"{host}:{port} {sent} for {timeout_s:g} s: it may be busy, or speak something else")
        self.host = host
        self.port = port
        self.timeout_s = timeout_s


class WaitTimeoutError(ClientError, TimeoutError):
    """What a caller waits for has not happened in the time that the caller gave; whatever is under way goes on."""


class CameraError(ClientError):
    """There is no such camera, or no picture of it."""


class DeviceError(ClientError):
    """The serial device ``path`` cannot be made on this machine."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"cannot make the device {path} ({reason}): choose another path, in a folder you may write to")
        self.path = path
        self.reason = reason


class RecordingError(ClientError):
    """A recording cannot be read or written, or does not have what is asked of it."""


class MissingExtraError(RecordingError):
    """``what`` needs packages that are not installed; the ``extra`` of this project brings them."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(
            f"{what} needs packages that are not installed: in the folder of ur-emulator, pip install '.[{extra}]'"
        )
        self.extra = extra


class PortTakenError(ClientError):
    """A server of ours cannot have its port."""

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(f"cannot listen on {host} port {port}: {reason}; choose another --port, or --host")
        self.host = host
        self.port = port


class Ros2Error(ClientError):
    """ROS 2, or a package of it, is not there, or does not accept what it was given."""


class FileError(ClientError):
    """The file at ``path`` cannot be read or written, or is not what it should be."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


class ScriptFailedError(ClientError):
    """The program ``name`` did not compile, failed, or did not end as it should.

    line, column: where in the script, from 1; 0 when the error has no place. errors: the
    error codes that came while it ran, messages of urproto.primary.
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
    """The control program left the driver's ``port`` while ``doing`` was under way; ``why``, if that is known."""

    def __init__(
        self,
        port: int,
        doing: str,
        why: str = "the robot's log says why",
        advice: str = "start the program again",
    ) -> None:
        super().__init__(f"the control program left port {port} during {doing}: {why}; {advice}")
        self.port = port
        self.doing = doing
        self.why = why


class ProgramStaysError(ClientError):
    """The control program is still connected to the driver's ``port`` ``waited_s`` after it was told to end [s]."""

    def __init__(self, port: int, waited_s: float) -> None:
        super().__init__(
            f"the control program has not left port {port} within {waited_s:g} s: it may be paused, or the robot "
            "frozen; stop it on the pendant, then start it again"
        )
        self.port = port
        self.waited_s = waited_s


class StateError(ClientError):
    """The RTDE variable ``field`` of a state cannot be used: ``why``."""

    def __init__(self, field: str, why: str) -> None:
        super().__init__(f"a state of the robot cannot be used: {field} {why}")
        self.field = field
        self.why = why


class ControllerError(ClientError):
    """What ``controller`` (a name, or the file that describes it) is asked for cannot be had: ``reason``."""

    def __init__(self, controller: str, reason: str) -> None:
        super().__init__(f"{controller}: {reason}")
        self.controller = controller
        self.reason = reason


class GoalRejectedError(ControllerError):
    """``controller`` does not take a goal; ``code`` is one of client.controllers.goals.ErrorCode."""

    def __init__(self, controller: str, code: int, reason: str) -> None:
        super().__init__(controller, reason)
        self.code = code


class ManagerError(ClientError):
    """A running controller manager cannot be talked to, or cannot do what it is asked."""


class NoManagerError(ManagerError):
    """No controller manager runs for the robot at ``host``."""

    def __init__(self, host: str) -> None:
        super().__init__(
            f"no controller manager is running for {host}: start one in another terminal with "
            f"`ur-client controllers serve --robot-ip {host}`"
        )
        self.host = host


class MotionError(ClientError):
    """``doing`` was not carried out, and ``why``."""

    def __init__(self, doing: str, why: str) -> None:
        super().__init__(f"{doing} was not carried out: {why}")
        self.doing = doing
        self.why = why


class OutOfReachError(MotionError):
    """The arm cannot get to a target.

    point: which one of ``doing``, from 0; None when the robot said so and not which.
    """

    def __init__(self, doing: str, why: str, point: int | None = None) -> None:
        super().__init__(doing, why)
        self.point = point


class MotionStoppedError(MotionError):
    """Somebody stopped the arm on the way; the program still runs, the next motion may follow."""


class LateSetpointError(MotionError):
    """The next setpoint came too late, so the robot has stopped the arm; the program still runs."""

    def __init__(self, doing: str, why: str) -> None:
        super().__init__(
            doing,
            f"{why}. The arm is at rest and the program goes on. Look for what keeps this machine busy "
            "(ur-client doctor), and allow real-time priority",
        )
        self.late = why


class SafetyStopError(MotionError):
    """The robot has stopped for safety: its ``mode``, and the ``cause`` it reports, empty when it reports none."""

    def __init__(self, doing: str, mode: SafetyMode, cause: str, advice: str) -> None:
        super().__init__(doing, f"{mode.name}, {cause or 'the robot does not say why'}: {advice}")
        self.mode = mode
        self.cause = cause


class ProtectiveStopError(SafetyStopError):
    """A protective stop."""


class PlanningError(ClientError):
    """No way was found; the text says why."""


class WayBlockedError(PlanningError):
    """Something has come into the way that the arm was on; it stands now. The text says what."""


class SceneError(PlanningError):
    """A planning scene that cannot be."""
