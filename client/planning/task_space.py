"""Ways on which the tool keeps to constraints: looked for among its poses rather than among joint angles.

The poses that keep to an orientation within tolerances and to a box are a box themselves, in the right coordinates:
the TCP's place along the edges of the one, and its turns from the other. OMPL searches that box, where nothing needs to
be rejected or projected; joint angles follow in the posture that the arm begins with.
"""

import time
from collections.abc import Sequence
from itertools import pairwise
from math import asin, atan2, cos, hypot, pi, sin, tau
from random import Random
from typing import Final

import numpy as np

from client.errors import PlanningError
from client.planning.constraints import ConstrainedChecker
from client.planning.industrial import Segment, blend, first_collision
from client.planning.lines import CartesianInterpolator
from client.planning.parameterisation import Array
from client.planning.path import PiecewisePath, concatenate
from client.planning.search import solve
from urproto.robots import Joints
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import ZERO6

_ROTATION_WEIGHT_M_RAD: Final = 0.2  # what a turn counts beside a path (guess)
_RANGE_M: Final = 0.2  # of a tree's step (guess)
_RESOLUTIONS_M: Final = (0.02, 0.01)  # between looks at a path
_INNER: Final = 0.9  # of the tolerances: corners are cut inside of them
_SHORTCUT_ATTEMPTS: Final = 12
_ATTEMPTS: Final = 4
_BLENDS: Final = 8  # halvings
_LARGEST_BLEND_M: Final = 0.1
_NUDGE: Final = 1e-5


class TaskSpace:
    """The poses that keep to a checker's constraints, as (6,) coordinates within ``low`` and ``high``."""

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
        self.around = turns[2] >= pi - 1e-6  # z turns freely, also beyond pi
        if self.around:
            self.low[5], self.high[5] = -tau * _ROTATION_WEIGHT_M_RAD, tau * _ROTATION_WEIGHT_M_RAD

    def coordinates(self, pose: Pose) -> Array:
        """Of a pose of the TCP."""
        place = pose_trans(pose_inv(self._frame), pose)[:3]
        r = self._rotation.T @ np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
        turns = (atan2(-r[1, 2], r[2, 2]), asin(max(-1.0, min(1.0, r[0, 2]))), atan2(-r[0, 1], r[0, 0]))
        return np.array([*place, *(_ROTATION_WEIGHT_M_RAD * turn for turn in turns)])

    def pose(self, at: Array) -> Pose:
        """Of the TCP in the base frame."""
        x, y, z, *_ = pose_trans(self._frame, (*at[:3], 0.0, 0.0, 0.0))
        r = self._rotation @ _turn_matrix(*(at[3:] / _ROTATION_WEIGHT_M_RAD))
        return (x, y, z, *matrix_to_rotvec(r.ravel().tolist()))

    def velocity(self, at: Array, rate: Array) -> Array:
        """Of the TCP (6,), linear and angular, in base axes, when the coordinates change so fast."""
        a, b, _ = at[3:] / _ROTATION_WEIGHT_M_RAD
        axes = np.array([[1.0, 0.0, sin(b)], [0.0, cos(a), -sin(a) * cos(b)], [0.0, sin(a), cos(a) * cos(b)]])
        rotation = np.array(rotvec_to_matrix(*self._frame[3:])).reshape(3, 3)
        return np.concatenate((rotation @ rate[:3], self._rotation @ axes @ (rate[3:] / _ROTATION_WEIGHT_M_RAD)))


class CoordinateLine:
    """A `ToolPath` straight in the coordinates of a space, which keeps to its bounds."""

    def __init__(self, space: TaskSpace, start: Array, end: Array) -> None:
        self._space, self._start, self._displacement = space, start, end - start
        self.length_m = float(np.linalg.norm(self._displacement[:3]))
        self.turn_rad = float(np.linalg.norm(self._displacement[3:])) / _ROTATION_WEIGHT_M_RAD

    def pose(self, share: float) -> Pose:
        """See `ToolPath`."""
        return self._space.pose(self._start + share * self._displacement)

    def motion(self, share: float) -> tuple[Array, Array]:
        """See `ToolPath`."""
        at, step = self._start + share * self._displacement, _NUDGE * self._displacement
        ahead, behind = (self._space.velocity(at + sign * step, self._displacement) for sign in (1.0, -1.0))
        return self._space.velocity(at, self._displacement), (ahead - behind) / (2.0 * _NUDGE)


