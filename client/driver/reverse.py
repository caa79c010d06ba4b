"""The reverse interface (50001): setpoints and keep-alives to the control program."""

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from client.driver.endpoint import Endpoint, Peer
from client.driver.realtime import RealTime, real_time_thread
from client.driver.timeouts import KEEP_ALIVE_TIMEOUT_S, LONGEST_REAL_TIME_S, SETPOINT_TIMEOUT_S, read_timeout_ms
from client.errors import LateSetpointError
from urproto.errors import LocalProtocolError
from urproto.external_control import ControlMode, FreedriveAction, ReverseMessage, TrajectoryAction
from urproto.versions import Series

__all__ = ["REVERSE_PORT", "Pulse", "ReverseEndpoint", "StreamStatistics"]

REVERSE_PORT: Final = 50001
_LOOK_S: Final = 0.02  # guess: how closely setpoints that cease are watched

_logger = logging.getLogger(__name__)


@dataclass(slots=True)
class StreamStatistics:
    """Of setpoints that follow each other in one mode, by this machine's clock.

    sent: how many. skipped: control periods for which none was sent, beyond one that was a little late. late: how
    often the robot had to wait for longer than it may, and stopped the arm. longest_gap_s: between two of them.
    """

    sent: int = 0
    skipped: int = 0
    late: int = 0
    longest_gap_s: float = 0.0

    def __str__(self) -> str:
        return (
            f"{self.sent} setpoints sent, {self.skipped} control periods without one, "
            f"longest gap {1000.0 * self.longest_gap_s:.0f} ms"
        )


