"""Replay a recording as a robot: clients connect to it as to the recorded one.

    async with ReplayRobot(Recording.read(Path("robot.pcapng")), "127.0.0.1") as robot:
        await robot.played.wait()

It listens on the ports that have connections in the recording. It cannot answer requests that are not in the
recording: the dashboard then answers that it does not understand, Modbus that there is no such address, and other
ports close the connection, which ``report`` reports.
"""

import asyncio
import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import cycle
from typing import Final, TypeVar, cast

from client.decoding.states import PRIMARY, REALTIME
from client.decoding.streams import Framing
from client.errors import FileError
from client.traffic.players import (
    Broadcast,
    DialoguePlayer,
    PlaybackOptions,
    Player,
    SequentialPlayer,
    TimedMessages,
    UnansweredError,
    answer_dashboard,
    answer_line,
    answer_modbus,
    cut_frames,
    cut_lines,
    line_requests,
    modbus_requests,
)
from client.traffic.ports import port_name, server_is_robot
from client.traffic.proxy import reason_of
from client.traffic.recording import Conversation, TrafficRecording
from client.traffic.rtde_log import RTDELog
from client.traffic.rtde_player import RTDELibrary, RTDEPlayer
from urproto.compat import Self
from urproto.errors import LocalProtocolError, ProtocolError
from urproto.versions import PolyscopeVersion

_logger = logging.getLogger(__name__)

PlayerFactory = Callable[[], Player]
Recorded = TypeVar("Recorded")
_VERSION: Final = "PolyScope: "
_FRAMINGS: Final[dict[int, Framing]] = {30001: PRIMARY, 30002: PRIMARY, 30011: PRIMARY, 30012: PRIMARY,
                                        30003: REALTIME, 30013: REALTIME}  # fmt: skip
_MAX_SLEEP_S: Final = 1.0  # longest sleep until the clock is checked again


class ReplayRobot:
    """The ports of a recording, open while the context is entered.

    speed: recorded seconds per second. loop: states start again at their end instead of closing the connection.
    port_offset: added to each usual port. free_ports: use any free ports instead. report: called with messages for the
    user. ports: those it listens on, by name. not_open: reason why a port cannot be opened, by name. played: set when a
    connection has received all its states.
    """

    def __init__(
        self,
        recording: TrafficRecording,
        listen: str = "127.0.0.1",
        *,
        speed: float = 1.0,
        loop: bool = False,
        port_offset: int = 0,
        free_ports: bool = False,
        report: Callable[[str], None] = _logger.info,
    ) -> None:
        if not 0.0 < speed < math.inf:
            raise LocalProtocolError(f"a recording cannot be replayed at speed {speed}: give a positive number")
        self.ports: dict[str, int] = {}
        self.not_open: dict[str, str] = {}
        self.played = asyncio.Event()
        self._listen = listen
        self._port_offset = port_offset
        self._free_ports = free_ports
        self._report = report
        self._reported: Counter[str] = Counter()
        self._player_factories = _player_factories(recording, PlaybackOptions(speed, loop), report)
        self._servers: list[asyncio.Server] = []
        self._connections: set[_Connection] = set()

    async def __aenter__(self) -> Self:
        """Open the ports. Raises OSError if none can be opened."""
        try:
            for port, make in self._player_factories.items():
                await self._open(port, make)
            if not self._servers:
                raise OSError("; ".join(self.not_open.values()))
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    async def _open(self, port: int, make: PlayerFactory) -> None:
        wanted = 0 if self._free_ports else port + self._port_offset
        loop = asyncio.get_running_loop()
        name = port_name(port)
        try:
            server = await loop.create_server(lambda: self._accept(name, make), self._listen, wanted)
        except OSError as error:
            self.not_open[name] = f"{name}: cannot listen on {self._listen}:{wanted} ({reason_of(error)})"
            self._report(self.not_open[name])
            return
        self._servers.append(server)
        self.ports[name] = server.sockets[0].getsockname()[1]

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        connections = list(self._connections)
        for connection in connections:
            connection.abort()
        await asyncio.gather(*(connection.closed.wait() for connection in connections))

    def _accept(self, name: str, make: PlayerFactory) -> asyncio.BaseProtocol:
        connection = _Connection(name, make(), self._ended)
        self._connections.add(connection)
        return connection

    def _ended(self, connection: "_Connection") -> None:
        self._connections.discard(connection)
        if connection.played:
            self.played.set()
        if connection.problem and not self._reported[connection.problem]:
            self._reported[connection.problem] += 1
            self._report(f"{connection.name}: {connection.problem}; the connection was closed")