class TaskSpaceSearch:
    """For one start and the joint angles that reach the goal, of which those in the start's posture count.

    any_turn: whether whole turns of joints more or less reach the goal as well.
    """

    def __init__(self, checker: ConstrainedChecker, start: Joints, goals: Sequence[Joints], any_turn: bool) -> None:
        self._checker = checker
        self._kinematics, model = checker.scene.kinematics, checker.scene.model
        tcp = checker.constraints.tcp_offset or ZERO6
        self._interpolator = CartesianInterpolator(model, self._kinematics, tcp)
        self._flange = pose_inv(tcp)
        self._start, self._branch = start, self._branch_of(start)
        self._goals = [goal for goal in goals if self._branch_of(goal) == self._branch]
        self._any_turn = any_turn
        self._space = TaskSpace(checker, [self._interpolator.pose(q) for q in (start, *self._goals)])

    def find(self, planner: str, limit_s: float, seed: int) -> Segment | None:
        """The path, None without one."""
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
        for attempt in range(_ATTEMPTS):  # what was found may lead beyond the joints' limits, another path may not
            left_s = until_s - time.perf_counter()
            if left_s <= 0.0:
                break
            step = _RESOLUTIONS_M[min(attempt, len(_RESOLUTIONS_M) - 1)]
            path = solve(bounds, self._is_free, start, ends, planner, left_s, seed + attempt, step, _RANGE_M)
            if path is not None and (segments := self._interpolated(self._shortcut(path, Random(seed)))):
                return self._rounded(segments)
        return None

    def _branch_of(self, q: Joints) -> tuple[bool, bool, bool]:
        """Shoulder, elbow and wrist: within one of these, joint angles go with the pose without jumps."""
        x, y, *_ = pose_trans(
            self._kinematics.forward(q), (0.0, 0.0, -self._checker.scene.model.dh.d[5], 0.0, 0.0, 0.0)
        )
        return (cos(q[0]) * x + sin(q[0]) * y > 0.0, sin(q[2]) > 0.0, sin(q[4]) > 0.0)

    def _is_free(self, at: Array) -> bool:
        flange = pose_trans(self._space.pose(at), self._flange)
        reaching = self._kinematics.inverse_all(flange)
        return any(self._branch_of(q) == self._branch and self._checker.is_free(q) for q in reaching)

    def _interpolated(self, path: Sequence[Array]) -> list[Segment]:
        """The joints' motions along it; none where they cannot follow, touch something, or arrive rotation otherwise."""
        q, segments = self._start, list[Segment]()
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
            segments.append(Segment(curve, (q, found.q_end), self._interpolator.pose))
            q = found.q_end
        arrived = self._any_turn or any(np.allclose(q, goal, atol=1e-6) for goal in self._goals)
        return segments if arrived else []

    def _shortcut(self, path: list[Array], random: Random) -> list[Array]:
        """Corners are left out where the tool may go straight past them."""
        for _ in range(_SHORTCUT_ATTEMPTS):
            if len(path) < 3:
                break
            i, j = sorted(random.sample(range(len(path)), 2))
            looks = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(path[j] - path[i]) / _RESOLUTIONS_M[0]))
            if j - i > 1 and all(self._is_free(path[i] + share * (path[j] - path[i])) for share in looks):
                del path[i + 1 : j]
        return path

    def _rounded(self, segments: Sequence[Segment]) -> Segment | None:
        """Without stops: each corner as round as constraints and things around allow; None where they allow none."""
        assert segments[0].path is not None
        done: list[PiecewisePath] = []
        last = segments[0].path
        for before, after in pairwise(segments):
            radius = _LARGEST_BLEND_M
            for _ in range(_BLENDS):
                assert after.path is not None
                try:
                    one, between, other = blend(last, after.path, before, radius, 1)
                except PlanningError:  # larger than what the motions leave
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
        return Segment(concatenate([*done, last]), waypoints, self._interpolator.pose)


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
