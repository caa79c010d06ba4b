"""Straight lines and arcs of the TCP, and the joint-space paths that follow them.

Inverse kinematics is solved at steps along the TCP's path. Between two of them, the joints move on the quintic
polynomial that has their positions, speeds and accelerations at both ends. A step is halved until the TCP is also
where it should be in the middle of the step. The robot executes these same polynomials, so the TCP is on the line
everywhere and not only at samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, atan2, hypot, sin, tau
from typing import Final, Protocol

import numpy as np

from client.errors import PlanningError
from client.planning.parameterisation import Array
from client.planning.path import PiecewisePath, hermite
from urproto.robots import Joints, Kinematics, RobotModel
from urproto.robots.pose import Pose, interpolate_pose, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import Vector3, as_six

COLUMNS: Final = 8
"""Columns of such a path: the joints [rad], then the distance [m] and rotation [rad] of the TCP since its start."""

STEP_M: Final = 0.02
TURN_RAD_M: Final = 3.5
"""How rotation compares with distance, as in MoveIt's MaxEEFStep: 2 degrees count as 1 cm."""

_TOLERANCE_M: Final = 2e-5  # guess: a tenth of the arms' repeatability; MoveIt 2 allows 1 mm (CartesianPrecision)
_TOLERANCE_RAD: Final = 2e-4
_MIN_STEP: Final = 1e-5  # smallest step as a share of the line, as CartesianPrecision
_NUDGE: Final = 1e-5  # step of the finite difference of the Jacobian [rad]
_GRIDPOINTS: Final = 4
_RADIUS_TOLERANCE_M: Final = 0.01  # between the distances of start and goal from an arc's centre, as in Pilz' planner
_COLLINEAR: Final = 1e-5  # sine of the angle, as in Pilz' planner
_SINGULAR: Final = 0.05  # below this, a singularity is given as the reason that a line ends (guess)


class ToolPath(Protocol):
    """A path of the TCP, as a function of the share covered, 0 to 1. length_m, turn_rad: of the whole path."""

    length_m: float
    turn_rad: float

    def pose(self, share: float) -> Pose:
        """The pose of the TCP in the base frame."""

    def motion(self, share: float) -> tuple[Array, Array]:
        """First and second derivative by the share: (6,) each, linear and angular, along base axes."""


class StraightLine:
    """A straight line from one pose to another, with uniform rotation about one axis."""

    def __init__(self, start: Sequence[float], goal: Sequence[float]) -> None:
        self._start, self._goal = start, goal
        self._displacement = np.array(goal[:3], dtype=float) - np.array(start[:3], dtype=float)
        self._turn = _turn(start, goal)
        self.length_m = float(np.linalg.norm(self._displacement))
        self.turn_rad = float(np.linalg.norm(self._turn))

    def pose(self, share: float) -> Pose:
        return interpolate_pose(self._start, self._goal, share)

    def motion(self, share: float) -> tuple[Array, Array]:
        return np.concatenate((self._displacement, self._turn)), np.zeros(6)


class Arc:
    """An arc about a centre by an angle [rad] about its axis, with uniform rotation to the goal's orientation."""

    def __init__(
        self, start: Sequence[float], goal: Sequence[float], center: Array, axis: Array, angle_rad: float
    ) -> None:
        self._orientation = StraightLine((*center, *start[3:]), (*center, *goal[3:]))  # only its orientations are used
        self._out = np.array(start[:3], dtype=float) - center
        self._across = np.cross(axis, self._out)
        self._center, self._angle = center, angle_rad
        self.radius_m = float(np.linalg.norm(self._out))
        self.length_m = self.radius_m * angle_rad
        self.turn_rad = self._orientation.turn_rad

    def pose(self, share: float) -> Pose:
        angle = self._angle * share
        x, y, z = self._center + np.cos(angle) * self._out + np.sin(angle) * self._across
        return (float(x), float(y), float(z), *self._orientation.pose(share)[3:])

    def motion(self, share: float) -> tuple[Array, Array]:
        angle = self._angle * share
        velocity, acceleration = self._orientation.motion(share)
        velocity[:3] = self._angle * (np.cos(angle) * self._across - np.sin(angle) * self._out)
        acceleration[:3] = -(self._angle**2) * (np.cos(angle) * self._out + np.sin(angle) * self._across)
        return velocity, acceleration


