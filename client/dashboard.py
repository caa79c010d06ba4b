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
from client.quantities import checked
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
    """The client's side of a dashboard connection, without I/O.

    version: the controller's, known after the first operation that not every version has.
    """

    def __init__(self) -> None:
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
        if not operation.in_every_version:
            if self.version is None:
                self.version = yield from self._exchange(POLYSCOPE_VERSION)
            operation.check(self.version)
        return (yield from self._exchange(operation))

    def read_pending(self) -> Flow[None]:
        """Read what has arrived meanwhile, without sending anything."""
        while data := (yield POLL):
            self._received += self._lines.feed(data)

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
class DashboardClient(AsyncConnection):
    """Dashboard client for asyncio programs; use it with ``async with``, which connects and checks the greeting.

    If the robot has no dashboard server but the Robot API of PolyScope X answers, that is used instead. Its port is
    ``robot_api_port``; by default it has the same offset from port 80 as ``port`` has from the dashboard's.
    """

    def __init__(
        self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S, robot_api_port: int | None = None
    ) -> None:
        super().__init__(host, port, timeout_s)
        self._robot_api_port = _robot_api_port(port) if robot_api_port is None else robot_api_port
        self._core: DashboardCore | DashboardOnX = DashboardCore()
        self._lock = asyncio.Lock()

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
        wanted, self.port = self.port, self._robot_api_port
        self._core = DashboardOnX(self.host, self.port)
        try:
            return await super().__aenter__()
        except (ClientError, RemoteProtocolError):
            self.port, self._core = wanted, DashboardCore()
            raise missing from None

    def _opening(self) -> Flow[None]:
        return self._core.opening()


@checked
class BlockingDashboardClient(BlockingConnection):
    """Blocking counterpart of `DashboardClient`, for scripts and notebooks."""

    def __init__(
        self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S, robot_api_port: int | None = None
    ) -> None:
        super().__init__(host, port, timeout_s)
        self._robot_api_port = _robot_api_port(port) if robot_api_port is None else robot_api_port
        self._core: DashboardCore | DashboardOnX = DashboardCore()

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
        wanted, self.port = self.port, self._robot_api_port
        self._core = DashboardOnX(self.host, self.port)
        try:
            return super().__enter__()
        except (ClientError, RemoteProtocolError):
            self.port, self._core = wanted, DashboardCore()
            raise missing from None

    def check(self) -> None:
        """Raise ConnectionLostError if the robot has closed the connection meanwhile; sends nothing."""
        self.run(self._core.read_pending())

    def _opening(self) -> Flow[None]:
        return self._core.opening()