class _Connection(asyncio.Protocol):
    """A client's connection. problem: why it was closed. played: everything was sent. closed: set at the end."""

    def __init__(self, name: str, player: Player, ended: Callable[["_Connection"], None]) -> None:
        self.name = name
        self.problem = ""
        self.played = False
        self.closed = asyncio.Event()
        self._player = player
        self._ended = ended
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._paused = False
        self._loop = asyncio.get_running_loop()

    def abort(self) -> None:
        """End the connection immediately."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is of no such class
        self._player.begin(self._loop.time())
        self._continue()

    def data_received(self, data: bytes) -> None:
        if self._transport is None or self._transport.is_closing():
            return
        try:
            self._transport.write(self._player.take(data, self._loop.time()))
        except UnansweredError as error:
            self._fail(f"the recording has no answer to {error}")
        except ProtocolError as error:
            self._fail(f"what the client sent is not a request: {error}")
        else:
            self._continue()

    def pause_writing(self) -> None:
        self._paused = True

    def resume_writing(self) -> None:
        self._paused = False
        self._continue()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._cancel()
        self.closed.set()
        self._ended(self)

    def _fail(self, problem: str) -> None:
        self.problem = problem
        if self._transport is not None:
            self._transport.close()

    def _continue(self) -> None:
        """Send the bytes that are due, and schedule the next call."""
        self._cancel()
        if self._transport is None or self._transport.is_closing() or self._paused:
            return
        now_s = self._loop.time()
        self._transport.write(self._player.due(now_s))
        if self._player.finished:
            self.played = True
            self._transport.close()
        elif (next_s := self._player.next_s) is not None:
            self._timer = self._loop.call_at(min(next_s, now_s + _MAX_SLEEP_S), self._continue)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


# which player for which port


def _player_factories(
    recording: TrafficRecording, timing: PlaybackOptions, report: Callable[[str], None]
) -> dict[int, PlayerFactory]:
    factories: dict[int, PlayerFactory] = {}
    for port in recording.ports:
        conversations = recording.on_port(port)
        if not server_is_robot(port):
            report(f"{port_name(port)}: left out, there the robot is the client; replay has no driver to connect to")
            continue
        try:
            factories[port] = _player_factory(port, conversations, timing, recording, report)
        except ProtocolError as error:
            report(f"{port_name(port)}: left out, its recording cannot be read: {error}")
    if not factories:
        raise FileError(recording.path, "has no port of a robot to replay")
    return factories


def _player_factory(
    port: int,
    conversations: list[Conversation],
    timing: PlaybackOptions,
    recording: TrafficRecording,
    report: Callable[[str], None],
) -> PlayerFactory:
    name = port_name(port)
    if port in _FRAMINGS:
        scripts = [TimedMessages.of(one, _FRAMINGS[port]) for one in conversations]
        return _take_turns(scripts, lambda script: Broadcast(script, timing))
    if name == "rtde":
        library = RTDELibrary(map(RTDELog, conversations), _version(recording.comments), report)
        return lambda: RTDEPlayer(library, timing)
    if name == "modbus":
        requests = modbus_requests(conversations, timing.loop)
        return lambda: DialoguePlayer(b"", requests, cut_frames, answer_modbus)
    if name in ("dashboard", "interpreter", "gripper"):
        greeting, lines = line_requests(conversations, timing.loop)
        answer = answer_dashboard if name == "dashboard" else answer_line
        return lambda: DialoguePlayer(greeting, lines, cut_lines, answer)
    return _take_turns(conversations, lambda one: SequentialPlayer(one, timing))


def _take_turns(recorded: Sequence[Recorded], play: Callable[[Recorded], Player]) -> PlayerFactory:
    """Give the n-th client the n-th recorded connection, and start again after the last."""
    turns = cycle(recorded)
    return lambda: play(next(turns))


def _version(comments: Iterable[str]) -> PolyscopeVersion | None:
    for comment in comments:
        try:
            return PolyscopeVersion.parse(comment.partition(_VERSION)[2])
        except ValueError:
            continue
    return None
