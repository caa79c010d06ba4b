"""A robot's state and messages, scripts to it and what it says about them: the primary interface.

    with BlockingPrimaryClient("192.168.56.101") as robot:
        robot.run(robot.core.command(POWER_ON))
        result = robot.run(robot.core.execute("movej([0, -1.57, 0, -1.57, 0, 0])\\ntextmsg(1)"))
        print(result.texts, robot.run(robot.core.kinematics_info()))

Everything a robot says passes through ``next_message``, which keeps what one may want to
look at later: state, kinematics, configuration, error codes, texts, dialogues. The other
flows are made of it, so a message one flow has read is not there for the next.
"""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, TypeVar

from client.connection import DEFAULT_TIMEOUT_S, POLL, AsyncConnection, BlockingConnection, Connection, Flow, TimeLimit
from client.errors import NoAnswerError, ScriptFailedError
from client.scripts import GRAVE, MAY_RUN, Script, ScriptResult, ScriptRun, prepare, telling_its_end
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
from urproto.primary.state import ConfigurationData, KinematicsInfo, ModeData, RobotStateData
from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion

_BOOT_S: Final = 60.0  # guess: switching an arm on takes up to half a minute
_SOON_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class TextCommand:
    """A line to send, what tells that it took effect, and what to do when it did not in time."""

    line: str
    done: Callable[[ModeData], bool]
    timeout_s: float
    advice: str


def _mode(*modes: RobotMode) -> Callable[[ModeData], bool]:
    return lambda state: state.robot_mode in modes


_SAFETY: Final = "look at the safety mode, and on e-Series switch to Remote Control and connect again"
_PROGRAM: Final = "on e-Series switch to Remote Control and connect again"

POWER_ON = TextCommand("power on", _mode(RobotMode.IDLE, RobotMode.RUNNING), _BOOT_S, _SAFETY)
POWER_OFF = TextCommand("power off", _mode(RobotMode.POWER_OFF), _SOON_S, _PROGRAM)
BRAKE_RELEASE = TextCommand("set robotmode run", _mode(RobotMode.RUNNING), _BOOT_S, _SAFETY)
UNLOCK_PROTECTIVE_STOP = TextCommand(
    "set unlock protective stop",
    lambda state: not state.protective_stopped,
    _SOON_S,
    "wait until 5 s after the stop and look for its cause; then as for any other command: " + _PROGRAM,
)
STOP_PROGRAM = TextCommand("stop program", lambda state: not state.program_running, _SOON_S, _PROGRAM)
PAUSE_PROGRAM = TextCommand(
    "pause program", lambda state: state.program_paused or not state.program_running, _SOON_S, _PROGRAM
)
RESUME_PROGRAM = TextCommand("resume program", lambda state: not state.program_paused, _SOON_S, _SAFETY)
_STANDING: Final = "let the program end and the arm stand first; on e-Series the robot's own pendant has the switch"
SIMULATE = TextCommand("set sim", lambda state: not state.real_robot_enabled, _SOON_S, _STANDING)
REAL_ROBOT = TextCommand("set real", lambda state: state.real_robot_enabled, _SOON_S, _STANDING)


PORT = 30001

Found = TypeVar("Found")

_KEPT: Final = 100  # of each kind of message; older ones are dropped
_START_S: Final = 5.0  # guess: a program of 50 kB starts within 0.2 s
_STATES_OF_A_SECONDARY: Final = 3  # after which nothing more is heard of it (guess; an error comes within a period)
_READ_ONLY: Final = 210  # error code of a script port while the robot is in local control
_LOCAL: Final = "switch the robot to Remote Control on its teach pendant, then connect again"


