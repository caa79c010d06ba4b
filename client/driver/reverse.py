"""The port for setpoints and modes, which also shows whether the control program runs."""

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from client.driver.endpoint import Endpoint, Peer
from client.errors import LateSetpointError
from urproto.errors import LocalProtocolError
from urproto.external_control import ControlMode, FreedriveAction, ReverseMessage, TrajectoryAction
from urproto.versions import Series

REVERSE_PORT: Final = 50001
MAX_REAL_TIME_S: Final = 0.2  # source: the client library, which limits how long an arm moves without a message
SETPOINT_TIMEOUT_S: Final = 0.02  # the client library's default for a setpoint
KEEP_ALIVE_TIMEOUT_S: Final = 1.0  # the client library's default for a keep-alive
_STOP_MS: Final = 100
_MAX_TIMEOUT_MS: Final = 2**31 - 1

_logger = logging.getLogger(__name__)


@lru_cache(maxsize=64)  # called for every setpoint
def read_timeout_ms(mode: ControlMode, timeout_s: float, period_s: float) -> int:
    """Return the timeout [ms] to send for `timeout_s` in this mode.

    It is at least one control period `period_s` [s]. 0 waits forever, except in real-time modes, where it means one
    period. Raises LocalProtocolError for a negative timeout, and in real-time modes for one above 0.2 s.
    """
    if not timeout_s >= 0.0:
        raise LocalProtocolError(f"a timeout is 0 s or more, not {timeout_s}")
    if mode.real_time and timeout_s > MAX_REAL_TIME_S:
        raise LocalProtocolError(
            f"a robot waits at most {MAX_REAL_TIME_S:g} s for the next setpoint, not {timeout_s}: send them more often"
        )
    if mode is ControlMode.STOPPED:
        return _STOP_MS
    if timeout_s == 0.0 and not mode.real_time:
        return 0
    return max(1, round(min(1000.0 * max(timeout_s, period_s), _MAX_TIMEOUT_MS)))


@dataclass(slots=True)
class StreamStatistics:
    """Statistics of consecutive setpoints in one mode, by this machine's clock."""

    sent: int = 0
    """Number of setpoints sent."""
    skipped: int = 0
    """Number of control periods without a setpoint, not counting setpoints that were slightly late."""
    late: int = 0
    """How often the robot waited longer than the timeout, and stopped the arm."""
    longest_gap_s: float = 0.0
    """Longest time between two setpoints [s]."""

    def __str__(self) -> str:
        return (
            f"{self.sent} setpoints sent, {self.skipped} control periods without one, "
            f"longest gap {1000.0 * self.longest_gap_s:.0f} ms"
        )


