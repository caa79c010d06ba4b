"""A robot's states, received by a thread that does nothing else.

An event loop is busy now and then: with an import, with a file, with somebody else's work. States are
taken from the network all the same, and a robot counts as silent only when nothing has come from it
for too long: what waits in the socket while this machine is busy is no silence.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from client.driver.scheduling import RealTime, real_time_thread
from client.errors import ClientError, NoAnswerError
from client.rtde import BlockingRTDEClient
from urproto.errors import RemoteProtocolError, URError

_AGAIN_S: Final = 1.0  # between attempts to get a lost connection back

_logger = logging.getLogger(__name__)

State = Mapping[str, Any]


class StateFeed:
    """Receives states in a thread of its own, and comes back by itself when the connection is lost.

    make: a client that is not connected yet. on_state, on_silence: called in that thread, with each state, and once
    when the robot falls silent; they must be quick. silence_s: how long nothing has to come for that.

    state: the newest one. count: how many came. silent: nothing comes any more.
    """

    def __init__(
        self,
        make: Callable[[], BlockingRTDEClient],
        on_state: Callable[[State], None],
        on_silence: Callable[[], None],
        silence_s: float,
        realtime: RealTime = "auto",
    ) -> None:
        self.state: State = {}
        self.count = 0
        self.silent = False
        self._make = make
        self._on_state = on_state
        self._on_silence = on_silence
        self._silence_s = silence_s
        self._realtime = realtime
        self._gates: deque[threading.Lock] = deque()  # of threads that wait for the next state; opened by releasing
        self._closing = threading.Event()
        self._client: BlockingRTDEClient | None = None
        self._thread = threading.Thread(target=self._work, name="robot's states", daemon=True)

    def open(self) -> BlockingRTDEClient:
        """Connect, receive the first state and begin; blocks. Raises the errors of client.errors and RobotRefused."""
        client = self._client = self._connect()
        try:
            self._take(client.receive())
        except BaseException:
            client.close()
            raise
        self._thread.start()
        return client

    def close(self) -> None:
        """End the connection and the thread."""
        self._closing.set()
        if (client := self._client) is not None:
            client.shut_down()
        if self._thread.is_alive():
            self._thread.join()
        if (client := self._client) is not None:
            client.close()

    def wait(self, count: int, timeout_s: float) -> State:
        """The newest state, once there are more than ``count``, for a thread; NoAnswerError from a silent robot."""
        if self.count <= count and not self.silent:
            gate = threading.Lock()
            gate.acquire()
            self._gates.append(gate)
            if self.count <= count and not self.silent:  # nothing came before the gate was there to be opened
                gate.acquire(timeout=timeout_s)
        if self.count <= count:
            assert self._client is not None
            raise NoAnswerError(self._client.host, self._client.port, self._silence_s)
        return self.state

    def _connect(self) -> BlockingRTDEClient:
        client = self._make()
        client.__enter__()
        return client

    def _work(self) -> None:
        try:
            real_time_thread(self._realtime)
        except OSError as error:
            _logger.error("%s", error)
        while not self._closing.is_set():
            assert self._client is not None
            try:
                for state in self._client.states(self._silence_s):
                    self._take(state)
            except (ClientError, RemoteProtocolError) as error:
                if not self._closing.is_set():
                    _logger.error("the robot's state is lost: %s", error)
                    self._fall_silent()
                    self._reconnect()

    def _take(self, state: State) -> None:
        self.state = state
        self.count += 1
        self.silent = False
        self._on_state(state)
        self._open_gates()  # last: who wakes up then need not wait for this thread

    def _open_gates(self) -> None:
        """Let who waits go on. Others may come meanwhile: they have seen the newest count, or wait for the next."""
        while self._gates:
            self._gates.popleft().release()

    def _fall_silent(self) -> None:
        self.silent = True
        self._open_gates()
        self._on_silence()

    def _reconnect(self) -> None:
        assert self._client is not None
        self._client.close()
        while not self._closing.is_set():
            try:
                self._client = self._connect()
                return
            except URError as error:
                _logger.info("the robot's state is not back yet: %s", error)
            self._closing.wait(_AGAIN_S)
