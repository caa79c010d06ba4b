"""Keeps the control program alive from a dedicated thread, or ends it."""

import logging
import threading
import time
from typing import Final

from client.driver.reverse import ReverseEndpoint
from client.driver.scheduling import RealTime, Standstill, real_time_thread
from urproto.errors import LocalProtocolError

_CHECK_S: Final = 0.02  # guess: interval of the check for missing setpoints

_logger = logging.getLogger(__name__)


class KeepAliveThread:
    """Sends keep-alive messages from a dedicated thread; use it with ``with``.

    period_s: interval; timeout_s: how long the program waits for the next message. Two events end the program: a
    watchdog that is not kicked, if the owner has set one, and an event loop that hangs for ``hang_s``, that is, does
    not call `report_alive`. Otherwise this thread would keep the arm moving while the rest of the program hangs.
    """

    stop_reason: str
    """Why the watchdog ended the program, until the next one starts; otherwise empty."""

    def __init__(
        self,
        reverse: ReverseEndpoint,
        period_s: float,
        timeout_s: float,
        realtime: RealTime = "auto",
        hang_s: float = 0.0,
        standstill: Standstill | None = None,
    ) -> None:
        self._reverse = reverse
        self._period_s = period_s
        self._timeout_s = timeout_s
        self._realtime = realtime
        self._ended = threading.Event()
        self._watchdog_s = 0.0
        self._kicked_s = 0.0
        self._hang_timeout_s = hang_s
        self._standstill = Standstill() if standstill is None else standstill
        self._loop_alive_s = time.monotonic()
        self.stop_reason = ""
        self._thread = threading.Thread(target=self._run, name="driver's keep-alive", daemon=True)

    def __enter__(self) -> "KeepAliveThread":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def watch(self, timeout_s: float) -> None:
        """End the program if `kick` is not called for ``timeout_s``; 0 disables the watchdog."""
        if not timeout_s >= 0.0:
            raise LocalProtocolError(f"a watchdog timeout is 0 s (off) or more, not {timeout_s}")
        self.kick()
        self._watchdog_s = timeout_s

    def kick(self) -> None:
        """Report that the owner is alive."""
        self._kicked_s = time.monotonic()

    def report_alive(self) -> None:
        """Report that the event loop is alive."""
        self._loop_alive_s = time.monotonic()

    def _run(self) -> None:
        try:
            real_time_thread(self._realtime)
        except OSError as error:
            _logger.error("%s", error)
        due_s = time.monotonic() + self._period_s
        while not self._ended.wait(min(_CHECK_S, self._period_s)):
            self._standstill.beat()
            try:
                due_s = self._cycle(due_s)
            except Exception:
                _logger.debug("no program to keep alive", exc_info=True)  # it has just disconnected

    def _cycle(self, due_s: float) -> float:
        if not self._reverse.connected:
            return due_s
        now = time.monotonic()
        if why := self._hang_reason(now):
            if not self.stop_reason:
                self.stop_reason = why
                self._watchdog_s = 0.0  # a caller that restarts the program sets it again
                _logger.error("%s: the control program is stopped", why)
                self._reverse.stop()
            return due_s
        self._reverse.end_late_stream()
        if now < due_s:
            return due_s
        self._reverse.continue_mode(self._timeout_s)
        return now + self._period_s

    def _hang_reason(self, now: float) -> str:
        """Say why the arm must not keep moving; "" if it may."""
        if self._watchdog_s and now - self._kicked_s > self._watchdog_s:
            late_s = now - self._kicked_s
            return f"the watchdog was not kicked for {late_s:.2f} s, its timeout is {self._watchdog_s:g} s"
        if self._hang_timeout_s and now - self._loop_alive_s > self._hang_timeout_s:
            if why := self._standstill.describe():
                return why
            return f"the event loop of this program has hung for {now - self._loop_alive_s:.1f} s"
        return ""