class PrimaryCore:
    """One client's side of a primary connection, without I/O.

    version, state, kinematics, configuration: the newest, None until they came. errors,
    texts, dialogues (popups and questions): the last ones, oldest first; take them out at will.
    """

    def __init__(self) -> None:
        self.version: PolyscopeVersion | None = None
        self.state: RobotStateData | None = None
        self.kinematics: KinematicsInfo | None = None
        self.configuration: ConfigurationData | None = None
        self.errors: deque[ErrorCodeMessage] = deque(maxlen=_KEPT)
        self.texts: deque[str] = deque(maxlen=_KEPT)
        self.dialogues: deque[PopupMessage | RequestValueMessage] = deque(maxlen=_KEPT)
        self._forget()

    def _forget(self) -> None:
        """What belonged to the last connection is over."""
        self._decoder = PrimaryDecoder()
        self._received: deque[PrimaryMessage] = deque()

    def opening(self) -> Flow[None]:
        """A new connection: nothing has to be said."""
        self._forget()
        yield from ()

    # what the robot says

    def next_message(self) -> Flow[PrimaryMessage]:
        """The next message of any type."""
        while not self._received:
            self._received.extend(self._decoder.feed((yield None)))
        message = self._received.popleft()
        self._keep(message)
        return message

    def robot_state(self) -> Flow[RobotStateData]:
        """The next robot state; kinematics and configuration are only in the first of a connection."""
        while True:
            message = yield from self.next_message()
            if isinstance(message, RobotStateData):
                return message

    def polyscope_version(self) -> Flow[PolyscopeVersion]:
        """The controller's version; waits until it came."""
        return (yield from self._once_known(lambda: self.version))

    def kinematics_info(self) -> Flow[KinematicsInfo]:
        """The arm's Denavit-Hartenberg parameters and the state of its calibration; waits until they came."""
        return (yield from self._once_known(lambda: self.kinematics))

    def configuration_data(self) -> Flow[ConfigurationData]:
        """The arm's type, limits and defaults; waits until they came."""
        return (yield from self._once_known(lambda: self.configuration))

    def take_errors(self) -> list[ErrorCodeMessage]:
        """The error codes that came since the last call, oldest first. Reads nothing."""
        taken = list(self.errors)
        self.errors.clear()
        return taken

    # scripts

    def send_script(self, text: str) -> Flow[None]:
        """Send a script and wait for nothing: right for ``sec`` programs and bare statements."""
        yield to_bytes(text) + b"\n"

    def send_secondary(self, text: str) -> Flow[None]:
        """Send a ``sec`` program. ScriptFailedError for an error that is reported with the states that follow."""
        yield from self._catch_up()
        run = ScriptRun(Script("", text))
        yield from self.send_script(text)
        for _ in range(_STATES_OF_A_SECONDARY):
            yield from self._last_words(run)

    def run_script(self, text: str) -> Flow[str]:
        """Send a ``def`` program and wait until it runs; its name.

        Raises ScriptFailedError when the controller reports an error in it.
        """
        yield from self._drain()
        if self.version is None:  # a controller speaks first: then this connection is being served
            yield from self.next_message()
        yield from self.send_script(text)
        return (yield from self._key_message(PROGRAM_STARTED))

    def wait_until_stopped(self) -> Flow[str]:
        """Wait until a program ends; its name. Raises ScriptFailedError when an error ended it."""
        return (yield from self._key_message(PROGRAM_STOPPED))

    def execute(
        self, text: str, name: str | None = None, *, start_timeout_s: float = _START_S, timeout_s: float = float("inf")
    ) -> Flow[ScriptResult]:
        """Run a ``def`` program, or bare statements as one of this name, and wait for its end.

        Raises RobotRefused when the robot is in no state to run it, and ScriptFailedError
        (with the line of ``text``) when it does not compile, fails, is stopped for safety, does
        not start within ``start_timeout_s`` or has not ended after ``timeout_s``. After the
        last two, and a protective stop, the program may still be there: see STOP_PROGRAM.
        """
        run = yield from self.start(text, name, timeout_s=start_timeout_s)
        return (yield from self.finish(run, timeout_s=timeout_s))

    def start(
        self,
        text: str,
        name: str | None = None,
        *,
        timeout_s: float = _START_S,
        to_its_end: bool = False,
        failing: Collection[ReportLevel] = GRAVE,
    ) -> Flow[ScriptRun]:
        """The first half of ``execute``: until the program runs. `ScriptRun.script` has its name.

        failing: levels of error codes that are a ScriptFailedError. to_its_end: let ``finish`` raise it when somebody
        stops the program, too; see `telling_its_end`.
        """
        script = telling_its_end(prepare(text, name)) if to_its_end else prepare(text, name)
        yield from self._catch_up()
        self._check_ready(script)
        run = ScriptRun(script, failing)
        yield from self.send_script(script.text)
        yield from self._within(timeout_s, self._until(run, PROGRAM_STARTED), run, "it has not started after")
        return run

    def finish(self, run: ScriptRun, *, timeout_s: float = float("inf")) -> Flow[ScriptResult]:
        """The second half of ``execute``: until the program has ended."""
        yield from self._within(timeout_s, self._until(run, PROGRAM_STOPPED), run, "it is still running after")
        yield from self._last_words(run)
        if self.state and self.state.mode and self.state.mode.robot_mode != RobotMode.RUNNING:
            raise run.failed(f"it was ended with the arm; {self._condition}")
        return run.result()

    # power and program

    def command(self, command: TextCommand) -> Flow[None]:
        """Send a text command and wait until the robot's state shows its effect; RobotRefused if it does not."""
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
            raise RobotRefused(
                command.line, f"after {command.timeout_s:g} s {self._condition}", command.advice
            ) from error

    # helpers

    def _keep(self, message: PrimaryMessage) -> None:
        if isinstance(message, RobotStateData):
            self.state = message
            self.configuration = message.configuration or self.configuration
            kinematics = message.kinematics
            if kinematics and any(kinematics.dh_d):  # else only its status, as some software repeats it
                self.kinematics = kinematics
        elif isinstance(message, VersionMessage):
            self.version = message.version
        elif isinstance(message, ErrorCodeMessage):
            self.errors.append(message)
        elif isinstance(message, TextMessage):
            self.texts.append(message.text)
        elif isinstance(message, PopupMessage | RequestValueMessage):
            self.dialogues.append(message)

    def _once_known(self, what: Callable[[], Found | None]) -> Flow[Found]:
        while (found := what()) is None:
            yield from self.next_message()
        return found

    def _catch_up(self) -> Flow[None]:
        """Read what has piled up and one state more: what comes now is about now."""
        yield from self._drain()
        yield from self.robot_state()

    def _drain(self) -> Flow[None]:
        while data := (yield POLL):
            self._received.extend(self._decoder.feed(data))
        while self._received:
            self._keep(self._received.popleft())

    def _key_message(self, title: str) -> Flow[str]:
        while True:
            message = yield from self.next_message()
            if isinstance(message, RuntimeExceptionMessage):
                raise ScriptFailedError(message.line, message.column, message.text)
            if isinstance(message, KeyMessage) and message.title == title:
                return message.text

    def _until(self, run: ScriptRun, title: str) -> Flow[None]:
        while True:
            message = yield from self.next_message()
            _refuse_read_only(message, run.script.name)
            run.watch(message)
            if isinstance(message, KeyMessage) and (message.title, message.text) == (title, run.script.name):
                return

    def _last_words(self, run: ScriptRun) -> Flow[None]:
        """Messages about the end may follow it: the next state comes after them."""
        while True:
            message = yield from self.next_message()
            run.watch(message)
            if isinstance(message, RobotStateData):
                return

    def _within(self, seconds: float, flow: Flow[None], run: ScriptRun, complaint: str) -> Flow[None]:
        yield TimeLimit(seconds)
        try:
            yield from flow
        except NoAnswerError as error:
            raise run.failed(f"{complaint} {seconds:g} s; {self._condition}") from error
        yield TimeLimit(None)

    def _check_ready(self, script: Script) -> None:
        """As the official client does: a program is sent only to a robot that can run it."""
        state = self.state
        request = f"program {script.name}"
        if state and state.mode and state.mode.robot_mode != RobotMode.RUNNING:
            raise RobotRefused(request, self._condition, "switch the arm on and release its brakes first")
        if state and state.masterboard and state.masterboard.safety_mode not in MAY_RUN:
            raise RobotRefused(request, self._condition, "clear the stop first")

    @property
    def _condition(self) -> str:
        """The robot's modes, for people."""
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
    """Of both shells."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = PrimaryCore()

    def _opening(self) -> Flow[None]:
        return self.core.opening()


class PrimaryClient(_Primary, AsyncConnection):
    """The primary interface, for asyncio programs: ``await client.run(client.core....)``."""


class BlockingPrimaryClient(_Primary, BlockingConnection):
    """The primary interface, for scripts and notebooks: ``client.run(client.core....)``."""
