"""The dashboard of a robot: power, brakes, programs, popups, modes.

    async with DashboardClient("192.168.56.101") as dashboard:
        await dashboard.ask(POWER_ON)
        mode = await dashboard.ask(ROBOT_MODE)

    with BlockingDashboardClient("192.168.56.101") as dashboard:
        dashboard.ask(load("pick.urp"))

What can be asked is an Operation, all of them in client.dashboard_commands: a line and how to read
the answer. An answer that is not the one of success is a RobotRefused, and so is a command
that the controller's version does not have: that one is not even sent.
"""

import asyncio
from typing import TypeVar

from client import robotapi
from client.connection import DEFAULT_TIMEOUT_S, POLL, AsyncConnection, BlockingConnection, Flow
from client.dashboard_commands import (
    BRAKE_RELEASE,
    CLEAR_OPERATIONAL_MODE,
    CLOSE_POPUP,
    CLOSE_SAFETY_POPUP,
    IS_IN_REMOTE_CONTROL,
    IS_PROGRAM_SAVED,
    IS_RUNNING,
    LOADED_PROGRAM,
    OPERATIONAL_MODE,
    PAUSE,
    PLAY,
    POLYSCOPE_VERSION,
    POWER_OFF,
    POWER_ON,
    PROGRAM_STATE,
    QUIT,
    RESTART_SAFETY,
    ROBOT_MODE,
    ROBOT_MODEL,
    SAFETY_MODE,
    SAFETY_STATUS,
    SAVE_LOG,
    SERIAL_NUMBER,
    SHUTDOWN,
    STOP,
    UNLOCK_PROTECTIVE_STOP,
    USER_ROLE,
    VERSION,
    Operation,
    add_to_log,
    command,
    generate_flight_report,
    generate_support_file,
    load,
    load_installation,
    popup,
    set_operational_mode,
    set_user_role,
)
from client.dashboard_on_x import DashboardOnX
from client.errors import ClientError, RobotUnreachableError
from urproto import dashboard as wire
from urproto.compat import Self
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.versions import PolyscopeVersion

__all__ = [
    "BRAKE_RELEASE",
    "CLEAR_OPERATIONAL_MODE",
    "CLOSE_POPUP",
    "CLOSE_SAFETY_POPUP",
    "IS_IN_REMOTE_CONTROL",
    "IS_PROGRAM_SAVED",
    "IS_RUNNING",
    "LOADED_PROGRAM",
    "OPERATIONAL_MODE",
    "PAUSE",
    "PLAY",
    "POLYSCOPE_VERSION",
    "PORT",
    "POWER_OFF",
    "POWER_ON",
    "PROGRAM_STATE",
    "QUIT",
    "RESTART_SAFETY",
    "ROBOT_MODE",
    "ROBOT_MODEL",
    "SAFETY_MODE",
    "SAFETY_STATUS",
    "SAVE_LOG",
    "SERIAL_NUMBER",
    "SHUTDOWN",
    "STOP",
    "UNLOCK_PROTECTIVE_STOP",
    "USER_ROLE",
    "VERSION",
    "BlockingDashboardClient",
    "DashboardClient",
    "DashboardCore",
    "Operation",
    "add_to_log",
    "command",
    "generate_flight_report",
    "generate_support_file",
    "load",
    "load_installation",
    "popup",
    "set_operational_mode",
    "set_user_role",
]

PORT = 29999

Answer = TypeVar("Answer")


def _robot_api_port(port: int) -> int:
    return robotapi.PORT + port - PORT


class DashboardCore:
    """One side of a dashboard conversation, without I/O.

    version: the controller's, known once an operation that not every version has was asked.
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        """What belonged to the last connection is over."""
        self.version: PolyscopeVersion | None = None
        self._lines = wire.LineDecoder()
        self._received: list[str] = []
        self._unanswered = 0  # commands sent: more than one only after one timed out

    def greet(self) -> Flow[None]:
        """Wait for a new connection's greeting; RemoteProtocolError when it is another one."""
        self._forget()
        greeting = yield from self._next_line()
        if greeting != wire.GREETING:
            raise RemoteProtocolError(f"this is not a dashboard server, it says {greeting!r}")

    def ask(self, operation: Operation[Answer]) -> Flow[Answer]:
        """Send an operation's line and read its answer."""
        if "\n" in operation.line or "\r" in operation.line:
            raise LocalProtocolError(f"a dashboard command is one line, this is not: {operation.line!r}")
        if not operation.in_every_version:
            if self.version is None:
                self.version = yield from self._exchange(POLYSCOPE_VERSION)
            operation.check(self.version)
        return (yield from self._exchange(operation))

    def listen(self) -> Flow[None]:
        """Take what has arrived meanwhile, without sending anything."""
        while data := (yield POLL):
            self._received += self._lines.feed(data)

    def _exchange(self, operation: Operation[Answer]) -> Flow[Answer]:
        yield from self.listen()
        # answers to what timed out, and lines that nobody has asked for: not the answer to this
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


class DashboardClient(AsyncConnection):
    """The dashboard, for asyncio programs. Connects, and checks the greeting, on entering.

    On a robot without one the Robot API of PolyScope X is in its place, if it answers: on ``robot_api_port``, or
    without one as far above port 80 as ``port`` is above the dashboard's.
    """

    def __init__(
        self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S, robot_api_port: int | None = None
    ) -> None:
        super().__init__(host, port, timeout_s)
        self._robot_api_port = _robot_api_port(port) if robot_api_port is None else robot_api_port
        self._core: DashboardCore | DashboardOnX = DashboardCore()
        self._one_at_a_time = asyncio.Lock()

    async def ask(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Do one operation; RobotRefused when the robot says no."""
        async with self._one_at_a_time:
            return await self.run(self._core.ask(operation), timeout_s or operation.timeout_s)

    async def __aenter__(self) -> Self:
        try:
            return await super().__aenter__()
        except RobotUnreachableError as error:
            missing = error
        wanted, self.port = self.port, self._robot_api_port
        self._core = DashboardOnX(self.host, self.port)
        try:
            return await super().__aenter__()
        except (ClientError, RemoteProtocolError):
            self.port, self._core = wanted, DashboardCore()
            raise missing from None

    def _opening(self) -> Flow[None]:
        return self._core.greet()


class BlockingDashboardClient(BlockingConnection):
    """The dashboard, for scripts and notebooks; like `DashboardClient`."""

    def __init__(
        self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S, robot_api_port: int | None = None
    ) -> None:
        super().__init__(host, port, timeout_s)
        self._robot_api_port = _robot_api_port(port) if robot_api_port is None else robot_api_port
        self._core: DashboardCore | DashboardOnX = DashboardCore()

    def ask(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Do one operation; RobotRefused when the robot says no."""
        return self.run(self._core.ask(operation), timeout_s or operation.timeout_s)

    def __enter__(self) -> Self:
        try:
            return super().__enter__()
        except RobotUnreachableError as error:
            missing = error
        wanted, self.port = self.port, self._robot_api_port
        self._core = DashboardOnX(self.host, self.port)
        try:
            return super().__enter__()
        except (ClientError, RemoteProtocolError):
            self.port, self._core = wanted, DashboardCore()
            raise missing from None

    def check(self) -> None:
        """Raise ConnectionLostError when the robot has closed the connection meanwhile; it is not asked anything."""
        self.run(self._core.listen())

    def _opening(self) -> Flow[None]:
        return self._core.greet()
