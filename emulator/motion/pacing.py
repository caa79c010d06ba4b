"""How far a movement's own time advances in one control period.

A movement calculates where the arm is after h seconds of its own time. Normally, h is the control period times the
speed fraction. It is less

- while the fraction changes: the leading joint's speed then changes by a known acceleration;
- while the program's time slows down for a pause or gains its pace again (`emulator.motion.program_time`);
- where a limit of the safety system would be exceeded;
- where the joints could not follow: near a singularity, a tool path needs more joint speed than there is, so the tool
  slows down in time (`emulator.motion.lookahead`). The movement fails only if no speed is slow enough.

A shorter h changes when the arm is at a point of its path, never the path itself.
"""

from collections.abc import Callable

from emulator.motion.faults import MotionFault, near_singularity
from emulator.motion.generator import Generator
from emulator.motion.lookahead import Lookahead
from emulator.motion.path_motion import PathMotion
from emulator.motion.program_time import RAMP_RAD_S2, ramped
from urproto.robots.model import Joints, RobotModel
from urproto.vectors import largest, lerp, sub

Excess = Callable[[Joints, Joints], float]
"""From a configuration and a step of one period: the largest ratio of a monitored value to its limit."""

_ROUNDS = 4  # proposals per period while searching for a step that the joints can follow
_ATTEMPTS = 18  # further proposals before giving up
_FIRST_CUT = 0.002  # the first of these shortens a step by this fraction
_EXCESS = 2.0  # times its acceleration limit is granted to a joint where the path demands it; more is a fault (guess)
_TOLERANCE = 1e-6  # of limits: rounding errors of differences of positions
_STUCK_SHARE = 1e-3  # a movement slower than this fraction of its speed ...
_CREEP = 0.5 * _STUCK_SHARE  # time scale in front of a point that cannot be passed, until that is detected
_STUCK_S = 0.1  # ... for this long cannot pass a singularity (guess)


