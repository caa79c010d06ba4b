"""Client for the primary interface: the robot's state and messages, and scripts sent to it.

    with BlockingPrimaryClient("192.168.56.101") as robot:
        robot.run(robot.core.command(POWER_ON))
        result = robot.run(robot.core.execute("movej([0, -1.57, 0, -1.57, 0, 0])\\ntextmsg(1)"))
        print(result.texts, robot.run(robot.core.kinematics_info()))

Every message of the robot passes through ``next_message``, which stores what may be needed later: state, kinematics,
configuration, error codes, texts, dialogues. The other flows use it too, so a message that one flow has read is not
available to the next.
"""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, TypeVar

from client.connection import DEFAULT_TIMEOUT_S, POLL, AsyncConnection, BlockingConnection, Connection, Flow, TimeLimit
from client.errors import NoAnswerError, ScriptFailedError
from client.quantities import checked
from client.scripts import FATAL_LEVELS, MAY_RUN, Script, ScriptResult, ScriptRun, prepare, with_end_message
from urproto.errors import RobotRefused
from urproto.modes import ReportLevel, RobotMode, SafetyMode, mode_name
from urproto.primary.framing import PrimaryDecoder, PrimaryMessage
from urproto.primary.messages import (
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    ErrorCodeMessage,
    KeyMessage,
    PopupMessage,
    RequestValueMessage,
    RuntimeExceptionMessage,
    TextMessage,
    VersionMessage,
)
from urproto.primary.state import RobotStateData
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo, ModeData
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion

_BOOT_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_SOON_S: Final = 5.0
_SAFETY: Final = "check the safety mode, and on e-Series switch to Remote Control and connect again"
_PROGRAM: Final = "on e-Series switch to Remote Control and connect again"
_STANDING: Final = "stop the program and bring the arm to rest first; on e-Series use the switch on the robot's pendant"
PORT = 30001
_MAX_KEPT: Final = 100  # messages of each kind; older ones are dropped
_START_S: Final = 5.0  # guess: a program of 50 kB starts within 0.2 s
_STATES_OF_A_SECONDARY: Final = 3  # guess: states after which no error of it can follow; errors come within one period
_SILENCE_S: Final = 5.0  # guess: ten states come per second, so the connection is lost without a word
_READ_ONLY: Final = 210  # error code of a script port while the robot is in local control
_LOCAL: Final = "switch the robot to Remote Control on its teach pendant, then connect again"


@dataclass(frozen=True, slots=True)
class TextCommand:
    """A command line, a test for its effect on the robot's state, and advice if it has no effect in time."""

    line: str
    done: Callable[[ModeData], bool]
    timeout_s: float
    advice: str


def _mode(*modes: RobotMode) -> Callable[[ModeData], bool]:
    return lambda state: state.robot_mode in modes


POWER_ON = TextCommand("power on", _mode(RobotMode.IDLE, RobotMode.RUNNING), _BOOT_S, _SAFETY)
POWER_OFF = TextCommand("power off", _mode(RobotMode.POWER_OFF), _SOON_S, _PROGRAM)
BRAKE_RELEASE = TextCommand("set robotmode run", _mode(RobotMode.RUNNING), _BOOT_S, _SAFETY)
UNLOCK_PROTECTIVE_STOP = TextCommand(
    "set unlock protective stop",
    lambda state: not state.protective_stopped,
    _SOON_S,
    "wait until 5 s after the stop and find its cause; " + _PROGRAM,
)
STOP_PROGRAM = TextCommand("stop program", lambda state: not state.program_running, _SOON_S, _PROGRAM)
SIMULATE = TextCommand("set sim", lambda state: not state.real_robot_enabled, _SOON_S, _STANDING)
REAL_ROBOT = TextCommand("set real", lambda state: state.real_robot_enabled, _SOON_S, _STANDING)


Found = TypeVar("Found")


