"""Position limits of the joints, and whether the joints could still stop before them."""

from math import dist, inf

from emulator.motion.faults import MotionFault, joint_limit
from emulator.motion.stops import JointStop, StopOrigin
from urproto.robots.model import Joints, RobotModel
from urproto.vectors import as_six, sub, within

_TOLERANCE_RAD = 1e-9


class PositionLimits:
    """Position limits. low, high: of each joint [rad], those of the model until others are set."""

    def __init__(self, model: RobotModel, period_s: float) -> None:
        self.use(*model.position_limits)
        self._qdd_max = model.qdd_max
        # braking distance of a joint over the square of its move in one period
        self._braking = as_six(1.0 / (2.0 * a * period_s**2) for a in model.qdd_max)
        self._longest_braking = max(self._braking)

    def use(self, low: Joints, high: Joints) -> None:
        self.low, self.high = low, high
        # Fast path: no joint can reach a limit before the arm is this far [rad] from here.
        self._here, self._room = low, 0.0

    def check(self, target: Joints, before: Joints) -> None:
        """Raise MotionFault if a joint that moves like this in a period could not stop before its limit."""
        if target == before:
            return
        move = dist(target, before)
        if dist(target, self._here) + move * move * self._longest_braking < self._room:
            return
        self._check_closely(target, before)
        self._here, self._room = target, min(*sub(self.high, target), *sub(target, self.low))

    def _check_closely(self, target: Joints, before: Joints) -> None:
        for i, (now, was, low, high, braking) in enumerate(
            zip(target, before, self.low, self.high, self._braking, strict=True)
        ):
            move = now - was
            end = now + move * abs(move) * braking
            if low <= now <= high and low <= end <= high:
                continue
            if (was > high and move <= 0.0) or (was < low and move >= 0.0):
                continue  # already outside, as in recovery mode, and moving back
            margin = abs(move) + _TOLERANCE_RAD  # the speed is the period's mean, not its end's
            inside = low - _TOLERANCE_RAD <= now <= high + _TOLERANCE_RAD
            if not (inside and low - margin <= end <= high + margin):
                raise joint_limit(i, end, low, high)

    def outside(self, q: Joints) -> MotionFault | None:
        """The fault of a configuration outside the limits, or None."""
        if within(self.low, q, self.high):
            return None
        for i, (position, low, high) in enumerate(zip(q, self.low, self.high, strict=True)):
            if not low - _TOLERANCE_RAD <= position <= high + _TOLERANCE_RAD:
                return joint_limit(i, position, low, high)
        return None

    def brake(self, q: Joints, qd: Joints) -> JointStop:
        """Brake each joint at its acceleration limit, and harder only if its position limit is too close for that."""
        times = zip(self.longest_stop(q, qd), qd, self._qdd_max, strict=True)
        durations = as_six(min(longest, abs(speed) / a) for longest, speed, a in times)
        return JointStop(q, qd, durations, StopOrigin.FAULT)

    def longest_stop(self, q: Joints, qd: Joints) -> Joints:
        """Longest time each joint may take to brake evenly before its limit [s]; inf for a joint at rest."""
        return as_six(
            2.0 * max(high - position if speed > 0.0 else position - low, 0.0) / abs(speed) if speed else inf
            for position, speed, low, high in zip(q, qd, self.low, self.high, strict=True)
        )
