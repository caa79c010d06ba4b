"""What can go wrong between two ends of a protocol.

URError                       base of whatever this project raises about a robot
├── ProtocolError
│   ├── LocalProtocolError    we were asked to send something the protocol does not allow
│   └── RemoteProtocolError   the peer sent bytes that are not this protocol
├── RobotRefused              the protocol was followed and the robot said no
├── client.ClientError        what a driver or another client raises itself
└── robots.CalibrationError   no calibration, or one of another arm
"""


class URError(Exception):
    """Base of whatever this project raises about a robot: catch it where the reason makes no difference."""


class ProtocolError(URError):
    """Base of both kinds of protocol violation."""


class LocalProtocolError(ProtocolError):
    """The caller asked for a message that the protocol cannot carry."""


class RemoteProtocolError(ProtocolError):
    """The peer sent bytes that do not parse as this protocol."""


class RobotRefused(URError):  # noqa: N818 - it is no error of ours, and design and docs call it so
    """The robot understood the request and refused it (mode, safety, remote control).

    advice: what to do about it, empty when nobody knows.
    """

    def __init__(self, request: str, answer: str, advice: str = "") -> None:
        super().__init__(f"the robot refused {request!r}: {answer}" + (f" - {advice}" if advice else ""))
        self.request = request
        self.answer = answer
        self.advice = advice
