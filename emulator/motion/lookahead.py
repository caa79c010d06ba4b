"""How fast a path may be run so that the joints can still follow the rest of it.

Near a singularity, a tool path demands more joint speed than there is. Slowing down only there is too late: joints that
were fast would have to brake harder than they can. Therefore a probe runs ahead of the arm, a few points of the path in
each control period, and keeps for each cell of the path (between two points) the highest time scale from which the rest
of the path can be run within the joints' speed and acceleration limits.

With x and y the squares of the time scale in one cell and the next, u and u' the joint's speeds there as planned
(x = y = 1), and dt the time planned between their middles, the joint turns by dt (u + u') / 2 in between, and

    acceleration = (u'^2 y - u^2 x) / (u + u') dt

The highest x of a cell therefore follows from that of the next one by a linear program in two variables, backwards from
the far end (this is the backward pass of time-optimal path parametrisation). Going forward, the arm is as fast as its
joints allow.
"""

from bisect import bisect_right
from copy import copy
from math import sqrt

from emulator.motion.faults import MotionFault
from emulator.motion.path_motion import PathMotion
from urproto.robots.model import Joints, RobotModel
from urproto.vectors import ZERO6, largest, scaled, scaled_sub, sub

_CELL_S = 0.024  # of the movement's own time; shorter if a joint turns more than _TURN_RAD within a cell (guesses)
_SHORTEST_CELL_S = _CELL_S / 8192
_TURN_RAD = 0.05
_END_CELL_S = 0.0005  # cells shrink to this length towards an end at which a joint is still so fast ...
_END_S = 0.002  # ... that it could not stop within this time: a singular one
_AHEAD_S = 0.2  # longer than any joint takes to brake
_CELLS_PER_PERIOD = 4
_MARGIN = 0.9  # fraction of the acceleration limits used for planning, because cells are not infinitely small
_NO_TURN = 1e-9  # rad/s2