def arc_through(start: Sequence[float], interim: Vector3, goal: Sequence[float]) -> Arc:
    """The arc from start through an interim point to goal. Raises PlanningError for collinear points."""
    a, b, c = (np.array(point[:3], dtype=float) for point in (start, interim, goal))
    u, v = b - a, c - a
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size <= _COLLINEAR * float(np.linalg.norm(u)) * float(np.linalg.norm(v)) or size == 0.0:
        raise PlanningError("CIRC: start, interim point and goal are collinear, or two of them coincide: use LIN")
    center = a + (float(u @ u) * np.cross(v, normal) + float(v @ v) * np.cross(normal, u)) / (2.0 * size**2)
    axis = normal / size  # start, interim point and goal follow each other counter-clockwise about it
    out, end = a - center, c - center
    angle = atan2(float(axis @ np.cross(out, end)), float(out @ end)) % tau
    return Arc(start, goal, center, axis, angle)


def arc_about(start: Sequence[float], center: Vector3, goal: Sequence[float]) -> Arc:
    """The shorter arc from start to goal about a centre. Raises PlanningError if there is none, or more than one."""
    a, middle, c = (np.array(point[:3], dtype=float) for point in (start, center, goal))
    chord = c - a
    out, end = a - middle, c - middle
    radii = float(np.linalg.norm(out)), float(np.linalg.norm(end))
    if abs(radii[0] - radii[1]) > _RADIUS_TOLERANCE_M:
        raise PlanningError(
            f"CIRC: the centre is {radii[0]:.4f} m from the start and {radii[1]:.4f} m from the goal: no circle about "
            "it passes through both"
        )
    axis = np.cross(out, end)
    size = float(np.linalg.norm(axis))
    if size <= _COLLINEAR * radii[0] * radii[1] or size == 0.0:
        raise PlanningError(
            "CIRC: start, centre and goal are collinear, which leaves the plane undefined: give an interim point"
        )
    middle = middle + chord * float((0.5 * (a + c) - middle) @ chord) / float(chord @ chord)  # equally far from both
    out, end = a - middle, c - middle
    angle = acos(max(-1.0, min(1.0, float(out @ end) / float(np.linalg.norm(out) * np.linalg.norm(end)))))
    return Arc(start, goal, middle, axis / size, angle)


@dataclass(frozen=True, slots=True)
class Interpolation:
    """The joint-space path (of `COLUMNS`) that follows a TCP path, as far as possible.

    path: None if there is no step at all. q_end: the configuration where it ends. shares: of the TCP path, at the end
    of each piece. stopped_by: why it does not reach the end, "" if it does.
    """

    path: PiecewisePath | None
    q_end: Joints
    shares: tuple[float, ...] = ()
    stopped_by: str = ""

    @property
    def reached(self) -> float:
        """The share of the TCP path that is covered."""
        return self.shares[-1] if self.shares else 0.0


