"""Errors of protocols and robots.

URError                       base class of all errors of this project that concern a robot
├── ProtocolError
│   ├── LocalProtocolError    the caller asked to send something that the protocol does not allow
│   └── RemoteProtocolError   the peer sent bytes that are not valid in this protocol
├── RobotRefused              the robot understood a request and refused it
├── controlapi.NotPossible    an emulator cannot carry out a verb; also BadArguments and NoControlError
├── client.ClientError        errors of the driver and other clients
└── robots.CalibrationError   not a calibration, or that of another arm
"""


class URError(Exception):
    """Base class of all errors of this project that concern a robot. Catch it when the reason does not matter."""


class ProtocolError(URError):
    """Base class of both kinds of protocol violation."""


class LocalProtocolError(ProtocolError):
    """The caller asked for a message that the protocol cannot carry."""


class RemoteProtocolError(ProtocolError):
    """The peer sent bytes that do not parse as this protocol."""


class RobotRefused(URError):  # noqa: N818 - not an error of ours; design and docs use this name
    """The robot understood the request and refused it (mode, safety, remote control).

    advice: what to do about it; empty if unknown.
    """

    def __init__(self, request: str, answer: str, advice: str = "") -> None:
        super().__init__(f"the robot refused {request!r}: {answer}" + (f" - {advice}" if advice else ""))
        self.request = request
        self.answer = answer
        self.advice = advice