class Lookahead:
    """Lookahead along one movement that begins at joints q; times are the movement's own [s]."""

    def __init__(self, movement: PathMotion, q: Joints, model: RobotModel) -> None:
        self.movement = movement
        self.fault: MotionFault | None = None  # reason why the path cannot be run beyond the last cell
        self._probe = copy(movement)
        self._q = q
        self._qd_max = model.qd_max
        self._qdd_max = scaled(model.qdd_max, _MARGIN)
        self._least_qd_max, self._least_qdd_max = min(self._qd_max), min(self._qdd_max)
        self._now = 0.0  # where the arm is
        self._end = 0.0  # of the last cell
        self._cell = _CELL_S  # its length
        self._finished = False
        self._middles: list[float] = []
        self._speeds: list[Joints] = []  # as planned
        self._max_scales: list[float] = []  # square of the highest time scale
        self._slow_cells = 0  # cells with less than full speed

    def fraction(self, h: float) -> float:
        """Highest time scale, up to 1, for a step of up to h from where the arm is."""
        for _ in range(_CELLS_PER_PERIOD):
            if self._finished or self._end > self._now + _AHEAD_S:
                break
            self._extend()
        return self._distance_within(h) / h if self._slow_cells else 1.0

    def _distance_within(self, left: float) -> float:
        """How far the arm gets, in its own time, within this clock time."""
        t, here = self._now, sqrt(self._at(self._now))
        for k in range(bisect_right(self._middles, t), len(self._middles)):
            there, way = sqrt(self._max_scales[k]), self._middles[k] - t
            if here + there <= 0.0:
                return t - self._now
            needed = 2.0 * way / (here + there)
            if needed >= left:
                return t - self._now + left * (here + 0.5 * (there - here) * left / needed)
            t, here, left = self._middles[k], there, left - needed
        return t - self._now + here * left

    def advance(self, h: float) -> None:
        """The arm has advanced by h."""
        self._now += h
        passed = bisect_right(self._middles, self._now) - 1
        if passed > len(self._middles) // 2:
            self._slow_cells -= sum(most < 1.0 for most in self._max_scales[:passed])
            del self._middles[:passed], self._speeds[:passed], self._max_scales[:passed]

    def _at(self, t: float) -> float:
        """Square of the highest time scale at t, linear between the midpoints of two cells."""
        k = bisect_right(self._middles, t)
        if k == 0:
            return self._max_scales[0]
        if k == len(self._middles):
            return self._max_scales[-1] if t < self._end or self._finished else 1.0
        share = (t - self._middles[k - 1]) / (self._middles[k] - self._middles[k - 1])
        return self._max_scales[k - 1] + share * (self._max_scales[k] - self._max_scales[k - 1])

    def _extend(self) -> None:
        left = self._probe.remaining_s
        h = min(_CELL_S, 2.0 * self._cell, left)
        q = self._joints_after(h)
        while h > _SHORTEST_CELL_S and (q is None or self._too_coarse(sub(q, self._q), h, left)):
            h *= 0.5
            q = self._joints_after(h)
        if q is None:
            self._end_path()
            return
        self._probe.commit()
        speed = scaled_sub(q, self._q, 1.0 / h)
        fastest = 1.0
        if largest(speed) > self._least_qd_max:
            fastest = max(1.0, *(abs(rate) / most for rate, most in zip(speed, self._qd_max, strict=True)))
        self._append(self._end + 0.5 * h, speed, 1.0 / fastest**2)
        self._end, self._cell, self._q = self._end + h, h, q
        if self._probe.done:
            self._finished = True
            self._append(self._end, ZERO6, 1.0)

    def _too_coarse(self, turn: Joints, h: float, left: float) -> bool:
        """Whether a cell of length h is too long, given how far the joints turn in it."""
        if largest(turn) > _TURN_RAD:
            return True
        # times a joint's acceleration: its displacement within h at the speed that it can lose in _END_S
        soon = _END_S * h
        limits = zip(turn, self._qdd_max, strict=True)
        return h == left > _END_CELL_S and any(abs(way) > soon * most for way, most in limits)

    def _joints_after(self, h: float) -> Joints | None:
        """Joints h further on; None if there are none, with the reason in ``fault``."""
        self.fault = None
        try:
            return self._probe.propose(h, self._q)
        except MotionFault as fault:
            self.fault = fault
            return None

    def _end_path(self) -> None:
        """End the path here: the arm has to stop."""
        self._finished = True
        if self._speeds:
            self._append(self._end, self._speeds[-1], 0.0)

    def _append(self, middle: float, speed: Joints, most: float) -> None:
        self._middles.append(middle)
        self._speeds.append(speed)
        self._max_scales.append(most)
        self._slow_cells += most < 1.0
        for k in range(len(self._max_scales) - 2, -1, -1):
            before = self._max_scales[k]
            after = self._controllable(k)
            if after >= before:
                return
            self._slow_cells += before == 1.0
            self._max_scales[k] = after

    def _controllable(self, k: int) -> float:
        """Highest x of cell k, at most its present value, from which cell k + 1 can be run."""
        highest, follows = self._max_scales[k], self._max_scales[k + 1]
        here, there = self._speeds[k], self._speeds[k + 1]
        dt = self._middles[k + 1] - self._middles[k]
        if highest == follows == 1.0:
            if largest(sub(there, here)) <= self._least_qdd_max * dt:
                return 1.0
            changes = zip(here, there, self._qdd_max, strict=True)
            if all(-most * dt <= u2 - u1 <= most * dt for u1, u2, most in changes):
                return 1.0
        floors, ceilings = [(0.0, 0.0)], [(follows, 0.0)]  # of y: value at x = 0, slope
        for u1, u2, most in zip(here, there, self._qdd_max, strict=True):
            p, q = _coefficients(u1, u2, dt)
            if abs(q) > _NO_TURN:
                floors.append((-most / abs(q), -p / q))
                ceilings.append((most / abs(q), -p / q))
            elif abs(p) > _NO_TURN:
                highest = min(highest, most / abs(p))
        for low, rise in floors:
            for high, slope in ceilings:
                if rise > slope:
                    highest = min(highest, (high - low) / (rise - slope))
        return highest


def _coefficients(u1: float, u2: float, dt: float) -> tuple[float, float]:
    """Coefficients of the two squared time scales in the acceleration between two cells."""
    if u1 * u2 >= 0.0 and u1 != -u2:
        turn = (u1 + u2) * dt
        return -u1 * u1 / turn, u2 * u2 / turn
    return 0.25 * (u2 - 3.0 * u1) / dt, 0.25 * (3.0 * u2 - u1) / dt  # the joint reverses: first order
