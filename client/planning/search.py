"""Path search by OMPL: in joint space, and in task space for paths on which the tool must satisfy constraints.

In suitable coordinates, the poses within orientation tolerances and a position box form a box themselves: the position
of the TCP along the edges of the position box, and its rotations from the given orientation. OMPL searches this box, in
which no sample has to be rejected or projected. The joints follow without leaving the kinematic branch of the start.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import asin, atan2, cos, hypot, pi, sin, tau
from random import Random
from typing import Any, Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.constraints import ConstrainedChecker
from client.planning.industrial import PlannedSegment, blend, first_collision
from client.planning.lines import CartesianInterpolator
from client.planning.parameterisation import Array
from client.planning.path import PiecewisePath, concatenate
from urproto.extras import how_to_install
from urproto.robots import Joints
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import ZERO6

_ROTATION_WEIGHT_M_RAD: Final = 0.2  # weight of rotation compared with distance (guess)
_RANGE_M: Final = 0.2  # largest step of a tree (guess)
_RESOLUTIONS_M: Final = (0.02, 0.01)  # between validity checks
_INNER: Final = 0.9  # share of the tolerances that is searched, which leaves room to blend corners
_SHORTCUT_ATTEMPTS: Final = 12
_ATTEMPTS: Final = 4
_BLENDS: Final = 8  # attempts, each with half the radius
_MAX_BLEND_M: Final = 0.1
_NUDGE: Final = 1e-5
# Largest step of a tree: of 24 paths past a wall and a board, this missed 2 in 8 s; OMPL's own choice, 4 rad, missed 8.
_RANGE_RAD: Final = 0.5
_MARGIN_RAD: Final = np.pi  # how far beyond start and goals each joint is sampled


def search_joint_space(
    checker: CollisionChecker,
    start: Joints,
    goals: Sequence[Joints],
    planner: str,
    limit_s: float,
    seed: int,
    step_rad: float,
) -> list[Array] | None:
    """Search for a path between configurations, checking every ``step_rad``; None if none was found in time."""
    bounds = list(_bounds(checker, start, goals))
    return solve(bounds, checker.is_free, start, goals, planner, limit_s, seed, step_rad, _RANGE_RAD)


def solve(
    bounds: Sequence[tuple[float, float]],
    is_free: Callable[[Array], bool],
    start: Sequence[float] | Array,
    goals: Sequence[Sequence[float] | Array],
    planner: str,
    limit_s: float,
    seed: int,
    step: float,
    tree_step: float,
) -> list[Array] | None:
    """Search for a path within the bounds of six coordinates with OMPL; None if none was found within ``limit_s``.

    step: between validity checks. tree_step: the longest extension of a tree (OMPL's range). Raises PlanningError
    without OMPL.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise PlanningError(f"planning needs OMPL: {how_to_install('plan')}") from error
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(6)
    box = base.RealVectorBounds(6)
    for i, (low, high) in enumerate(bounds):
        box.setLow(i, low)
        box.setHigh(i, high)
    space.setBounds(box)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: is_free(np.array([state[i] for i in range(6)])))
    information.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    ends = base.GoalStates(information)
    for goal in goals:
        ends.addState(_state(space, goal))
    problem.setGoal(ends)
    search = getattr(geometric, planner)(information)
    if planner != "PRM":
        search.setRange(tree_step)
    search.setProblemDefinition(problem)
    search.setup()
    if not search.solve(limit_s) or not problem.hasExactSolution():
        return None
    found = problem.getSolutionPath()
    states = (found.getState(i) for i in range(found.getStateCount()))
    return [np.array([state[i] for i in range(6)]) for state in states]


def _bounds(checker: CollisionChecker, start: Joints, goals: Sequence[Joints]) -> Iterator[tuple[float, float]]:
    """The range in which each joint is sampled: around start and goals, within its limits.

    Further whole turns would only cost time.
    """
    for i, (low, high) in enumerate(zip(*checker.scene.model.position_limits, strict=True)):
        angles = [start[i], *(goal[i] for goal in goals)]
        yield max(low, min(angles) - _MARGIN_RAD), min(high, max(angles) + _MARGIN_RAD)


def _state(space: Any, q: Sequence[float] | Array) -> Any:
    state = space.allocState()
    for i, angle in enumerate(q):
        state[i] = float(angle)
    return state