class Pacer:
    """Controls the time scale of the movement in progress.

    What a path demands of the joints is known only after the movement has calculated the next position. Therefore a
    step is proposed, checked, and if necessary proposed again shorter. A movement commits its last proposal: after
    requesting another step, that one must be used.
    """

    def __init__(self, model: RobotModel, period_s: float) -> None:
        self._model = model
        self._period = period_s
        self._qd_max = model.qd_max
        self._qdd_max = model.qdd_max
        # per period: the largest displacement of a joint, and its largest difference from the previous period's
        self._reach = [speed * period_s for speed in model.qd_max]
        self._change = [acceleration * (1.0 + _TOLERANCE) * period_s**2 for acceleration in model.qdd_max]
        self._least_reach, self._least_change = min(self._reach), min(self._change)
        self.scale = 1.0
        self.share = 1.0  # of the commanded speed that the joints could follow in the last period
        # Ramps limit accelerations of joints, but act on time scales; the pace converts between the two.
        self._pace = 0.0  # speed of the leading joint in the movement's own time [rad/s]; 0 = not yet known
        self._gain = 0.0  # rate of change of the pace [rad/s2]
        self._stuck_s = 0.0
        self._lookahead: Lookahead | None = None

    def reset(self, pace_rad_s: float = 0.0) -> None:
        """Start a new movement, from rest or at this speed of the leading joint."""
        self.scale, self._pace, self._gain, self._stuck_s = 1.0, pace_rad_s, 0.0, 0.0
        self.share = 1.0

    def slow_down(self, share: float) -> None:
        """The movement has been running at this share of its speed, for a reason that no longer applies."""
        self.scale *= share

    def advance(
        self,
        movement: Generator,
        q: Joints,
        qd: Joints,
        goal: float,
        ramp: float = RAMP_RAD_S2,
        excess: Excess | None = None,
        time_pace: float = 1.0,
    ) -> Joints | None:
        """Propose the next configuration, approaching time scale ``goal`` (0..1) within the limits of ``excess``.

        ``time_pace``: periods of the program's time in this control period, greater than 0; while they are less than 1,
        that alone changes the speed, and the time scale keeps its value. None once the movement has come to a
        standstill. Raises MotionFault if the joints cannot follow.
        """
        requested, goal = goal, self._ramped(goal, ramp) if time_pace >= 1.0 or self._pace <= 0.0 else self.scale
        self.share = 1.0
        if goal < _TOLERANCE:
            # The pace is kept: the path here is as fast as before, and the ramp when it continues depends on it.
            self.scale = self._gain = 0.0
            return None
        period = time_pace * self._period
        most = goal * period
        # From here on, the step only becomes shorter. The lookahead comes first: it slows down in time and leaves
        # little to the others. The joints' own limits come last, because nothing may lengthen a step they allow.
        h = self._limited_by_lookahead(movement, q, most) if isinstance(movement, PathMotion) else most
        target = movement.propose(h, q)
        step = sub(target, q)
        if excess is not None and (too_fast := excess(q, step)) > 1.0 + _TOLERANCE:
            # Ramped as well: a limit that drops suddenly, as in reduced mode, must not jerk the arm. Never down to 0,
            # because at a standstill the excess would not be evaluated any more.
            h = max(self._ramped(h / period / too_fast, ramp), 2.0 * _TOLERANCE) * period
            target = movement.propose(h, q)
            step = sub(target, q)
        longest = largest(step)
        if not self._within_limits(step, qd, longest):
            h, target = self._fit_step(movement, (h, most), target, q, qd)
            step = sub(target, q)
            longest = largest(step)
            if not self._tolerable(step, qd):
                raise self._fault()
        if h < most:
            self.share = h / (max(requested, goal) * period)
        self._check_progress(h, most)
        self._update_pace(h, longest, period)
        if self._lookahead is not None:
            self._lookahead.advance(h)
        return target

    def _limited_by_lookahead(self, movement: PathMotion, q: Joints, h: float) -> float:
        """The longest step, up to h, after which the joints can follow the rest of the path."""
        if not movement.uneven:
            self._lookahead = None
            return h
        # Once per movement: the lookahead keeps its results for the remaining path.
        if self._lookahead is None or self._lookahead.movement is not movement:
            self._lookahead = Lookahead(movement, q, self._model)
        return min(h, max(_CREEP, self._lookahead.fraction(h)) * self._period)

    def _within_limits(self, step: Joints, qd: Joints, longest: float) -> bool:
        """Whether every joint can follow this step, the longest of which is that of the leading joint."""
        dt = self._period
        if longest <= self._least_reach and largest(lerp(step, qd, -dt)) <= self._least_change:
            return True
        for move, speed, most, change in zip(step, qd, self._reach, self._change, strict=True):
            if not (-most <= move <= most and -change <= move - speed * dt <= change):
                return False
        return True

    def _tolerable(self, step: Joints, qd: Joints) -> bool:
        """Whether no joint's change of speed exceeds its limit by too much."""
        dt = self._period
        changes = zip(step, qd, self._change, strict=True)
        return all(abs(move - speed * dt) <= _EXCESS * change for move, speed, change in changes)

    def _fault(self) -> MotionFault:
        return (self._lookahead and self._lookahead.fault) or near_singularity()

    def _fit_step(
        self, movement: Generator, requested: tuple[float, float], target: Joints, q: Joints, qd: Joints
    ) -> tuple[float, Joints]:
        """The step nearest to the first of ``requested``, and at most the second, that the joints can follow.

        ``target`` was proposed for the first.
        """
        h = requested[0]
        # One round would do if joint speeds were constant along the step; the path is curved, so a few are needed.
        for _ in range(_ROUNDS):
            better = self._bounded_step(h, requested, sub(target, q), qd)
            if abs(better - h) <= _TOLERANCE * h:
                return h, target  # every joint is slow enough for this h
            h = better
            target = movement.propose(h, q)
            step = sub(target, q)
            if self._within_limits(step, qd, largest(step)):
                return h, target
        return self._limit_speed(movement, h, target, q)

    def _ramped(self, goal: float, ramp: float) -> float:
        return ramped(self.scale, goal, self._pace, self._gain, ramp * self._period, self._period)

    def _bounded_step(self, h: float, requested: tuple[float, float], step: Joints, qd: Joints) -> float:
        """The step nearest to ``requested`` with which joint speeds and their changes stay within limits.

        If not all changes of speed can be within limits, the excess is shared; speed limits are always kept.
        """
        dt = self._period
        low, high, cap = 0.0, requested[1], requested[1]
        for move, speed, most, acceleration in zip(step, qd, self._qd_max, self._qdd_max, strict=True):
            if abs(move) < 1e-12:
                continue
            rate = abs(move) / h
            keep = speed * dt / rate if move > 0.0 else -speed * dt / rate
            change = acceleration * (1.0 + _TOLERANCE) * dt * dt / rate
            low, high = max(low, keep - change), min(high, keep + change)
            cap = min(cap, most * dt / rate)
        best = max(low, min(high, requested[0])) if low <= high else max(0.5 * (low + high), 0.5 * h)
        return min(best, cap)

    def _limit_speed(self, movement: Generator, h: float, target: Joints, q: Joints) -> tuple[float, Joints]:
        """Shorten the step by increasing amounts until no joint is too fast."""
        for attempt in range(_ATTEMPTS):
            if within_speed(sub(target, q), self._qd_max, self._period):
                return h, target
            h *= max(0.5, 1.0 - _FIRST_CUT * 2.0**attempt)
            target = movement.propose(h, q)
        raise self._fault()

    def _check_progress(self, h: float, most: float) -> None:
        """Fail a movement that hardly advances; not immediately, since a reversing joint is slow for a while, too."""
        if h >= _STUCK_SHARE * most:
            self._stuck_s = 0.0
            return
        self._stuck_s += self._period
        if self._stuck_s > _STUCK_S:
            raise self._fault()

    def _update_pace(self, h: float, displacement: float, period: float) -> None:
        pace = displacement / h
        self._gain = (pace - self._pace) / h
        self._pace = pace
        self.scale = h / period


def within_speed(step: Joints, qd_max: Joints, period_s: float) -> bool:
    """Whether no joint needs more than its maximum speed for this step of one period."""
    reach = period_s * (1.0 + _TOLERANCE)
    return all(abs(move) <= most * reach for move, most in zip(step, qd_max, strict=True))