class ReverseEndpoint(Endpoint):
    """Sends what the arm is to do; while a robot is connected here its program runs.

    period_s: the robot's control period [s]. Every method sends at once, from any thread, and
    raises ProgramNotRunningError without a robot and LocalProtocolError for values that cannot be
    sent. timeout_s: how long the program waits for the message after this one before it stops
    the arm; see `read_timeout_ms` for its limits. stream: of the setpoints since the last message
    that was none.
    """

    def __init__(self, port: int = REVERSE_PORT, host: str = "", period_s: float = Series.E.period_s) -> None:
        super().__init__(port, host)
        self.period_s = period_s
        self.mode = ControlMode.IDLE
        self.stream = StreamStatistics()
        self._lock = threading.RLock()
        self._sent_s = 0.0  # when, by the monotonic clock, and
        self._timeout_s = 0.0  # how long the robot waits after that
        self._was_late = ""  # why the arm was stopped, until who sends setpoints was told

    def setpoint(self, mode: ControlMode, values: Sequence[float], timeout_s: float = SETPOINT_TIMEOUT_S) -> None:
        """One setpoint (6,) of a real-time mode, in the units `ReverseMessage.setpoint` gives.

        Raises LateSetpointError, once, when the robot has waited for it too long: the arm was stopped, the program
        goes on, and this setpoint was not sent.
        """
        message = ReverseMessage.setpoint(mode, values, self._timeout_ms(mode, timeout_s))
        with self._lock:
            peer = self.peer
            now = time.monotonic()
            if self.mode.real_time and self._sent_s:
                self._note_gap(now - self._sent_s)
            if self._was_late:
                why, self._was_late = self._was_late, ""
                raise LateSetpointError("a stream of setpoints", why)
            if not self.mode.real_time:
                self.stream = StreamStatistics()
            self.stream.sent += 1
            self._write(peer, message, now)

    def keep_alive(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Nothing to do: an arm in motion is brought to rest."""
        with self._lock:
            self._rest(timeout_s)
            self._was_late = ""

    def _rest(self, timeout_s: float) -> None:
        self._send(ReverseMessage.keep_alive(self._timeout_ms(ControlMode.IDLE, timeout_s)))

    def trajectory(self, action: TrajectoryAction, points: int = 0, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end a trajectory of so many points."""
        self._send(ReverseMessage.trajectory(action, points, self._timeout_ms(ControlMode.FORWARD, timeout_s)))

    def freedrive(self, action: FreedriveAction, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end freedrive."""
        self._send(ReverseMessage.freedrive(action, self._timeout_ms(ControlMode.FREEDRIVE, timeout_s)))

    def stop(self) -> None:
        """End the control program."""
        self._send(ReverseMessage.stop())

    def continue_mode(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """The keep-alive of the present mode. Setpoints have none: an arm whose setpoints cease is brought to rest."""
        with self._lock:
            if self.mode is ControlMode.FORWARD:
                self.trajectory(TrajectoryAction.NOOP, 0, timeout_s)
            elif self.mode is ControlMode.FREEDRIVE:
                self.freedrive(FreedriveAction.NOOP, timeout_s)
            elif self.mode is ControlMode.IDLE:
                self._rest(timeout_s)

    def end_late_stream(self) -> None:
        """Let the program go on when setpoints have ceased for longer than the robot waits; the arm is at rest then."""
        with self._lock:
            if self.mode.real_time and self.quiet_s > self._timeout_s:
                self._note_gap(self.quiet_s)

    def take_late(self) -> str:
        """Why the arm was stopped, if it was for want of setpoints and nobody has been told yet."""
        why, self._was_late = self._was_late, ""
        return why

    def note_late(self, why: str) -> None:
        """The robot says that it had to wait for too long."""
        with self._lock:
            if self.connected and self.mode.real_time:
                self._be_late(why)

    @property
    def quiet_s(self) -> float:
        """How long nothing has been sent to the robot that is there, or was."""
        return time.monotonic() - self._sent_s if self._sent_s else 0.0

    def _note_gap(self, gap_s: float) -> None:
        self.stream.longest_gap_s = max(self.stream.longest_gap_s, gap_s)
        self.stream.skipped += max(0, round(gap_s / self.period_s) - 1)
        if gap_s > self._timeout_s:
            self._be_late(
                f"this machine sent no setpoint for {1000.0 * gap_s:.0f} ms, and the robot waits "
                f"{1000.0 * self._timeout_s:.0f} ms"
            )

    def _be_late(self, why: str) -> None:
        self.stream.late += 1
        self._was_late = why
        _logger.warning("the arm was stopped: %s (%s)", why, self.stream)
        self._rest(KEEP_ALIVE_TIMEOUT_S)  # which the program waits for: what follows is a new motion

    def _timeout_ms(self, mode: ControlMode, timeout_s: float) -> int:
        return read_timeout_ms(mode, timeout_s, self.period_s)

    def _send(self, message: ReverseMessage) -> None:
        with self._lock:
            self._write(self.peer, message, time.monotonic())

    def _write(self, peer: Peer, message: ReverseMessage, now: float) -> None:
        peer.write(message.encode())
        self.mode = message.mode
        self._sent_s, self._timeout_s = now, message.read_timeout_ms / 1000.0

    def _tell(self, connected: bool) -> None:
        with self._lock:
            self.mode = ControlMode.IDLE
            self._was_late = ""
            if connected:
                self._sent_s = 0.0
        super()._tell(connected)


class Pulse:
    """Says that the driver lives, in a thread that does nothing else; use it with ``with``.

    every_s: how often; timeout_s: how long the program waits for the next time. With a watchdog
    it says so only as long as the owner kicks: a program of its own that hangs is no reason for
    the arm to go on.
    """

    def __init__(self, reverse: ReverseEndpoint, every_s: float, timeout_s: float, realtime: RealTime = "auto") -> None:
        self._reverse = reverse
        self._every_s = every_s
        self._timeout_s = timeout_s
        self._realtime = realtime
        self._ended = threading.Event()
        self._watchdog_s = 0.0
        self._kicked_s = 0.0
        self.bitten = ""  # why the watchdog ended the program, until the next one starts
        self._thread = threading.Thread(target=self._work, name="driver's pulse", daemon=True)

    def __enter__(self) -> "Pulse":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def watch(self, longest_s: float) -> None:
        """End the program when `kick` does not come for so long; 0 ends the watch."""
        if not longest_s >= 0.0:
            raise LocalProtocolError(f"a watchdog waits for 0 s (off) or more, not {longest_s}")
        self.kick()
        self._watchdog_s = longest_s

    def kick(self) -> None:
        """The owner lives too."""
        self._kicked_s = time.monotonic()

    def _work(self) -> None:
        try:
            real_time_thread(self._realtime)
        except OSError as error:
            _logger.error("%s", error)
        due_s = time.monotonic() + self._every_s
        while not self._ended.wait(min(_LOOK_S, self._every_s)):
            try:
                due_s = self._beat(due_s)
            except Exception:
                _logger.debug("nobody to keep alive", exc_info=True)  # the program has just left

    def _beat(self, due_s: float) -> float:
        if not self._reverse.connected:
            return due_s
        now = time.monotonic()
        if self._watchdog_s and now - self._kicked_s > self._watchdog_s:
            late_s = now - self._kicked_s
            self.bitten = f"the watchdog was not kicked for {late_s:.2f} s, and waits {self._watchdog_s:g} s"
            self._watchdog_s = 0.0
            _logger.error("%s: the control program is ended", self.bitten)
            self._reverse.stop()
            return due_s
        self._reverse.end_late_stream()
        if now < due_s:
            return due_s
        self._reverse.continue_mode(self._timeout_s)
        return now + self._every_s
