"""Which program is loaded and runs, and as much of its text as the robot tells."""

import asyncio
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from client import dashboard
from client.pendant.emulator_control import BehindError
from client.scripts import Script, prepare
from urproto.errors import LocalProtocolError, URError
from urproto.modes import RuntimeState
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    KeyMessage,
    ProgramThread,
    ProgramThreadsMessage,
    RuntimeExceptionMessage,
)

if TYPE_CHECKING:
    from client.pendant.station import Station


_START_S: Final = 5.0  # guess: a program of 50 kB starts within 0.2 s
_MOST: Final = 2_000_000  # characters; a robot takes no more either (guess)

Phase = Literal["", "sent", "running", "ended", "failed", "silent"]


@dataclass(frozen=True, slots=True)
class ScriptError:
    """What is wrong with a script, and where in the text as it was written; line and column from 1.

    told: by the checker; by the robot, which did not start it, or while it ran.
    """

    line: int
    column: int
    text: str
    told: Literal["check", "start", "run"] = "check"
    severity: Literal["error", "warning"] = "error"


class Draft:
    """One text for all browsers. author: the page that wrote it last. revision: counts what changed.

    phase: of the script that was sent last, "" before the first; silent: it has not started, and nobody said why.
    error: what the robot says is wrong with that script. diagnoses: what the checker says of the text as it is.
    """

    def __init__(self) -> None:
        self.text = _EXAMPLE
        self.author = ""
        self.revision = 0
        self.phase: Phase = ""
        self.error: ScriptError | None = None
        self.diagnoses: tuple[ScriptError, ...] = ()
        self.script: Script | None = None
        self._sent_at_s = 0.0
        self._sent_revision = 0

    @property
    def is_somebodys(self) -> bool:
        """Whether somebody would miss the text."""
        return bool(self.text.strip()) and self.text != _EXAMPLE

    def write(self, text: str, author: str = "") -> None:
        """Somebody has written something else. Raises ValueError for what is too long."""
        if len(text) > _MOST:
            raise ValueError(f"a script of {len(text)} characters is too long: at most {_MOST} are possible")
        if text != self.text:
            self.text, self.author, self.revision = text, author, self.revision + 1

    def prepared(self) -> Script:
        """What to send: a program, or a secondary program, which has no name. Raises ValueError for an empty text."""
        if not self.text.strip():
            raise ValueError("The editor is empty: there is no script to send.")
        try:
            return prepare(self.text)
        except LocalProtocolError:  # a secondary program: only errors are heard of
            return Script("", self.text)

    def sending(self, script: Script, now_s: float) -> None:
        """That is being sent. now_s: any clock."""
        self.script, self._sent_at_s, self.phase, self.error = script, now_s, "sent", None
        self._sent_revision = self.revision

    def checked(self, revision: int, diagnoses: tuple[ScriptError, ...]) -> None:
        """The checker has looked at the text of this revision."""
        if revision != self.revision:
            return
        self.diagnoses = diagnoses
        if self.error is not None and self.error.told == "start" and revision != self._sent_revision:
            self.error = None  # it was about another text, and the checker knows about this one

    @property
    def problems(self) -> tuple[ScriptError, ...]:
        """All that is known to be wrong. The checker says better than the robot why a script does not start."""
        error = self.error
        if error is None or (error.told == "start" and any(one.severity == "error" for one in self.diagnoses)):
            return self.diagnoses
        return (error, *(one for one in self.diagnoses if one.line != error.line))

    def hear(self, message: object) -> None:
        """Take note of what the robot says about the script."""
        if isinstance(message, KeyMessage) and self.script is not None and message.text == (self.script.name or None):
            if message.title == PROGRAM_STARTED and self.phase in ("sent", "silent"):
                self.phase = "running"
            elif message.title == PROGRAM_STOPPED and self.phase == "running":
                self.phase = "ended"
        elif isinstance(message, RuntimeExceptionMessage) and self._is_about(message):
            self._fail(message)

    def look(self, now_s: float) -> None:
        """Time goes by."""
        if self.phase == "sent" and now_s - self._sent_at_s > _START_S:
            self.phase = "silent" if self.script is not None and self.script.name else "ended"

    def _is_about(self, message: RuntimeExceptionMessage) -> bool:
        """Compile errors have no time; a script that runs meanwhile may be somebody else's."""
        return self.phase == ("sent" if message.timestamp_us == NO_TIMESTAMP_US else "running")

    def _fail(self, message: RuntimeExceptionMessage) -> None:
        assert self.script is not None
        line = min(self.script.line(message.line), self.text.count("\n") + 1)
        told: Literal["start", "run"] = "start" if self.phase == "sent" else "run"
        self.error = ScriptError(line, message.column, _readable(self.script.message(message.text)), told)
        self.phase = "failed"


