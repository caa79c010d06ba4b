"""Receives a robot's states in a dedicated thread.

An event loop is occasionally busy, with an import, a file, or another task. The thread keeps receiving states
meanwhile. A robot counts as silent only if nothing has arrived for too long: data that waits in the socket while this
machine is busy is not silence.

How old a state is cannot be read off its arrival: a slow network delivers old states punctually. The thread therefore
sends a request twenty times per second. The robot answers in order with its states, so those after the answer were
taken after the request was sent.
"""

import asyncio
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from client.driver.scheduling import RealTime, Standstill, real_time_thread
from client.errors import ClientError, NoAnswerError, StaleStateError
from client.rtde import BlockingRTDEClient, ReceivedState
from urproto.errors import RemoteProtocolError, URError
from urproto.rtde.recipes import RecipeValues

_RETRY_S: Final = 1.0  # between attempts to get a lost connection back
_MARK_EVERY_S: Final = 0.05  # guess: a quarter of the default of max_age_s
_PERIODS: Final = 2  # of the states, by which they may be older: at low rates they are

_logger = logging.getLogger(__name__)


class StateFeed:
    """Receives states in a dedicated thread, and reconnects by itself when the connection is lost.

    make: creates a client that is not connected yet. on_state, on_silence: called in that thread, with each state, and
    once when the robot falls silent; they must be quick. silence_s: a robot that sends nothing for this long counts as
    silent. max_age_s: `fresh` accepts states up to this age [s], and two periods of the states.
    """

    state: ReceivedState
    """The newest state, by variable name."""
    count: int
    """Number of states received."""
    silent: bool
    """True while the robot sends nothing."""
    standstill: Standstill
    """Whether the reason may be that this process stood still."""

    def __init__(
        self,
        make: Callable[[], BlockingRTDEClient],
        on_state: Callable[[ReceivedState], None],
        on_silence: Callable[[], None],
        silence_s: float,
        max_age_s: float,
        realtime: RealTime = "auto",
    ) -> None:
        self.state = ReceivedState(RecipeValues((), {}), -math.inf)
        self.count = 0
        self.silent = False
        self.standstill = Standstill()
        self._make = make
        self._on_state = on_state
        self._on_silence = on_silence
        self._silence_s = silence_s
        self._max_age_s = max_age_s
        self._mark_lock = threading.Lock()  # marks are sent in the order of their times
        self._next_mark_s = 0.0
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
            self._receive(next(client.states(self._silence_s)))
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

    def mark(self) -> float:
        """Let the robot mark the stream of states, from any thread; states taken from now on are not older than this.

        Returns the time with which to compare their ``taken_after_s``.
        """
        with self._mark_lock:
            now_s = time.monotonic()
            if (client := self._client) is not None:
                client.send_now(client.core.mark(now_s))
            return now_s

    @property
    def max_age_s(self) -> float:
        """Age up to which `fresh` accepts a state [s]."""
        rate_hz = self._client.core.rate_hz if self._client is not None else 0.0
        return self._max_age_s + (_PERIODS / rate_hz if rate_hz else 0.0)

    def fresh(self) -> ReceivedState:
        """The newest state. Raises StaleStateError if it is older than `max_age_s`.

        A thread without an event loop is blocked for up to `max_age_s`, until a younger state arrives.
        """
        state, limit_s = self.state, self.max_age_s
        if (age_s := state.age_s) <= limit_s:
            return state
        until_s = time.monotonic() + (0.0 if _in_event_loop() else limit_s)
        while not self.silent and (left_s := until_s - time.monotonic()) > 0.0:
            with suppress(NoAnswerError):
                self.wait(self.count, left_s)
            state = self.state
            if (age_s := state.age_s) <= limit_s:
                return state
        assert self._client is not None
        raise StaleStateError(self._client.host, age_s, self._max_age_s, self.standstill.describe())

    def wait(self, count: int, timeout_s: float) -> ReceivedState:
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
        try:
            client.run(client.core.first_mark(time.monotonic()), self._silence_s)
        except NoAnswerError:
            _logger.info("the robot sends no marks: its states count as taken when they arrive")
        except BaseException:
            client.close()
            raise
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
                    _logger.error("no state from the robot: %s", self.standstill.describe() or error)
                    self._report_silence()
                    self._reconnect()

    def _receive(self, state: ReceivedState) -> None:
        if time.monotonic() >= self._next_mark_s:
            self._next_mark_s = self.mark() + _MARK_EVERY_S
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


def _in_event_loop() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True
