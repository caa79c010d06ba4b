"""Client for a robot's dashboard server: power, brakes, programs, popups, modes.

    async with DashboardClient("192.168.56.101") as dashboard:
        await dashboard.request(POWER_ON)
        mode = await dashboard.request(ROBOT_MODE)

    with BlockingDashboardClient("192.168.56.101") as dashboard:
        dashboard.request(load("pick.urp"))

An Operation is a command line and how to read its answer; client.dashboard_commands defines all of them. `request`
raises RobotRefused if the answer does not report success. It also does so for a command that the controller's version
does not have, without sending it.
"""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Final

from client import robotapi
from client.connection import (
    DEFAULT_TIMEOUT_S,
    POLL,
    AsyncConnection,
    BlockingConnection,
    Connection,
    Flow,
    Reconnect,
)
from client.dashboard_commands import *  # noqa: F403 - the operations, which callers pass to `request`
from client.dashboard_commands import POLYSCOPE_VERSION, Answer, Operation
from client.errors import ClientError, ConnectionLostError, RobotUnreachableError
from client.quantities import checked
from client.robotapi import ApiRequest, RobotApiCore
from urproto import dashboard as wire
from urproto.compat import Self
from urproto.dashboard import ProgramState
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.versions import PolyscopeVersion

PORT = 29999
NOT_ON_POLYSCOPE_X: Final = "the Robot API of PolyScope X does not have it"
_FOLDER: Final = "/programs/"
_SUFFIX: Final = ".urpx"
_LOAD: Final = "load "

# line in lower case -> the request, and the answer of a dashboard
_CONFIRMED: Final[dict[str, tuple[ApiRequest[None], str]]] = {
    "power on": (robotapi.POWER_ON, wire.POWERING_ON),
    "power off": (robotapi.POWER_OFF, wire.POWERING_OFF),
    "brake release": (robotapi.BRAKE_RELEASE, wire.BRAKE_RELEASING),
    "unlock protective stop": (robotapi.UNLOCK_PROTECTIVE_STOP, wire.UNLOCKING),
    "restart safety": (robotapi.RESTART_SAFETY, wire.RESTARTING_SAFETY),
    "pause": (robotapi.PAUSE, wire.PAUSING),
    "stop": (robotapi.STOP, wire.STOPPED),
}
_QUERIES: Final[dict[str, tuple[ApiRequest[Any], Callable[[Any], str]]]] = {
    "robotmode": (robotapi.ROBOT_MODE, lambda mode: f"Robotmode: {mode.name}"),
    "safetymode": (robotapi.SAFETY_MODE, lambda mode: f"Safetymode: {mode.name}"),
    "running": (robotapi.PROGRAM_STATE, lambda state: f"Program running: {str(state is ProgramState.PLAYING).lower()}"),
    "get loaded program": (robotapi.LOADED_PROGRAM, lambda name: f"Loaded program: {name}"),
    "is in remote control": (robotapi.IS_IN_REMOTE_CONTROL, lambda remote: str(remote).lower()),
    "get operational mode": (robotapi.OPERATIONAL_MODE, lambda mode: mode.name),
}


class DashboardCore:
    """The client's side of a dashboard connection, without I/O.

    reconnect_s: how long to try to open a new connection [s], before a request, if the last one was lost or left
    unanswered; 0 disables it. version: the controller's, known after the first operation that not every version has.
    """

    def __init__(self, reconnect_s: float = 0.0) -> None:
        self._reconnect_s = reconnect_s
        self._reset()

    def _reset(self) -> None:
        """Reset the state of the last connection."""
        self.version: PolyscopeVersion | None = None
        self._lines = wire.LineDecoder()
        self._received: list[str] = []
        self._unanswered = 0  # commands sent without an answer; more than one only after a timeout

    def opening(self) -> Flow[None]:
        """Wait for the greeting of a new connection. Raises RemoteProtocolError for any other text."""
        self._reset()
        greeting = yield from self._next_line()
        if greeting != wire.GREETING:
            raise RemoteProtocolError(f"this is not a dashboard server: its greeting is {greeting!r}")

    def request(self, operation: Operation[Answer]) -> Flow[Answer]:
        """Send an operation's line and read its answer."""
        if "\n" in operation.line or "\r" in operation.line:
            raise LocalProtocolError(f"a dashboard command is one line, this is not: {operation.line!r}")
        yield from self._ensure_connection()
        if not operation.in_every_version:
            if self.version is None:
                self.version = yield from self._exchange(POLYSCOPE_VERSION)
            operation.check(self.version)
        return (yield from self._exchange(operation))

    def read_pending(self) -> Flow[None]:
        """Read what has arrived meanwhile, without sending anything."""
        while data := (yield POLL):
            self._received += self._lines.feed(data)

    def _ensure_connection(self) -> Flow[None]:
        """Replace a connection that was lost. Nothing has been sent yet, so nothing is carried out twice."""
        if not self._reconnect_s:
            return
        try:
            yield from self.read_pending()
            lost = self._unanswered > len(self._received)
        except ConnectionLostError:
            lost = True
        if lost:
            yield Reconnect(self._reconnect_s)
            yield from self.opening()

    def _exchange(self, operation: Operation[Answer]) -> Flow[Answer]:
        yield from self.read_pending()
        # answers to commands that timed out, and unsolicited lines, are not the answer to this command
        self._unanswered = max(0, self._unanswered - len(self._received))
        self._received.clear()
        yield wire.encode_line(operation.line)
        self._unanswered += 1
        while True:
            reply = yield from self._next_line()
            self._unanswered -= 1
            if not self._unanswered:
                return operation.answer(reply)

    def _next_line(self) -> Flow[str]:
        while not self._received:
            self._received += self._lines.feed((yield None))
        return self._received.pop(0)


