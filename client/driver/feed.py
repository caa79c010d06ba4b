"""Receives a robot's states in a dedicated thread.

An event loop is occasionally busy, with an import, a file, or another task. The thread keeps receiving states
meanwhile. A robot counts as silent only if nothing has arrived for too long: data that waits in the socket while this
machine is busy is not silence.
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

_RETRY_S: Final = 1.0  # between attempts to get a lost connection back

_logger = logging.getLogger(__name__)

State = Mapping[str, Any]


class StateFeed:
    """Receives states in a dedicated thread, and reconnects by itself when the connection is lost.

    make: creates a client that is not connected yet. on_state, on_silence: called in that thread, with each state, and
    once when the robot falls silent; they must be quick. silence_s: a robot that sends nothing for this long counts as
    silent.
    """

    state: State
    """The newest state, by variable name."""
    count: int
    """Number of states received."""
    silent: bool
    """True while the robot sends nothing."""

    def __init__(
        self,
        make: Callable[[], BlockingRTDEClient],
        on_state: Callable[[State], None],
        on_silence: Callable[[], None],
        silence_s: float,
        realtime: RealTime = "auto",
    ) -> None:
        self.state = {}
        self.count = 0
        self.silent = False
        self._make = make
        self._on_state = on_state
        self._on_silence = on_silence
        self._silence_s = silence_s
        self._realtime = realtime
        self._gates: deque[threading.Lock] = deque()  # one per waiting thread; released to wake it
        self._closing = threading.Event()
        self._client: BlockingRTDEClient | None = None
        self._thread = threading.Thread(target=self._run, name="robot's states", daemon=True)

    def open(self) -> BlockingRTDEClient:
        """Connect, receive the first state and start the thread; blocks.

        Raises the errors of client.errors, and RobotRefused.
        """
        client = self._client = self._connect()
        try:
            self._receive(client.receive())
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
        """Block the calling thread until more than ``count`` states have arrived, and return the newest.

        Raises NoAnswerError if the robot is silent.
        """
        if self.count <= count and not self.silent:
            gate = threading.Lock()
            gate.acquire()
            self._gates.append(gate)
            if self.count <= count and not self.silent:  # no state arrived before the gate was registered
                gate.acquire(timeout=timeout_s)
        if self.count <= count:
            assert self._client is not None
            raise NoAnswerError(self._client.host, self._client.port, self._silence_s)
        return self.state

    def _connect(self) -> BlockingRTDEClient:
        client = self._make()
        client.__enter__()
        return client

    def _run(self) -> None:
        try:
            real_time_thread(self._realtime)
        except OSError as error:
            _logger.error("%s", error)
        while not self._closing.is_set():
            assert self._client is not None
            try:
                for state in self._client.states(self._silence_s):
                    self._receive(state)
            except (ClientError, RemoteProtocolError) as error:
                if not self._closing.is_set():
                    _logger.error("no state from the robot: %s", error)
                    self._report_silence()
                    self._reconnect()

    def _receive(self, state: State) -> None:
        self.state = state
        self.count += 1
        self.silent = False
        self._on_state(state)
        self._open_gates()  # last, so that woken threads do not have to wait for this one

    def _open_gates(self) -> None:
        """Wake the waiting threads. Threads that arrive meanwhile have seen the newest count, or wait for the next."""
        while self._gates:
            self._gates.popleft().release()

    def _report_silence(self) -> None:
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
                _logger.info("still no state from the robot: %s", error)
            self._closing.wait(_RETRY_S)