class ReverseEndpoint(Endpoint):
    """Sends setpoints and modes; while a robot is connected to this port, its control program is running.

    Every method sends immediately, from any thread. It raises ProgramNotRunningError without a robot, and
    LocalProtocolError for values that cannot be sent. timeout_s: how long the program waits for the next message before
    it stops the arm; `read_timeout_ms` describes its limits.
    """

    period_s: float
    """The robot's control period [s]."""
    mode: ControlMode
    """Mode of the last message."""
    stream: StreamStatistics
    """Statistics of the setpoints since the last other message."""
    sent: int
    """Number of messages sent to the program that is connected."""

    def __init__(self, port: int = REVERSE_PORT, host: str = "", period_s: float = Series.E.period_s) -> None:
        super().__init__(port, host)
        self.period_s = period_s
        self.mode = ControlMode.IDLE
        self.stream = StreamStatistics()
        self.sent = 0
        self._lock = threading.RLock()
        self._sent_s = 0.0  # time of the last message, by the monotonic clock
        self._timeout_s = 0.0  # how long the robot waits after that
        self._late_reason = ""  # why the arm was stopped, until it has been reported to the sender of setpoints

    def setpoint(self, mode: ControlMode, values: Sequence[float], timeout_s: float = SETPOINT_TIMEOUT_S) -> None:
        """Send one setpoint (6,) of a real-time mode, in the units of `ReverseMessage.setpoint`.

        Raises LateSetpointError, once, if the robot has waited for it too long: the arm was stopped, the program
        continues, and this setpoint was not sent.
        """
        message = ReverseMessage.setpoint(mode, values, self._timeout_ms(mode, timeout_s))
        with self._lock:
            peer = self.peer
            now = time.monotonic()
            if self.mode.real_time and self._sent_s:
                self._record_gap(now - self._sent_s)
            if self._late_reason:
                why, self._late_reason = self._late_reason, ""
                raise LateSetpointError("a stream of setpoints", why)
            if not self.mode.real_time:
                self.stream = StreamStatistics()
            self.stream.sent += 1
            self._write(peer, message, now)

    def keep_alive(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Send that there is nothing to do; a moving arm is brought to rest."""
        with self._lock:
            self._rest(timeout_s)
            self._late_reason = ""

    def _rest(self, timeout_s: float) -> None:
        self._send(ReverseMessage.keep_alive(self._timeout_ms(ControlMode.IDLE, timeout_s)))

    def trajectory(self, action: TrajectoryAction, points: int = 0, timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Start, keep alive, or end a trajectory with this number of points."""
        self._send(ReverseMessage.trajectory(action, points, self._timeout_ms(ControlMode.FORWARD, timeout_s)))

    def freedrive(self, action: FreedriveAction, timeout_s: float = MAX_REAL_TIME_S) -> None:
        """Start, keep alive, or end freedrive."""
        self._send(ReverseMessage.freedrive(action, self._timeout_ms(ControlMode.FREEDRIVE, timeout_s)))

    def stop(self) -> None:
        """End the control program."""
        self._send(ReverseMessage.stop())

    def continue_mode(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Send the keep-alive message of the present mode.

        Setpoint modes have none: when setpoints stop coming, the arm is brought to rest.
        """
        with self._lock:
            if self.mode is ControlMode.FORWARD:
                self.trajectory(TrajectoryAction.NOOP, 0, timeout_s)
            elif self.mode is ControlMode.FREEDRIVE:
                self.freedrive(FreedriveAction.NOOP, timeout_s)
            elif self.mode is ControlMode.IDLE:
                self._rest(timeout_s)

    def end_late_stream(self) -> None:
        """Keep the program running if setpoints stop for longer than the robot waits; the arm is then at rest."""
        with self._lock:
            if self.mode.real_time and self.silence_s > self._timeout_s:
                self._record_gap(self.silence_s)

    def pop_late_reason(self) -> str:
        """Return why the arm was stopped, if it was for a late setpoint that has not been reported yet; else ""."""
        why, self._late_reason = self._late_reason, ""
        return why

    def report_late(self, number: int, why: str) -> None:
        """Take note of the robot's report that no setpoint followed message ``number`` in time."""
        with self._lock:
            if (
                self.connected and self.mode.real_time and number > self.sent - self.stream.sent
            ):  # not an earlier stream
                self._handle_late(why)

    @property
    def silence_s(self) -> float:
        """Time since the last message to the current or last robot [s]."""
        return time.monotonic() - self._sent_s if self._sent_s else 0.0

    def _record_gap(self, gap_s: float) -> None:
        self.stream.longest_gap_s = max(self.stream.longest_gap_s, gap_s)
        self.stream.skipped += max(0, round(gap_s / self.period_s) - 1)
        if gap_s > self._timeout_s:
            self._handle_late(
                f"this machine sent no setpoint for {1000.0 * gap_s:.0f} ms, and the robot waits only "
                f"{1000.0 * self._timeout_s:.0f} ms"
            )

    def _handle_late(self, why: str) -> None:
        self.stream.late += 1
        self._late_reason = why
        _logger.warning("the arm was stopped: %s (%s)", why, self.stream)
        self._rest(KEEP_ALIVE_TIMEOUT_S)  # the program waits for this; the next setpoint begins a new motion

    def _timeout_ms(self, mode: ControlMode, timeout_s: float) -> int:
        return read_timeout_ms(mode, timeout_s, self.period_s)

    def _send(self, message: ReverseMessage) -> None:
        with self._lock:
            self._write(self.peer, message, time.monotonic())

    def _write(self, peer: Peer, message: ReverseMessage, now: float) -> None:
        peer.write(message.encode())
        self.sent += 1
        self.mode = message.mode
        self._sent_s, self._timeout_s = now, message.read_timeout_ms / 1000.0

    def _notify(self, connected: bool) -> None:
        with self._lock:
            self.mode = ControlMode.IDLE
            self._late_reason = ""
            if connected:
                self._sent_s, self.sent = 0.0, 0
        super()._notify(connected)