@checked
class _Dashboard(Connection):
    """Common part of the asynchronous and the blocking client."""

    def __init__(
        self,
        host: str,
        port: int = PORT,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        robot_api_port: int | None = None,
        reconnect_s: float = 0.0,
    ) -> None:
        super().__init__(host, port, timeout_s)
        self._robot_api_port = robotapi.PORT + port - PORT if robot_api_port is None else robot_api_port
        self._reconnect_s = reconnect_s
        self._core: DashboardCore | DashboardOnX = DashboardCore(reconnect_s)

    def _opening(self) -> Flow[None]:
        return self._core.opening()

    @contextmanager
    def _on_x(self, missing: RobotUnreachableError) -> Iterator[None]:
        """Connect to the Robot API in this block instead. Raises ``missing`` if there is none."""
        wanted, self.port = self.port, self._robot_api_port
        self._core = DashboardOnX(self.host, self.port)
        try:
            yield
        except (ClientError, RemoteProtocolError):
            self.port, self._core = wanted, DashboardCore(self._reconnect_s)
            raise missing from None


@checked
class DashboardClient(_Dashboard, AsyncConnection):
    """Dashboard client for asyncio programs; use it with ``async with``, which connects and checks the greeting.

    If the robot has no dashboard server but the Robot API of PolyScope X answers, that is used instead. Its port is
    ``robot_api_port``; by default it has the same offset from port 80 as ``port`` has from the dashboard's.

    reconnect_s: after a loss, the next request opens a new connection, and tries for this long [s]; 0 disables it.
    """

    @cached_property
    def _lock(self) -> asyncio.Lock:
        return asyncio.Lock()

    async def request(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Carry out one operation and return its answer. Raises RobotRefused if the robot refuses.

        timeout_s: how long the answer may take [s]; None for the operation's own limit.
        """
        async with self._lock:
            return await self.run(self._core.request(operation), timeout_s or operation.timeout_s)

    async def __aenter__(self) -> Self:
        try:
            return await super().__aenter__()
        except RobotUnreachableError as error:
            missing = error
        with self._on_x(missing):
            return await super().__aenter__()


@checked
class BlockingDashboardClient(_Dashboard, BlockingConnection):
    """Blocking counterpart of `DashboardClient`, for scripts and notebooks."""

    def request(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Carry out one operation and return its answer. Raises RobotRefused if the robot refuses.

        timeout_s: how long the answer may take [s]; None for the operation's own limit.
        """
        return self.run(self._core.request(operation), timeout_s or operation.timeout_s)

    def __enter__(self) -> Self:
        try:
            return super().__enter__()
        except RobotUnreachableError as error:
            missing = error
        with self._on_x(missing):
            return super().__enter__()

    def check(self) -> None:
        """Raise ConnectionLostError if the robot has closed the connection meanwhile; sends nothing."""
        self.run(self._core.read_pending())


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
            return wire.DISCONNECTED
        raise RobotRefused(line, NOT_ON_POLYSCOPE_X, "send URScript, or do without it")

    def _play(self) -> Flow[str]:
        """Start the program, or resume it if it is paused, like the dashboard's play."""
        state = yield from self._api.request(robotapi.PROGRAM_STATE)
        yield from self._api.request(robotapi.RESUME if state is ProgramState.PAUSED else robotapi.PLAY)
        return wire.STARTING
