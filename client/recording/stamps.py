"""When a state was, in wall time, without the jitter of its arrival."""

import time
from collections.abc import Callable
from typing import Any

__all__ = ["Stamps", "header", "seconds_and_rest"]

_NS = 1_000_000_000
_BOOT_S = 1.0  # the clock of a robot that has booted is farther back; guess


class Stamps:
    """Wall time of the first state; from there on the robot's own clock goes on.

    A clock that goes far backwards is that of a robot that has booted anew: the wall clock counts again.
    """

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        self._anchor: tuple[float, int] | None = None
        self._last_s = 0.0

    def of(self, timestamp_s: float) -> int:
        """Nanoseconds since 1970 of a state, by its RTDE variable ``timestamp``."""
        if self._anchor is None or timestamp_s < self._last_s - _BOOT_S:
            self._anchor = (timestamp_s, self._now_ns())
        self._last_s = timestamp_s
        begin_s, begin_ns = self._anchor
        return begin_ns + round((timestamp_s - begin_s) * _NS)


def seconds_and_rest(time_ns: int) -> dict[str, int]:
    """As ROS 2 writes a time."""
    seconds, rest = divmod(time_ns, _NS)
    return {"sec": seconds, "nanosec": rest}


def header(time_ns: int, frame: str) -> dict[str, Any]:
    """A std_msgs/Header."""
    return {"stamp": seconds_and_rest(time_ns), "frame_id": frame}
