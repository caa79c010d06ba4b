"""The dashboard of a robot: power, brakes, programs, popups, modes.

    async with DashboardClient("192.168.56.101") as dashboard:
        await dashboard.ask(POWER_ON)
        mode = await dashboard.ask(ROBOT_MODE)

    with BlockingDashboardClient("192.168.56.101") as dashboard:
        dashboard.ask(load("pick.urp"))

What can be asked is an Operation: a line and how to read the answer. An answer that is not
the one of success is a RobotRefused.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Flow
from urproto import dashboard as wire
from urproto.errors import LocalProtocolError, RemoteProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.versions import PolyscopeVersion

__all__ = [
    "BRAKE_RELEASE",
    "CLOSE_POPUP",
    "CLOSE_SAFETY_POPUP",
    "IS_IN_REMOTE_CONTROL",
    "IS_RUNNING",
    "LOADED_PROGRAM",
    "PAUSE",
    "PLAY",
    "POLYSCOPE_VERSION",
    "PORT",
    "POWER_OFF",
    "POWER_ON",
    "PROGRAM_STATE",
    "RESTART_SAFETY",
    "ROBOT_MODE",
    "ROBOT_MODEL",
    "SAFETY_MODE",
    "SAFETY_STATUS",
    "SERIAL_NUMBER",
    "STOP",
    "UNLOCK_PROTECTIVE_STOP",
    "BlockingDashboardClient",
    "DashboardClient",
    "DashboardCore",
    "Operation",
    "add_to_log",
    "command",
    "load",
    "popup",
]

PORT = 29999

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Operation(Generic[Answer]):
    """A line to send and how to read its answer; ``read`` may raise RemoteProtocolError."""

    line: str
    read: Callable[[str], Answer]

    def answer(self, reply: str) -> Answer:
        """What the reply says; RobotRefused when it is not an answer of success."""
        try:
            return self.read(reply)
        except RemoteProtocolError as error:
            raise RobotRefused(self.line, reply) from error


def _expect(beginning: str) -> Callable[[str], None]:
    def read(reply: str) -> None:
        if not reply.startswith(beginning):
            raise RemoteProtocolError(f"{reply!r} does not begin with {beginning!r}")

    return read


def _number(reply: str) -> str:
    if not reply.isdigit():
        raise RemoteProtocolError(f"{reply!r} is not a serial number")
    return reply


def _model(reply: str) -> str:
    if not reply.startswith("UR"):
        raise RemoteProtocolError(f"{reply!r} is not a robot model")
    return reply


POWER_ON = Operation("power on", _expect(wire.POWERING_ON))
POWER_OFF = Operation("power off", _expect(wire.POWERING_OFF))
BRAKE_RELEASE = Operation("brake release", _expect(wire.BRAKE_RELEASING))
PLAY = Operation("play", _expect(wire.STARTING))
PAUSE = Operation("pause", _expect(wire.PAUSING))
STOP = Operation("stop", _expect(wire.STOPPED))
CLOSE_POPUP = Operation("close popup", _expect(wire.CLOSING_POPUP))
CLOSE_SAFETY_POPUP = Operation("close safety popup", _expect(wire.CLOSING_SAFETY_POPUP))
UNLOCK_PROTECTIVE_STOP = Operation("unlock protective stop", _expect(wire.UNLOCKING))
RESTART_SAFETY = Operation("restart safety", _expect(wire.RESTARTING_SAFETY))
ROBOT_MODE: Operation[RobotMode] = Operation("robotmode", wire.parse_robot_mode)
SAFETY_MODE: Operation[SafetyMode] = Operation("safetymode", wire.parse_safety_mode)
SAFETY_STATUS: Operation[SafetyStatus] = Operation("safetystatus", wire.parse_safety_status)
PROGRAM_STATE: Operation[tuple[wire.ProgramState, str | None]] = Operation("programState", wire.parse_program_state)
LOADED_PROGRAM: Operation[str | None] = Operation("get loaded program", wire.parse_loaded_program)
IS_RUNNING: Operation[bool] = Operation("running", wire.parse_boolean)
IS_IN_REMOTE_CONTROL: Operation[bool] = Operation("is in remote control", wire.parse_boolean)
POLYSCOPE_VERSION: Operation[PolyscopeVersion] = Operation("PolyscopeVersion", wire.parse_polyscope_version)
SERIAL_NUMBER: Operation[str] = Operation("get serial number", _number)
ROBOT_MODEL: Operation[str] = Operation("get robot model", _model)


def load(program: str) -> Operation[None]:
    """Load a program by its name below the controller's program folder."""
    return Operation(f"load {program}", _expect("Loading program"))


def popup(text: str) -> Operation[None]:
    """Show a popup on the teach pendant."""
    return Operation(f"popup {text}", _expect(wire.SHOWING_POPUP))


def add_to_log(text: str) -> Operation[None]:
    """Write a line into the controller's log."""
    return Operation(f"addToLog {text}", _expect(wire.LOG_ADDED))


def command(line: str) -> Operation[str]:
    """Any line; the answer is whatever the robot says."""
    return Operation(line, str)


class DashboardCore:
    """One side of a dashboard conversation, without I/O."""

    def __init__(self) -> None:
        self._lines = wire.LineDecoder()
        self._received: list[str] = []
        self._unanswered = 0  # commands sent: more than one only after one timed out

    def greet(self) -> Flow[None]:
        """Wait for the greeting; RemoteProtocolError when it is another one."""
        greeting = yield from self._next_line()
        if greeting != wire.GREETING:
            raise RemoteProtocolError(f"this is no dashboard server, it says {greeting!r}")

    def ask(self, operation: Operation[Answer]) -> Flow[Answer]:
        """Send an operation's line and read its answer."""
        if "\n" in operation.line or "\r" in operation.line:
            raise LocalProtocolError(f"a dashboard command is one line, this is not: {operation.line!r}")
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
    """The dashboard, for asyncio programs. Connects, and checks the greeting, on entering."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._core = DashboardCore()
        self._one_at_a_time = asyncio.Lock()

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        try:
            await self.run(self._core.greet())
        except BaseException:
            await self.close()
            raise
        return self

    async def ask(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Do one operation; RobotRefused when the robot says no."""
        async with self._one_at_a_time:
            return await self.run(self._core.ask(operation), timeout_s)


class BlockingDashboardClient(BlockingConnection):
    """The dashboard, for scripts and notebooks."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._core = DashboardCore()

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            self.run(self._core.greet())
        except BaseException:
            self.close()
            raise
        return self

    def ask(self, operation: Operation[Answer], timeout_s: float | None = None) -> Answer:
        """Do one operation; RobotRefused when the robot says no."""
        return self.run(self._core.ask(operation), timeout_s)