@checked
class PrimaryCore:
    """The client's side of a primary connection, without I/O.

    version, state, kinematics, configuration: the newest, None until they are received. errors, texts, dialogues
    (popups and questions): the most recent ones, oldest first; callers may remove entries.
    """

    def __init__(self) -> None:
        self.version: PolyscopeVersion | None = None
        self.state: RobotStateData | None = None
        self.kinematics: KinematicsInfo | None = None
        self.configuration: ConfigurationData | None = None
        self.errors: deque[ErrorCodeMessage] = deque(maxlen=_MAX_KEPT)
        self.texts: deque[str] = deque(maxlen=_MAX_KEPT)
        self.dialogues: deque[PopupMessage | RequestValueMessage] = deque(maxlen=_MAX_KEPT)
        self._reset()

    def _reset(self) -> None:
        """Reset the state of the last connection."""
        self._decoder = PrimaryDecoder()
        self._received: deque[PrimaryMessage] = deque()

    def opening(self) -> Flow[None]:
        """Start on a new connection, which needs no handshake."""
        self._reset()
        yield from ()

    # messages of the robot

    def next_message(self) -> Flow[PrimaryMessage]:
        """The next message of any type."""
        while not self._received:
            self._received.extend(self._decoder.feed((yield None)))
        message = self._received.popleft()
        self._store(message)
        return message

    def robot_state(self) -> Flow[RobotStateData]:
        """The next robot state; only the first of a connection contains kinematics and configuration."""
        while True:
            message = yield from self.next_message()
            if isinstance(message, RobotStateData):
                return message

    def polyscope_version(self) -> Flow[PolyscopeVersion]:
        """The controller's version; waits until it is received."""
        return (yield from self._wait_for(lambda: self.version))

    def kinematics_info(self) -> Flow[KinematicsInfo]:
        """The arm's Denavit-Hartenberg parameters and calibration status; waits until they are received."""
        return (yield from self._wait_for(lambda: self.kinematics))

    def configuration_data(self) -> Flow[ConfigurationData]:
        """The arm's type, limits and defaults; waits until they are received."""
        return (yield from self._wait_for(lambda: self.configuration))

    # scripts

    def send_script(self, text: str) -> Flow[None]:
        """Send a script without waiting for it; suitable for ``sec`` programs and bare statements."""
        yield to_bytes(text) + b"\n"

    def send_secondary(self, text: str) -> Flow[None]:
        """Send a ``sec`` program. Raises ScriptFailedError for an error reported along with the next few states."""
        yield from self._catch_up()
        run = ScriptRun(Script("", text))
        yield from self.send_script(text)
        for _ in range(_STATES_OF_A_SECONDARY):
            yield from self._read_end_messages(run)

    def run_script(self, text: str) -> Flow[str]:
        """Send a ``def`` program, wait until it runs, and return its name.

        Raises ScriptFailedError if the controller reports an error in it.
        """
        yield from self._drain()
        if self.version is None:  # the controller speaks first, which shows that it serves this connection
            yield from self.next_message()
        yield from self.send_script(text)
        return (yield from self._key_message(PROGRAM_STARTED))

    def wait_until_stopped(self) -> Flow[str]:
        """Wait until a program ends, and return its name. Raises ScriptFailedError if an error ended it."""
        return (yield from self._key_message(PROGRAM_STOPPED))

    def execute(
        self, text: str, name: str | None = None, *, start_timeout_s: float = _START_S, timeout_s: float = float("inf")
    ) -> Flow[ScriptResult]:
        """Run a ``def`` program, or bare statements as a program of this name, and wait for its end.

        Raises RobotRefused if the robot is not in a state to run it. Raises ScriptFailedError, with the line of
        ``text``, if it does not compile, fails, is stopped for safety, does not start within ``start_timeout_s`` or has
        not ended after ``timeout_s``, and NoAnswerError if the robot falls silent. In the last three cases, and after a
        protective stop, the program may still be loaded or running: see STOP_PROGRAM.
        """
        run = yield from self.start(text, name, timeout_s=start_timeout_s)
        return (yield from self.finish(run, timeout_s=timeout_s))

    def start(
        self,
        text: str,
        name: str | None = None,
        *,
        timeout_s: float = _START_S,
        require_end: bool = False,
        failing: Collection[ReportLevel] = FATAL_LEVELS,
    ) -> Flow[ScriptRun]:
        """The first half of ``execute``: wait until the program runs. `ScriptRun.script` has its name.

        failing: levels of error codes that raise ScriptFailedError. require_end: ``finish`` also raises it if the
        program is stopped before its end; see `with_end_message`.
        """
        script = with_end_message(prepare(text, name)) if require_end else prepare(text, name)
        yield from self._catch_up()
        self._check_ready(script)
        run = ScriptRun(script, failing)
        yield from self.send_script(script.text)
        yield from self._limited(timeout_s, self._watch_until(run, PROGRAM_STARTED), run, "it has not started after")
        return run

    def finish(self, run: ScriptRun, *, timeout_s: float = float("inf")) -> Flow[ScriptResult]:
        """The second half of ``execute``: wait until the program has ended."""
        yield from self._limited(timeout_s, self._watch_until(run, PROGRAM_STOPPED), run, "it is still running after")
        yield from self._read_end_messages(run)
        if self.state and self.state.mode and self.state.mode.robot_mode != RobotMode.RUNNING:
            raise run.failed(f"it ended because the arm was switched off; {self._modes_text}")
        return run.result()

    # power and program

    def command(self, command: TextCommand) -> Flow[None]:
        """Send a text command and wait until the robot's state shows its effect. Raises RobotRefused if it does not."""
        yield from self._catch_up()
        yield TimeLimit(command.timeout_s)
        yield from self.send_script(command.line)
        try:
            while True:
                message = yield from self.next_message()
                _refuse_read_only(message, command.line)
                if isinstance(message, RobotStateData) and message.mode and command.done(message.mode):
                    return
        except NoAnswerError as error:
            if error.timeout_s < command.timeout_s:  # not even its state
                raise
            raise RobotRefused(
                command.line, f"after {command.timeout_s:g} s {self._modes_text}", command.advice
            ) from error

    # helpers

    def _store(self, message: PrimaryMessage) -> None:
        if isinstance(message, RobotStateData):
            self.state = message
            self.configuration = message.configuration or self.configuration
            kinematics = message.kinematics
            if kinematics and any(kinematics.dh_d):  # otherwise only the status, which some software versions repeat
                self.kinematics = kinematics
        elif isinstance(message, VersionMessage):
            self.version = message.version
        elif isinstance(message, ErrorCodeMessage):
            self.errors.append(message)
        elif isinstance(message, TextMessage):
            self.texts.append(message.text)
        elif isinstance(message, PopupMessage | RequestValueMessage):
            self.dialogues.append(message)

    def _wait_for(self, get: Callable[[], Found | None]) -> Flow[Found]:
        while (found := get()) is None:
            yield from self.next_message()
        return found

    def _catch_up(self) -> Flow[None]:
        """Read everything that has accumulated, and one more state, so that later messages are current."""
        yield from self._drain()
        yield from self.robot_state()

    def _drain(self) -> Flow[None]:
        while data := (yield POLL):
            self._received.extend(self._decoder.feed(data))
        while self._received:
            self._store(self._received.popleft())

    def _key_message(self, title: str) -> Flow[str]:
        while True:
            message = yield from self.next_message()
            if isinstance(message, RuntimeExceptionMessage):
                raise ScriptFailedError(message.line, message.column, message.text)
            if isinstance(message, KeyMessage) and message.title == title:
                return message.text

    def _watch_until(self, run: ScriptRun, title: str) -> Flow[None]:
        while True:
            message = yield from self.next_message()
            _refuse_read_only(message, run.script.name)
            run.watch(message)
            if isinstance(message, KeyMessage) and (message.title, message.text) == (title, run.script.name):
                return

    def _read_end_messages(self, run: ScriptRun) -> Flow[None]:
        """Read until the next state: messages about a program's end may come after it, but before the next state."""
        while True:
            message = yield from self.next_message()
            run.watch(message)
            if isinstance(message, RobotStateData):
                return

    def _limited(self, seconds: float, flow: Flow[None], run: ScriptRun, problem: str) -> Flow[None]:
        yield TimeLimit(seconds)
        try:
            yield from flow
        except NoAnswerError as error:
            if error.timeout_s < seconds:  # it does not send its state either
                raise
            raise run.failed(f"{problem} {seconds:g} s; {self._modes_text}") from error
        yield TimeLimit(None)

    def _check_ready(self, script: Script) -> None:
        """Check that the robot can run a program before sending it, like the official client."""
        state = self.state
        request = f"program {script.name}"
        if state and state.mode and state.mode.robot_mode != RobotMode.RUNNING:
            raise RobotRefused(request, self._modes_text, "switch the arm on and release its brakes first")
        if state and state.masterboard and state.masterboard.safety_mode not in MAY_RUN:
            raise RobotRefused(request, self._modes_text, "clear the stop first")

    @property
    def _modes_text(self) -> str:
        """The robot's modes, for error messages."""
        if self.state is None or self.state.mode is None:
            return "the robot's state is unknown"
        text = f"the robot mode is {mode_name(RobotMode, self.state.mode.robot_mode)}"
        if self.state.masterboard is not None:
            text += f", the safety mode {mode_name(SafetyMode, self.state.masterboard.safety_mode)}"
        return text + _program(self.state.mode)


def _refuse_read_only(message: PrimaryMessage, request: str) -> None:
    if isinstance(message, ErrorCodeMessage) and message.code == _READ_ONLY:
        raise RobotRefused(request, f"{message.label} {message.text}", _LOCAL)


def _program(mode: ModeData) -> str:
    if mode.program_paused:
        return ", a program is paused"
    return ", a program is running" if mode.program_running else ""


class _Primary(Connection):
    """Common part of the asynchronous and the blocking client."""

    silence_s = _SILENCE_S

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = PrimaryCore()

    def _opening(self) -> Flow[None]:
        return self.core.opening()


class PrimaryClient(_Primary, AsyncConnection):
    """Primary client for asyncio programs: ``await client.run(client.core....)``, in ``async with``."""


class BlockingPrimaryClient(_Primary, BlockingConnection):
    """Primary client for scripts and notebooks: ``client.run(client.core....)``, in ``with``."""
