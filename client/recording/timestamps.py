"""Wall time of robot states, without the jitter of their arrival."""

import math
import time
from collections.abc import Callable
from typing import Any, Final

from urproto.rtde.fields import MAX_TIMESTAMP_S

_NS = 1_000_000_000
_BOOT_S = 1.0  # guess: a reboot sets the robot's clock back further than this
JUMP_S: Final = 1e6
"""A clock that advances by more than this between two states was set; guess: nobody waits 11 days for a robot."""


class Stamps:
    """Converts robot time to wall time: the first state gets this machine's time, the robot's clock counts from there.

    If the robot's clock jumps back or very far ahead, the robot has rebooted: the next state is anchored to this
    machine's clock again.
    """

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        self._anchor: tuple[float, int] | None = None
        self._last_s = 0.0

    def of(self, timestamp_s: float) -> int | None:
        """Nanoseconds since 1970 of a state, from its RTDE variable ``timestamp``; None if that is not a valid time."""
        if not (math.isfinite(timestamp_s) and abs(timestamp_s) < MAX_TIMESTAMP_S):
            return None
        if self._anchor is None or not -_BOOT_S <= timestamp_s - self._last_s <= JUMP_S:
            self._anchor = (timestamp_s, self._now_ns())
        self._last_s = timestamp_s
        return self.at(timestamp_s)

    def at(self, timestamp_s: float) -> int | None:
        """The same for data that arrives late, such as an image; None before the first state."""
        if self._anchor is None or not abs(timestamp_s - self._last_s) <= JUMP_S:
            return None
        begin_s, begin_ns = self._anchor
        return begin_ns + round((timestamp_s - begin_s) * _NS)


def seconds_and_rest(time_ns: int) -> dict[str, int]:
    """The fields of a builtin_interfaces/Time."""
    seconds, rest = divmod(time_ns, _NS)
    return {"sec": seconds, "nanosec": rest}


def header(time_ns: int, frame: str) -> dict[str, Any]:
    """The fields of a std_msgs/Header."""
    return {"stamp": seconds_and_rest(time_ns), "frame_id": frame}
