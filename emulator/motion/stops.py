"""Stops, independent of the speed slider: stopj, stopl and the stops of faults and brakes.

A pause holds a stop that a program has commanded, which continues afterwards; nothing holds the others.
"""

from enum import Enum, auto

from emulator.motion.faults import MotionFault
from emulator.motion.generator import Clock
from emulator.motion.reach import Reach
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, pose_add
from urproto.vectors import as_six, largest, norm3, scaled, sub

_TIME_TOLERANCE = 1e-9  # s


class StopOrigin(Enum):
    """Cause of a stop."""

    COMMAND = auto()
    FAULT = auto()  # a movement could not continue
    BRAKES = auto()  # the power is off


class JointStop:
    """Every joint brakes evenly from its own speed, in its own time; ``done`` once all stand still.

    ``late_s``: time since the stop should have begun, from q; negative: time until it begins.
    """

    def __init__(
        self,
        q: Joints,
        qd: Joints,
        durations: Joints,
        origin: StopOrigin = StopOrigin.COMMAND,
        *,
        late_s: float = 0.0,
    ) -> None:
        self.origin = origin
        self._q, self._qd, self._durations = q, qd, durations
        self._last = max(durations)
        self._t = self._proposed = late_s
        self._begun = False

    def propose(self, h: float, q: Joints) -> Joints:
        self._proposed = self._t + h
        return self._at(self._proposed)

    @property
    def clock(self) -> Clock:
        return Clock.PROGRAM if self.origin is StopOrigin.COMMAND else Clock.REAL

    def _at(self, t: float) -> Joints:
        return as_six(
            q + qd * (0.5 * end if t >= end else t if t <= 0.0 else t - 0.5 * t * t / end)
            for q, qd, end in zip(self._q, self._qd, self._durations, strict=True)
        )

    def commit(self) -> None:
        self._t, self._begun = self._proposed, True

    @property
    def remaining_s(self) -> float:
        """Time until all joints stand still."""
        return self._last - self._t

    @property
    def done(self) -> bool:
        return self._begun and self._t >= self._last - _TIME_TOLERANCE

    @property
    def ready(self) -> bool:
        return self.done

    def goal(self) -> Pose | None:
        return None


def brake_together(q: Joints, qd: Joints, deceleration: float, late_s: float = 0.0) -> JointStop:
    """stopj: the leading joint brakes with ``deceleration`` [rad/s2], the others come to rest with it."""
    return JointStop(q, qd, (largest(qd) / deceleration,) * 6, late_s=late_s)


class ToolStop:
    """stopl: the tool brakes along its present screw motion; linear and angular speed decrease evenly together.

    If the joints cannot follow within their speed limits, each joint brakes on its own. ``late_s``: as in JointStop.
    """

    clock = Clock.PROGRAM

    def __init__(
        self,
        reach: Reach,
        period_s: float,
        start: tuple[Pose, Joints],
        qd: Joints,
        decelerations: tuple[float, float],
        late_s: float = 0.0,
    ) -> None:
        """``start``: pose and velocity of the tool; ``qd``: speeds of the joints; m/s2 and rad/s2."""
        self._reach, self._period = reach, period_s
        self._pose, twist = start
        self._twist = twist
        self._duration = max(norm3(*twist[:3]) / decelerations[0], norm3(*twist[3:]) / decelerations[1])
        self._t = self._proposed = late_s
        self._begun = False
        self._fallback: JointStop | None = None
        self._speed = qd

    def propose(self, h: float, q: Joints) -> Joints:
        if self._fallback is None:
            self._proposed = t = min(self._t + h, self._duration)
            try:
                target = self._reach.joints(self._at(t), q) if self._duration > 0.0 else q
            except MotionFault:
                target = None
            if target is not None and self._followable(sub(target, q), h):
                return target
            most = self._reach.model.qdd_max
            self._fallback = JointStop(
                q, self._speed, as_six(abs(qd) / a for qd, a in zip(self._speed, most, strict=True))
            )
        return self._fallback.propose(h, q)

    def _followable(self, step: Joints, h: float) -> bool:
        self._next_speed = scaled(step, 1.0 / h)
        model = self._reach.model
        return all(
            abs(qd) <= most and abs(qd - before) <= 2.0 * a * self._period
            for qd, before, most, a in zip(self._next_speed, self._speed, model.qd_max, model.qdd_max, strict=True)
        )

    def _at(self, t: float) -> Pose:
        share = t if t <= 0.0 else t - 0.5 * t * t / self._duration
        return pose_add(scaled(self._twist, share), self._pose)

    def commit(self) -> None:
        self._begun = True
        if self._fallback is not None:
            self._fallback.commit()
        else:
            self._t, self._speed = self._proposed, self._next_speed

    @property
    def remaining_s(self) -> float:
        """Time until the tool stands still."""
        return self._duration - self._t if self._fallback is None else self._fallback.remaining_s

    @property
    def done(self) -> bool:
        if self._fallback is not None:
            return self._fallback.done
        return self._begun and self._t >= self._duration - _TIME_TOLERANCE

    @property
    def ready(self) -> bool:
        return self.done

    def goal(self) -> Pose | None:
        return None