class TaskSpace:
    """The poses that satisfy a checker's constraints, as coordinates (6,) between ``low`` and ``high``."""

    def __init__(self, checker: ConstrainedChecker, poses: Sequence[Pose]) -> None:
        given = checker.constraints
        tcp = given.tcp_offset or ZERO6
        self._frame = tuple(given.position.pose) if given.position else ZERO6
        self._rotation = np.array(
            rotvec_to_matrix(*(given.orientation.orientation if given.orientation else poses[0][3:]))
        ).reshape(3, 3)
        far = checker.scene.model.reach_m + hypot(*tcp[:3])
        half = 0.5 * np.array(given.position.size) if given.position else np.full(3, far)
        turns = np.array(given.orientation.tolerance_rad if given.orientation else (pi, pi / 2, pi))
        most = np.concatenate((half, _ROTATION_WEIGHT_M_RAD * turns))
        ends = np.array([self.coordinates(pose) for pose in poses])
        self.high = np.maximum(_INNER * most, ends.max(axis=0))
        self.low = np.minimum(-_INNER * most, ends.min(axis=0))
        self.around = turns[2] >= pi - 1e-6  # rotation about z is free, also beyond pi
        if self.around:
            self.low[5], self.high[5] = -tau * _ROTATION_WEIGHT_M_RAD, tau * _ROTATION_WEIGHT_M_RAD

    def coordinates(self, pose: Pose) -> Array:
        """The coordinates of a pose of the TCP."""
        place = pose_trans(pose_inv(self._frame), pose)[:3]
        r = self._rotation.T @ np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
        turns = (atan2(-r[1, 2], r[2, 2]), asin(max(-1.0, min(1.0, r[0, 2]))), atan2(-r[0, 1], r[0, 0]))
        return np.array([*place, *(_ROTATION_WEIGHT_M_RAD * turn for turn in turns)])

    def pose(self, at: Array) -> Pose:
        """The pose of the TCP in the base frame."""
        x, y, z, *_ = pose_trans(self._frame, (*at[:3], 0.0, 0.0, 0.0))
        r = self._rotation @ _turn_matrix(*(at[3:] / _ROTATION_WEIGHT_M_RAD))
        return (x, y, z, *matrix_to_rotvec(r.ravel().tolist()))

    def velocity(self, at: Array, rate: Array) -> Array:
        """Velocity of the TCP (6,), linear and angular, along base axes, for a rate of the coordinates."""
        a, b, _ = at[3:] / _ROTATION_WEIGHT_M_RAD
        axes = np.array([[1.0, 0.0, sin(b)], [0.0, cos(a), -sin(a) * cos(b)], [0.0, sin(a), cos(a) * cos(b)]])
        rotation = np.array(rotvec_to_matrix(*self._frame[3:])).reshape(3, 3)
        return np.concatenate((rotation @ rate[:3], self._rotation @ axes @ (rate[3:] / _ROTATION_WEIGHT_M_RAD)))


class CoordinateLine:
    """A `ToolPath` that is straight in the coordinates of a task space, so it stays within the bounds."""

    def __init__(self, space: TaskSpace, start: Array, end: Array) -> None:
        self._space, self._start, self._displacement = space, start, end - start
        self.length_m = float(np.linalg.norm(self._displacement[:3]))
        self.turn_rad = float(np.linalg.norm(self._displacement[3:])) / _ROTATION_WEIGHT_M_RAD

    def pose(self, share: float) -> Pose:
        return self._space.pose(self._start + share * self._displacement)

    def motion(self, share: float) -> tuple[Array, Array]:
        at, step = self._start + share * self._displacement, _NUDGE * self._displacement
        ahead, behind = (self._space.velocity(at + sign * step, self._displacement) for sign in (1.0, -1.0))
        return self._space.velocity(at, self._displacement), (ahead - behind) / (2.0 * _NUDGE)


