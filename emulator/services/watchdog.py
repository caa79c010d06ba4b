"""Watchdogs on RTDE inputs, which stop or pause a program when its client falls silent; history of the motion."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from urproto.vectors import Vector6

_DEPTH_S: Final = 2.0  # guess: long enough to step back to any contact that a program still reacts to
_CONTACT_N: Final = 20.0  # guess: force against the direction that counts as contact
_CONTACT_NM: Final = 2.0  # guess, likewise for a torque, where no direction is given
_BEGIN: Final = 0.1  # fraction of these below which a contact has not begun (guess)


class MotionHistory:
    """A ring of joint positions [rad] and external wrenches on the TCP (base frame, N and Nm)."""

    def __init__(self, period_s: float) -> None:
        depth = max(1, round(_DEPTH_S / period_s))
        self._q: deque[Vector6] = deque(maxlen=depth)  # newest first
        self._wrench: deque[Vector6] = deque(maxlen=depth)

    def record(self, q: Vector6, wrench: Vector6) -> None:
        self._q.appendleft(q)
        self._wrench.appendleft(wrench)

    def q_ago(self, steps: int) -> Vector6 | None:
        """Joint positions ``steps`` control periods ago, at most the oldest known; None before the first."""
        return self._q[min(max(steps, 0), len(self._q) - 1)] if self._q else None

    def contact_steps(self, direction: Sequence[float], threshold: float = 0.0) -> int:
        """Number of control periods since just before a contact against ``direction`` began; 0 without contact.

        ``direction``: base frame, its first three numbers; all zero means any direction. ``threshold``: the force
        that counts [N]; 0 uses the default. A smaller force is not a contact itself, but counts as part of one that
        follows (Script Manual: back to just before the contact started).
        """
        least = threshold or _CONTACT_N
        if not self._wrench or not any(self._wrench[0]) or not _resists(self._wrench[0], direction[:3], least):
            return 0
        steps = 0
        for wrench in self._wrench:
            if not _resists(wrench, direction[:3], least, _BEGIN):
                break
            steps += 1
        return steps


def _resists(wrench: Vector6, direction: Sequence[float], least: float, share: float = 1.0) -> bool:
    length = math.hypot(*direction)
    if length == 0.0:
        return math.hypot(*wrench[:3]) > share * least or math.hypot(*wrench[3:]) > share * _CONTACT_NM
    return -sum(f * d for f, d in zip(wrench[:3], direction, strict=True)) / length > share * least


WatchdogAction = Literal["ignore", "pause", "stop"]


@dataclass
class Watchdog:
    """``variable`` must be written at least every ``interval`` control periods; ``since``: counts from this step."""

    variable: str
    interval: float
    action: WatchdogAction
    since: int


class Watchdogs:
    """The watchdogs of the running program, one per input variable."""

    def __init__(self) -> None:
        self._watched: dict[str, Watchdog] = {}

    def set(self, watchdog: Watchdog) -> None:
        """Start a watchdog; it replaces an earlier one on the same variable."""
        self._watched[watchdog.variable] = watchdog

    def __bool__(self) -> bool:
        """Whether anything is watched."""
        return bool(self._watched)

    def remove(self, variable: str) -> None:
        self._watched.pop(variable, None)

    def clear(self) -> None:
        """Remove all watchdogs, as at the end of a program."""
        self._watched.clear()

    def restart(self, step: int) -> None:
        """Give every watchdog a fresh interval, as when a paused program resumes."""
        for watchdog in self._watched.values():
            watchdog.since = step

    def expired(self, step: int, refreshed: Mapping[str, int]) -> list[Watchdog]:
        """Expired watchdogs, given the step at which each variable was last written.

        Each is reported once, and its interval then restarts.
        """
        if not self._watched:
            return []
        starved = [
            watchdog
            for watchdog in self._watched.values()
            if step - max(watchdog.since, refreshed.get(watchdog.variable, 0)) > watchdog.interval
        ]
        for watchdog in starved:
            watchdog.since = step
        return starved
