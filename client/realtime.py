"""Client for the realtime interface, which sends a robot's complete state in every control period, unrequested.

    with BlockingRealtimeClient("192.168.56.101") as robot:
        state = robot.receive()          # {"timestamp": 41.2, "actual_q": (0.0, ...), ...}

Names and units are those of RTDE. The robot's version determines which variables it sends. Prefer RTDE for everything
that RTDE offers.
"""

from collections import deque

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Connection, Flow, FlowMethod
from urproto.realtime import RealtimeDecoder, RealtimeState

PORT = 30003


class _Realtime(Connection):
    """The operations of the asynchronous and the blocking client."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self._decoder = RealtimeDecoder()
        self._received: deque[RealtimeState] = deque()

    def _opening(self) -> Flow[None]:
        self._decoder = RealtimeDecoder()
        self._received.clear()
        yield from ()

    @FlowMethod
    def receive(self) -> Flow[RealtimeState]:
        """The next state, by variable name; states come in order, and none is skipped."""
        while not self._received:
            self._received.extend(self._decoder.feed((yield None)))
        return self._received.popleft()


class RealtimeClient(_Realtime, AsyncConnection):
    """Client for the realtime interface, for asyncio programs; use it with ``async with``."""


class BlockingRealtimeClient(_Realtime, BlockingConnection):
    """Client for the realtime interface, for scripts and notebooks; use it with ``with``."""