def _readable(reported: str) -> str:
    """Controllers repeat line and number after a word of their own when they cannot parse it."""
    return _SYNTAX_ERROR if reported.startswith("syntax_error_on_line") else reported


_SYNTAX_ERROR: Final = "Syntax error: the controller cannot make sense of this line, or of what is before it"
_EXAMPLE: Final = """\
def hello():
  textmsg("the tool is at ", get_actual_tcp_pose())
end
"""


_LOOK_AGAIN_S: Final = 1.0
_LOADED_AGAIN_S: Final = 5.0  # each time is a connection to the dashboard, of which robots have few
_LINE: Final = "script_control_line"


@dataclass(frozen=True, slots=True)
class Node:
    """A node of a program tree. number: by which the program's labels name it."""

    number: int
    depth: int
    text: str
    suppressed: bool


@dataclass(frozen=True, slots=True)
class ShownProgram:
    """text: its script. running: the lines and labels that the robot tells are of this program."""

    text: str = ""
    tree: tuple[Node, ...] = ()
    running: bool = False


NOTHING_SHOWN: Final = ShownProgram()


class Programs:
    """loaded: path of the loaded file, as the dashboard says. running: name of what runs or ran last.

    shown: the program that runs, else the loaded one, if its text is known: an emulator tells all of it, of a robot's
    only what was sent from here is. threads: where each thread stands, in programs that have labels.
    """

    def __init__(self) -> None:
        self.draft = Draft()
        self.loaded: str | None = None
        self.running = ""
        self.threads: tuple[ProgramThread, ...] = ()
        self.shown = NOTHING_SHOWN
        self._started_s: float | None = None
        self._stopped_s: float | None = None
        self._changed = asyncio.Event()

    # what the robot tells by itself

    def hear(self, message: object) -> None:
        """Take note of what happens to programs."""
        self.draft.hear(message)
        if isinstance(message, ProgramThreadsMessage):
            self.threads = message.threads
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STARTED:
            self.running, self.threads = message.text, ()
            self._started_s, self._stopped_s = message.timestamp_us / 1e6, None
            self.look()
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STOPPED:
            self._stopped_s, self.threads = message.timestamp_us / 1e6, ()
            self.look()

    def look(self) -> None:
        """Something may be other than before: ask."""
        self._changed.set()

    def run_time_s(self, now_s: float) -> float | None:
        """How long the program runs, or ran, by the robot's clock; None for one whose start nobody saw."""
        if self._started_s is None:
            return None
        return max(0.0, (now_s if self._stopped_s is None else self._stopped_s) - self._started_s)

    def line(self, station: "Station") -> int:
        """Line of the shown script that is carried out, 0 when that is not known."""
        if not self.shown.running or station.runtime_state is RuntimeState.STOPPED:
            return 0
        return int(station.values.get(_LINE, 0))

    def tells_line(self, station: "Station") -> bool:
        """Whether this robot's software tells the line at all."""
        return _LINE not in station.unavailable

    # what it tells when asked

    async def follow(self, station: "Station") -> None:
        """Ask again when something happened, and now and then which program is loaded, for ever."""
        asked_s, emulated = -_LOADED_AGAIN_S, None
        clock = asyncio.get_running_loop().time
        while True:
            if station.connected and (self._changed.is_set() or clock() - asked_s >= _LOADED_AGAIN_S):
                asked_s = clock()
                with suppress(URError, OSError):
                    await self._ask_loaded(station)
            if self._changed.is_set() or station.behind.available != emulated:
                self._changed.clear()
                available = station.behind.available
                emulated = available if await self._see(station) else None  # then once more
            self.draft.look(clock())
            with suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), _LOOK_AGAIN_S)

    async def _ask_loaded(self, station: "Station") -> None:
        loaded = await station.ask(dashboard.LOADED_PROGRAM)
        if loaded != self.loaded:
            self.loaded = loaded
            self.look()

    async def _see(self, station: "Station") -> bool:
        try:
            self.shown = await self._look_at(station)
        except (BehindError, KeyError, TypeError):  # gone, or an emulator of another version
            self.shown = NOTHING_SHOWN
            return False
        return True

    async def _look_at(self, station: "Station") -> ShownProgram:
        if "program" in station.behind.verbs and station.behind.available:
            return _shown(await station.behind.call("program"))
        script = self.draft.script
        if script is not None and script.name == self.running and self.draft.phase in ("running", "ended", "failed"):
            return ShownProgram(script.text, running=self.draft.phase == "running")
        return NOTHING_SHOWN

    async def files(self, station: "Station") -> list[str]:
        """Programs that can be loaded. Raises ClientError: robots do not tell."""
        return list(await station.behind.call("programs"))


def _shown(told: dict[str, Any]) -> ShownProgram:
    return ShownProgram(told["text"], tuple(Node(**node) for node in told["tree"]), told["running"])
