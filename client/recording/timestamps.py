"""When a state was, in wall time, without the jitter of its arrival."""

import math
import time
from collections.abc import Callable
from typing import Any, Final

from urproto.rtde.fields import LONGEST_S

_NS = 1_000_000_000
_BOOT_S = 1.0  # the clock of a robot that has booted is farther back; guess
JUMP_S: Final = 1e6
"""A clock that goes on by more between two states has been set; guess: nobody waits for a robot for 11 days."""


class Stamps:
    """Wall time of the first state; from there on the robot's own clock goes on.

    A clock that goes far backwards, or very far ahead, is that of a robot that has booted anew: the wall clock
    counts again.
    """

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        self._anchor: tuple[float, int] | None = None
        self._last_s = 0.0

    def of(self, timestamp_s: float) -> int | None:
        """Nanoseconds since 1970 of a state, by its RTDE variable ``timestamp``; None for what is no time."""
        if not (math.isfinite(timestamp_s) and abs(timestamp_s) < LONGEST_S):
            return None
        if self._anchor is None or not -_BOOT_S <= timestamp_s - self._last_s <= JUMP_S:
            self._anchor = (timestamp_s, self._now_ns())
        self._last_s = timestamp_s
        return self.at(timestamp_s)

    def at(self, timestamp_s: float) -> int | None:
        """The same of something that comes late, as a picture does; None before the first state."""
        if self._anchor is None or not abs(timestamp_s - self._last_s) <= JUMP_S:
            return None
        begin_s, begin_ns = self._anchor
        return begin_ns + round((timestamp_s - begin_s) * _NS)


def seconds_and_rest(time_ns: int) -> dict[str, int]:
    """As ROS 2 writes a time."""
    seconds, rest = divmod(time_ns, _NS)
    return {"sec": seconds, "nanosec": rest}


def header(time_ns: int, frame: str) -> dict[str, Any]:
    """A std_msgs/Header."""
    return {"stamp": seconds_and_rest(time_ns), "frame_id": frame}
