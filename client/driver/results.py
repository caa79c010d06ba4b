"""The two ports whose messages are answered: trajectory points (50003) and script commands (50004)."""

import asyncio
import logging
from collections.abc import Iterable, Sequence
from typing import Final

from client.driver.endpoint import Endpoint, Peer
from client.errors import NoAnswerError, ProgramEndedError
from urproto.compat_asyncio import timeout
from urproto.errors import RemoteProtocolError
from urproto.external_control import (
    Answer,
    Query,
    ReplyDecoder,
    ScriptCommand,
    TrajectoryPoint,
    TrajectoryResult,
)

TRAJECTORY_PORT: Final = 50003
COMMAND_PORT: Final = 50004
_POINTS_AT_ONCE: Final = 64
_ANSWER_S: Final = 2.0  # guess: a control period or two, and the network

_logger = logging.getLogger(__name__)


class ResultEndpoint(Endpoint):
    """An endpoint on which the robot answers with results."""

    operation = "a request"

    def __init__(self, port: int, host: str = "") -> None:
        super().__init__(port, host)
        self._decoder = ReplyDecoder()
        self._results: asyncio.Queue[TrajectoryResult | None] = asyncio.Queue()

    async def result(self, timeout_s: float | None = None) -> TrajectoryResult:
        """Wait for the next result; a timeout of None waits as long as it takes.

        Raises NoAnswerError on timeout, and ProgramEndedError if the program ends first.
        """
        if not self.connected and self._results.empty():
            raise ProgramEndedError(self.port, self.operation)
        try:
            async with timeout(timeout_s):
                result = await self._results.get()
        except TimeoutError:
            raise NoAnswerError(self.peer.address, self.port, timeout_s or 0.0) from None
        if result is None:
            raise ProgramEndedError(self.port, self.operation)
        return result

    def clear_results(self) -> None:
        """Discard results that no caller has fetched."""
        while not self._results.empty():
            self._results.get_nowait()

    def data_received(self, data: bytes) -> None:
        try:
            for reply in self._decoder.feed(data):
                self._take(reply)
        except RemoteProtocolError as error:
            _logger.error("port %d: %s; the connection is closed", self.port, error)
            self.peer.abort()

    def _take(self, reply: TrajectoryResult | Answer) -> None:
        if isinstance(reply, Answer):
            raise RemoteProtocolError("an answer, although nothing was queried")
        self._results.put_nowait(reply)

    def _on_connected(self, peer: Peer) -> None:
        self._decoder = ReplyDecoder()
        self.clear_results()
        super()._on_connected(peer)

    def _on_disconnected(self, peer: Peer) -> None:
        self._results.put_nowait(None)  # wakes waiting callers
        super()._on_disconnected(peer)


class TrajectoryEndpoint(ResultEndpoint):
    """Sends the points of trajectories; the reverse interface announces where a trajectory starts and ends."""

    operation = "a trajectory"
    written: int
    """Number of points of the trajectory that have been written."""
    awaited: int
    """Number of the trajectory whose result has not arrived; 0 if all have."""

    def __init__(self, port: int = TRAJECTORY_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self.written = 0
        self.awaited = 0
        self._begun = 0
        self._ended = False

    def begin(self) -> None:
        """The points that are written from now on are those of a new trajectory."""
        self._begun += 1
        self.written, self.awaited, self._ended = 0, self._begun, False

    def end(self) -> int:
        """Write no more points of this trajectory, and return their number."""
        self._ended = True
        return self.written

    async def write(self, points: Iterable[TrajectoryPoint]) -> None:
        """Send points as fast as the robot accepts them. Raises ProgramEndedError if it disconnects meanwhile.

        If one of them raises LocalProtocolError, none is sent. The rest of a trajectory that is cancelled is not sent.
        """
        messages = [point.encode() for point in points]
        peer = self.peer
        for start in range(0, len(messages), _POINTS_AT_ONCE):
            if peer.closed.done():
                raise ProgramEndedError(self.port, self.operation)
            if self._ended:
                return
            portion = messages[start : start + _POINTS_AT_ONCE]
            self.written += len(portion)
            await peer.write_all(b"".join(portion))

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self.awaited = 0

    def _on_connected(self, peer: Peer) -> None:
        self.awaited = 0
        super()._on_connected(peer)


class ScriptCommandEndpoint(ResultEndpoint):
    """Sends commands that are executed during any motion; tool contact and queries are answered."""

    operation = "tool contact"

    def __init__(self, port: int = COMMAND_PORT, host: str = "") -> None:
        super().__init__(port, host)
        self._answers: asyncio.Queue[Answer | None] = asyncio.Queue()
        self._query_lock = asyncio.Lock()

    async def query(
        self, query: Query, arguments: Sequence[Sequence[float] | None] = (), number: int = 0
    ) -> tuple[float, ...]:
        """Query the control program and return the answer; empty without a solution.

        arguments: up to three (6,); None lets the robot use its present value. Raises ProgramEndedError if the program
        ends before it answers, and NoAnswerError if it does not answer, for example because it is paused.
        """
        async with self._query_lock:
            while not self._answers.empty():  # left by a caller that did not wait for it
                self._answers.get_nowait()
            for index, values in enumerate(arguments):
                if values is not None:
                    self.send(ScriptCommand.argument(index, values))
            given = sum(1 << index for index, values in enumerate(arguments) if values is not None)
            self.send(ScriptCommand.query(query, given, number))
            try:
                async with timeout(_ANSWER_S):
                    answer = await self._answers.get()
            except TimeoutError:
                raise NoAnswerError(self.peer.address, self.port, _ANSWER_S) from None
        if answer is None:
            raise ProgramEndedError(self.port, f"the query {query.name}")
        return answer.values

    def _take(self, reply: TrajectoryResult | Answer) -> None:
        if isinstance(reply, Answer):
            self._answers.put_nowait(reply)
        else:
            super()._take(reply)

    def _on_disconnected(self, peer: Peer) -> None:
        self._answers.put_nowait(None)  # wakes waiting callers
        super()._on_disconnected(peer)

    def send(self, command: ScriptCommand) -> None:
        """Send one command."""
        self.peer.write(command.encode())