class TaskSpaceSearch:
    """Searches from a start to the goal configurations that are in the same kinematic branch as the start.

    any_turn: whether configurations that differ by whole turns of joints reach the goal, too.
    """

    def __init__(self, checker: ConstrainedChecker, start: Joints, goals: Sequence[Joints], any_turn: bool) -> None:
        self._checker = checker
        self._kinematics, model = checker.scene.kinematics, checker.scene.model
        tcp = checker.constraints.tcp_offset or ZERO6
        self._interpolator = CartesianInterpolator(model, self._kinematics, tcp)
        self._flange = pose_inv(tcp)
        self._start, self._branch = start, self._ik_branch(start)
        self._goals = [goal for goal in goals if self._ik_branch(goal) == self._branch]
        self._any_turn = any_turn
        self._space = TaskSpace(checker, [self._interpolator.pose(q) for q in (start, *self._goals)])

    def find(self, planner: str, limit_s: float, seed: int) -> PlannedSegment | None:
        """The motion to a goal, or None if none was found."""
        if not self._goals:
            return None
        start = self._space.coordinates(self._interpolator.pose(self._start))
        ends = [self._space.coordinates(self._interpolator.pose(q)) for q in self._goals]
        if self._space.around:
            ends += [end + sign * tau * _ROTATION_WEIGHT_M_RAD * np.eye(6)[5] for end in ends for sign in (1.0, -1.0)]
        ends = [end for end in ends if (end >= self._space.low - 1e-9).all() and (end <= self._space.high + 1e-9).all()]
        for end in sorted(ends, key=lambda end: float(np.linalg.norm(end - start))):
            if segments := self._interpolated([start, end]):
                return self._rounded(segments)
        bounds = list(zip(self._space.low, self._space.high, strict=True))
        until_s = time.perf_counter() + limit_s
        for attempt in range(_ATTEMPTS):  # a path may exceed the joint limits; another may not
            left_s = until_s - time.perf_counter()
            if left_s <= 0.0:
                break
            step = _RESOLUTIONS_M[min(attempt, len(_RESOLUTIONS_M) - 1)]
            path = solve(bounds, self._is_free, start, ends, planner, left_s, seed + attempt, step, _RANGE_M)
            if path is not None and (segments := self._interpolated(self._shortcut(path, Random(seed)))):
                return self._rounded(segments)
        return None

    def _ik_branch(self, q: Joints) -> tuple[bool, bool, bool]:
        """Shoulder, elbow and wrist: within one branch, the configuration is a continuous function of the pose."""
        x, y, *_ = pose_trans(
            self._kinematics.forward(q), (0.0, 0.0, -self._checker.scene.model.dh.d[5], 0.0, 0.0, 0.0)
        )
        return (cos(q[0]) * x + sin(q[0]) * y > 0.0, sin(q[2]) > 0.0, sin(q[4]) > 0.0)

    def _is_free(self, at: Array) -> bool:
        flange = pose_trans(self._space.pose(at), self._flange)
        solutions = self._kinematics.inverse_all(flange)
        return any(self._ik_branch(q) == self._branch and self._checker.is_free(q) for q in solutions)

    def _interpolated(self, path: Sequence[Array]) -> list[PlannedSegment]:
        """The joint motions along a path; empty if a joint cannot follow, collides, or ends at another turn."""
        q, segments = self._start, list[PlannedSegment]()
        for one, other in pairwise(path):
            found = self._interpolator.interpolate(CoordinateLine(self._space, one, other), q)
            if found.stopped_by:
                return []
            if found.path is None:
                continue
            if first_collision(self._checker, found.path) is not None:
                return []
            coefficients = found.path.coefficients.copy()
            coefficients[:, :, 6:] = 0.0  # the tool has no limits here
            curve = PiecewisePath(coefficients, found.path.sizes, 4)
            segments.append(PlannedSegment(curve, (q, found.q_end), self._interpolator.pose))
            q = found.q_end
        arrived = self._any_turn or any(np.allclose(q, goal, atol=1e-6) for goal in self._goals)
        return segments if arrived else []

    def _shortcut(self, path: list[Array], random: Random) -> list[Array]:
        """Remove corners that the tool can bypass on a straight path."""
        for _ in range(_SHORTCUT_ATTEMPTS):
            if len(path) < 3:
                break
            i, j = sorted(random.sample(range(len(path)), 2))
            looks = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(path[j] - path[i]) / _RESOLUTIONS_M[0]))
            if j - i > 1 and all(self._is_free(path[i] + share * (path[j] - path[i])) for share in looks):
                del path[i + 1 : j]
        return path

    def _rounded(self, segments: Sequence[PlannedSegment]) -> PlannedSegment | None:
        """Blend the motions, with radii as large as constraints and obstacles allow; None if a corner allows none."""
        assert segments[0].path is not None
        done: list[PiecewisePath] = []
        last = segments[0].path
        for before, after in pairwise(segments):
            radius = _MAX_BLEND_M
            for _ in range(_BLENDS):
                assert after.path is not None
                try:
                    one, between, other = blend(last, after.path, before, radius, 1)
                except PlanningError:  # the radius is too large for the motions
                    radius *= 0.5
                    continue
                if first_collision(self._checker, between) is None:
                    break
                radius *= 0.5
            else:
                return None
            done += (one, between)
            last = other
        waypoints = (segments[0].waypoints[0], *(segment.waypoints[-1] for segment in segments))
        return PlannedSegment(concatenate([*done, last]), waypoints, self._interpolator.pose)


def _turn_matrix(a: float, b: float, c: float) -> Array:
    """Rx(a) Ry(b) Rz(c)."""
    sa, ca, sb, cb, sc, cc = sin(a), cos(a), sin(b), cos(b), sin(c), cos(c)
    return np.array(
        [
            [cb * cc, -cb * sc, sb],
            [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
            [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
        ]
    )
