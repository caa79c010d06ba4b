"""The program that is loaded and running, and its text as far as it is known."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

from client import dashboard
from client.pendant.draft import Draft
from client.pendant.emulator_control import EmulatorControl
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.modes import RuntimeState
from urproto.primary.messages import (
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    KeyMessage,
    ProgramThread,
    ProgramThreadsMessage,
)
from urscript.polyscope.program import OutlineNode

Answer = TypeVar("Answer")

_POLL_PERIOD_S: Final = 1.0
_LOADED_PERIOD_S: Final = 5.0  # each query opens a connection to the dashboard, of which robots allow few
_LINE_FIELD: Final = "script_control_line"


@dataclass(frozen=True, slots=True)
class ShownProgram:
    """A program that is shown. text: its script. running: the lines and labels that the robot reports are of it."""

    text: str = ""
    tree: tuple[OutlineNode, ...] = ()
    running: bool = False


NOTHING_SHOWN: Final = ShownProgram()


class Robot(Protocol):
    """The part of `client.pendant.station.Station` that `Programs` needs."""

    values: Mapping[str, Any]
    unavailable: frozenset[str]
    connected: bool
    emulator: EmulatorControl

    @property
    def runtime_state(self) -> RuntimeState:
        """State of the program."""

    async def request(self, operation: dashboard.Operation[Answer]) -> Answer:
        """Send a request to the dashboard."""


class Programs:
    """The robot's programs. loaded: path of the loaded file, from the dashboard. running: name of the last program.

    running is the present program or the one that ran last. shown: the running program, else the loaded one, if its
    text is known. An emulator provides every text; of a robot, only scripts that were sent from here are known.
    threads: position of each thread, in programs that have labels.
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

    # messages of the robot

    def handle_message(self, message: object) -> None:
        self.draft.handle_message(message)
        if isinstance(message, ProgramThreadsMessage):
            self.threads = message.threads
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STARTED:
            self.running, self.threads = message.text, ()
            self._started_s, self._stopped_s = message.timestamp_us / 1e6, None
            self.refresh()
        elif isinstance(message, KeyMessage) and message.title == PROGRAM_STOPPED:
            self._stopped_s, self.threads = message.timestamp_us / 1e6, ()
            self.refresh()

    def refresh(self) -> None:
        self._changed.set()

    def run_time_s(self, now_s: float) -> float | None:
        """Run time of the program by the robot's clock; None if its start was not observed."""
        if self._started_s is None:
            return None
        return max(0.0, (now_s if self._stopped_s is None else self._stopped_s) - self._started_s)

    def current_line(self, station: Robot) -> int:
        """Line of the shown script that is being executed, 0 if unknown."""
        if not self.shown.running or station.runtime_state is RuntimeState.STOPPED:
            return 0
        return int(station.values.get(_LINE_FIELD, 0))

    def reports_line(self, station: Robot) -> bool:
        return _LINE_FIELD not in station.unavailable

    # queries

    async def follow(self, station: Robot) -> None:
        """Query the program after each event, and the loaded program regularly, forever."""
        queried_s, emulated = -_LOADED_PERIOD_S, None
        clock = asyncio.get_running_loop().time
        while True:
            if station.connected and (self._changed.is_set() or clock() - queried_s >= _LOADED_PERIOD_S):
                queried_s = clock()
                with suppress(URError, OSError):
                    await self._query_loaded(station)
            if self._changed.is_set() or station.emulator.available != emulated:
                self._changed.clear()
                available = station.emulator.available
                emulated = available if await self._update_shown(station) else None  # else once more
            self.draft.check_start(clock())
            with suppress(TimeoutError):
                async with timeout(_POLL_PERIOD_S):
                    await self._changed.wait()

    async def _query_loaded(self, station: Robot) -> None:
        loaded = await station.request(dashboard.LOADED_PROGRAM)
        if loaded != self.loaded:
            self.loaded = loaded
            self.refresh()

    async def _update_shown(self, station: Robot) -> bool:
        try:
            self.shown = await self._find_shown(station)
        except (URError, KeyError, TypeError):  # disconnected, or an emulator of another version
            self.shown = NOTHING_SHOWN
            return False
        return True

    async def _find_shown(self, station: Robot) -> ShownProgram:
        if "program" in station.emulator.verbs and station.emulator.available:
            return _parse_shown(await station.emulator.call("program"))
        script = self.draft.script
        if script is not None and script.name == self.running and self.draft.phase in ("running", "ended", "failed"):
            return ShownProgram(script.text, running=self.draft.phase == "running")
        return NOTHING_SHOWN

    async def files(self, station: Robot) -> list[str]:
        """Programs that can be loaded. Raises URError: robots do not list them."""
        return list(await station.emulator.call("programs"))


def _parse_shown(answer: dict[str, Any]) -> ShownProgram:
    return ShownProgram(answer["text"], tuple(OutlineNode(**node) for node in answer["tree"]), answer["running"])
