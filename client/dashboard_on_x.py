"""Dashboard commands on PolyScope X, carried out through the Robot API: the same command lines, the same answers.

Callers need not know which of the two a robot has. Commands that the API lacks are refused.
"""

from collections.abc import Callable
from typing import Any, Final, TypeVar

from client import robotapi
from client.connection import Flow
from client.dashboard_commands import Operation
from client.robotapi import ApiRequest, RobotApiCore
from urproto import dashboard as replies
from urproto.dashboard import ProgramState
from urproto.errors import RobotRefused

Answer = TypeVar("Answer")

NOT_ON_POLYSCOPE_X: Final = "the Robot API of PolyScope X does not have it"
_FOLDER: Final = "/programs/"
_SUFFIX: Final = ".urpx"
_LOAD: Final = "load "

# line in lower case -> the request, and the answer of a dashboard
_CONFIRMED: Final[dict[str, tuple[ApiRequest[None], str]]] = {
    "power on": (robotapi.POWER_ON, replies.POWERING_ON),
    "power off": (robotapi.POWER_OFF, replies.POWERING_OFF),
    "brake release": (robotapi.BRAKE_RELEASE, replies.BRAKE_RELEASING),
    "unlock protective stop": (robotapi.UNLOCK_PROTECTIVE_STOP, replies.UNLOCKING),
    "restart safety": (robotapi.RESTART_SAFETY, replies.RESTARTING_SAFETY),
    "pause": (robotapi.PAUSE, replies.PAUSING),
    "stop": (robotapi.STOP, replies.STOPPED),
}
_QUERIES: Final[dict[str, tuple[ApiRequest[Any], Callable[[Any], str]]]] = {
    "robotmode": (robotapi.ROBOT_MODE, lambda mode: f"Robotmode: {mode.name}"),
    "safetymode": (robotapi.SAFETY_MODE, lambda mode: f"Safetymode: {mode.name}"),
    "running": (robotapi.PROGRAM_STATE, lambda state: f"Program running: {str(state is ProgramState.PLAYING).lower()}"),
    "get loaded program": (robotapi.LOADED_PROGRAM, lambda name: f"Loaded program: {name}"),
    "is in remote control": (robotapi.IS_IN_REMOTE_CONTROL, lambda remote: str(remote).lower()),
    "get operational mode": (robotapi.OPERATIONAL_MODE, lambda mode: mode.name),
}


class DashboardOnX:
    """The counterpart of `client.dashboard.DashboardCore` over the Robot API, without I/O."""

    def __init__(self, host: str, port: int) -> None:
        self._api = RobotApiCore(host, port)

    def opening(self) -> Flow[None]:
        """Check that this is a Robot API. Raises RemoteProtocolError if it is not."""
        return self._api.opening()

    def request(self, operation: Operation[Answer]) -> Flow[Answer]:
        """Carry out an operation, and read the answer that a dashboard would give."""
        reply = yield from self._answer(operation.line.strip())
        return operation.answer(reply)

    def read_pending(self) -> Flow[None]:
        """Do nothing: between requests nothing arrives."""
        yield from ()

    def _answer(self, line: str) -> Flow[str]:
        key = line.lower()
        if key in _CONFIRMED:
            request, confirmation = _CONFIRMED[key]
            yield from self._api.request(request)
            return confirmation
        if key in _QUERIES:
            query, shown = _QUERIES[key]
            return shown((yield from self._api.request(query)))
        if key.startswith(_LOAD):
            name = line[len(_LOAD) :].strip().removeprefix(_FOLDER).removesuffix(_SUFFIX)
            yield from self._api.request(robotapi.load(name))
            return f"Loading program: {name}"
        if key == "play":
            return (yield from self._play())
        if key == "programstate":
            state = yield from self._api.request(robotapi.PROGRAM_STATE)
            return f"{state.value} {(yield from self._api.request(robotapi.LOADED_PROGRAM))}"
        if key == "quit":
            return replies.DISCONNECTED
        raise RobotRefused(line, NOT_ON_POLYSCOPE_X, "send URScript, or do without it")

    def _play(self) -> Flow[str]:
        """Start the program, or resume it if it is paused, like the dashboard's play."""
        state = yield from self._api.request(robotapi.PROGRAM_STATE)
        yield from self._api.request(robotapi.RESUME if state is ProgramState.PAUSED else robotapi.PLAY)
        return replies.STARTING