class CartesianInterpolator:
    """Follows paths of one TCP of one arm."""

    def __init__(self, model: RobotModel, kinematics: Kinematics, tcp_offset: Sequence[float]) -> None:
        self._model = model
        self._kinematics = kinematics
        self._tcp = tuple(map(float, tcp_offset))
        self._flange = pose_inv(self._tcp)

    def pose(self, q_rad: Sequence[float]) -> Pose:
        return self._kinematics.forward(q_rad, self._tcp)

    def interpolate(self, tool_path: ToolPath, start_rad: Joints, step_m: float = STEP_M) -> Interpolation:
        """Follow a path of the TCP with the joints, from the configuration in which the TCP is at its start."""
        size = max(tool_path.length_m, tool_path.turn_rad / TURN_RAD_M)
        if size < 1e-9:
            return Interpolation(None, start_rad, (1.0,))
        coarsest = min(1.0, step_m / size)
        pieces: list[Array] = []
        shares = [0.0]
        q, begin = start_rad, self._knot(tool_path, 0.0, start_rad)
        if begin is None:
            return Interpolation(None, start_rad, stopped_by=self._reason(tool_path, 0.0, start_rad))
        step = coarsest
        while shares[-1] < 1.0:
            next_share = min(1.0, shares[-1] + step)
            if 1.0 - next_share < 0.01 * step:  # leave no tiny step for the end
                next_share = 1.0
            after = self._inverse(tool_path, next_share, q)
            end = None if after is None else self._knot(tool_path, next_share, after)
            piece = None if end is None else hermite(begin, end, next_share - shares[-1])
            if piece is None or not self._is_accurate(tool_path, shares[-1], next_share, piece):
                step *= 0.5
                if step < _MIN_STEP:
                    break
                continue
            assert after is not None
            assert end is not None
            pieces.append(piece)
            shares.append(next_share)
            q, begin, step = after, end, min(coarsest, 2.0 * step)
        path = PiecewisePath(np.array(pieces), np.diff(shares).tolist(), _GRIDPOINTS) if pieces else None
        reason = "" if shares[-1] >= 1.0 else self._reason(tool_path, min(1.0, shares[-1] + 2.0 * _MIN_STEP), q)
        return Interpolation(path, q, tuple(shares[1:]), reason)

    def _inverse(self, tool_path: ToolPath, share: float, q_near: Joints) -> Joints | None:
        low, high = self._model.position_limits
        return self._kinematics.inverse_near(pose_trans(tool_path.pose(share), self._flange), q_near, low, high)

    def _knot(self, tool_path: ToolPath, share: float, q: Joints) -> tuple[Array, Array, Array] | None:
        """All columns with their first and second derivatives by the share; None in a singular configuration."""
        velocity, acceleration = tool_path.motion(share)
        jacobian = self._jacobian(q)
        try:
            rate = np.linalg.solve(jacobian, velocity)
            fast = float(abs(rate).max())
            nudge = _NUDGE * rate / fast if fast else np.zeros(6)
            change = (self._jacobian(np.add(q, nudge)) - self._jacobian(np.subtract(q, nudge))) * (
                fast / (2.0 * _NUDGE)
            )
            gain = np.linalg.solve(jacobian, acceleration - change @ rate)
        except np.linalg.LinAlgError:
            return None
        return (
            np.array([*q, share * tool_path.length_m, share * tool_path.turn_rad]),
            np.array([*rate, tool_path.length_m, tool_path.turn_rad]),
            np.array([*gain, 0.0, 0.0]),
        )

    def _jacobian(self, q: Sequence[float] | Array) -> Array:
        return np.array(self._kinematics.jacobian(as_six(q), self._tcp))

    def _is_accurate(self, tool_path: ToolPath, low: float, high: float, piece: Array) -> bool:
        q = (0.5 * (high - low)) ** np.arange(6) @ piece
        is_at, wanted = self.pose(q[:6].tolist()), tool_path.pose(0.5 * (low + high))
        off = float(np.linalg.norm(np.subtract(is_at[:3], wanted[:3])))
        return off < _TOLERANCE_M and float(np.linalg.norm(_turn(is_at, wanted))) < _TOLERANCE_RAD

    def _reason(self, tool_path: ToolPath, share: float, q: Joints) -> str:
        """Why the arm cannot take the step to this share."""
        pose = tool_path.pose(share)
        flange = pose_trans(pose, self._flange)
        if not self._kinematics.inverse_all(flange, q):
            where = f"p[{', '.join(f'{value:.4f}' for value in pose)}]"
            offset_m, least = self._distance_from_base_axis(flange), abs(self._model.dh.d[3])
            if offset_m < least:
                return (
                    f"{where} would bring the wrist to {1000 * offset_m:.0f} mm from the base's axis, and it cannot "
                    f"come nearer than {1000 * least:.0f} mm: go around the base, with CIRC or PTP"
                )
            return f"{where} is out of the reach of a {self._model.title}"
        if self._inverse(tool_path, share, q) is None:
            return "a joint would be beyond its limits; begin in another configuration"
        return (
            f"{self._singularity(q)}: the joints would have to jump there; begin in another configuration, or use PTP"
        )

    def _distance_from_base_axis(self, flange: Pose) -> float:
        """Distance [m] from the base's axis to the point where the axes of joints 5 and 6 cross."""
        x, y, *_ = pose_trans(flange, (0.0, 0.0, -self._model.dh.d[5], 0.0, 0.0, 0.0))
        return hypot(x, y)

    def _singularity(self, q: Joints) -> str:
        """The nearest singularity, by the factors of the Jacobian's determinant."""
        offset_m = self._distance_from_base_axis(self._kinematics.forward(q))
        found = {
            f"wrist singularity (wrist 2 at {q[4]:.3f} rad)": abs(sin(q[4])),
            f"elbow singularity (elbow at {q[2]:.3f} rad)": abs(sin(q[2])),
            f"shoulder singularity (the wrist is {1000 * offset_m:.0f} mm from the base's axis)": (
                abs(offset_m - abs(self._model.dh.d[3])) / self._model.reach_m
            ),
        }
        name = min(found, key=found.__getitem__)
        return f"the arm reaches its {name}" if found[name] < _SINGULAR else f"the arm is near its {name}"


def _turn(start: Sequence[float], goal: Sequence[float]) -> Array:
    """The rotation vector from one orientation to another, in base axes."""
    relative = pose_trans(pose_inv((0.0, 0.0, 0.0, *start[3:])), (0.0, 0.0, 0.0, *goal[3:]))
    turned: Array = np.array(rotvec_to_matrix(*start[3:])).reshape(3, 3) @ np.array(relative[3:])
    return turned
