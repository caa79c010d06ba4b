"""Straight lines and arcs of the TCP, and the joint angles that follow them.

The way of the TCP is looked at in steps; between two of them the joints move on the polynomial of fifth degree that has
their positions, speeds and accelerations at both ends. A step is halved until the TCP is where it should be half way,
too: the same polynomials are what the arm gets, so that it is on the line and not only its samples are.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, atan2, hypot, isfinite, sin, tau
from typing import Final, Protocol

import numpy as np

from client.errors import PlanningError
from client.planning.path import PiecewisePath, hermite
from client.planning.timing import Array
from urproto.robots import Joints, Kinematics, RobotModel
from urproto.robots.pose import Pose, interpolate_pose, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import Vector3

COLUMNS: Final = 8
"""Of such a path: the joints [rad], the way of the TCP [m] and how far it has turned [rad] since the beginning."""

STEP_M: Final = 0.02
TURN_RAD_M: Final = 3.5
"""Turns count like ways by this, as in MoveIt's MaxEEFStep: 1 cm is 2 degrees."""

_OFF_M: Final = 2e-5  # guess: a tenth of the arms' repeatability; MoveIt 2 lets 1 mm pass (CartesianPrecision)
_OFF_RAD: Final = 2e-4
_FINEST: Final = 1e-5  # of a line, as CartesianPrecision
_NUDGE: Final = 1e-5  # of the way, between the Jacobians whose difference is its derivative
_PARTS: Final = 4
_RADII_M: Final = 0.01  # between the distances of start and goal from an arc's centre, as Pilz' planner
_COLLINEAR: Final = 1e-5  # sine, likewise
_SINGULAR: Final = 0.05  # a joint's sine, or its share of the arm, that explains why a line ends (guess)


class ToolPath(Protocol):
    """Where the TCP is at each share of its way, 0 to 1. length_m, turn_rad: the whole."""

    length_m: float
    turn_rad: float

    def pose(self, share: float) -> Pose:
        """Of the TCP in the base frame."""

    def motion(self, share: float) -> tuple[Array, Array]:
        """Velocity and acceleration (6,), linear and angular, in base axes, by the share."""


class Line:
    """From one pose straight to another, turning evenly about one axis."""

    def __init__(self, start: Sequence[float], goal: Sequence[float]) -> None:
        self._start, self._goal = start, goal
        self._way = np.array(goal[:3], dtype=float) - np.array(start[:3], dtype=float)
        self._turn = _turn(start, goal)
        self.length_m = float(np.linalg.norm(self._way))
        self.turn_rad = float(np.linalg.norm(self._turn))

    def pose(self, share: float) -> Pose:
        """See `ToolPath`."""
        return interpolate_pose(self._start, self._goal, share)

    def motion(self, share: float) -> tuple[Array, Array]:
        """See `ToolPath`."""
        return np.concatenate((self._way, self._turn)), np.zeros(6)


class Arc:
    """On a circle about a centre by an angle [rad] about its axis, turning evenly to the goal's orientation."""

    def __init__(
        self, start: Sequence[float], goal: Sequence[float], center: Array, axis: Array, angle_rad: float
    ) -> None:
        self._turned = Line((*center, *start[3:]), (*center, *goal[3:]))  # its poses' orientations
        self._out = np.array(start[:3], dtype=float) - center
        self._across = np.cross(axis, self._out)
        self._center, self._angle = center, angle_rad
        self.radius_m = float(np.linalg.norm(self._out))
        self.length_m = self.radius_m * angle_rad
        self.turn_rad = self._turned.turn_rad

    def pose(self, share: float) -> Pose:
        """See `ToolPath`."""
        angle = self._angle * share
        x, y, z = self._center + np.cos(angle) * self._out + np.sin(angle) * self._across
        return (float(x), float(y), float(z), *self._turned.pose(share)[3:])

    def motion(self, share: float) -> tuple[Array, Array]:
        """See `ToolPath`."""
        angle = self._angle * share
        velocity, acceleration = self._turned.motion(share)
        velocity[:3] = self._angle * (np.cos(angle) * self._across - np.sin(angle) * self._out)
        acceleration[:3] = -(self._angle**2) * (np.cos(angle) * self._out + np.sin(angle) * self._across)
        return velocity, acceleration


def arc_through(start: Sequence[float], interim: Vector3, goal: Sequence[float]) -> Arc:
    """The arc from start over a point to goal. Raises PlanningError for points on one line."""
    a, b, c = (np.array(point[:3], dtype=float) for point in (start, interim, goal))
    u, v = b - a, c - a
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size <= _COLLINEAR * float(np.linalg.norm(u)) * float(np.linalg.norm(v)) or size == 0.0:
        raise PlanningError("CIRC: start, interim point and goal are on one line, or two of them are one: take LIN")
    center = a + (float(u @ u) * np.cross(v, normal) + float(v @ v) * np.cross(normal, u)) / (2.0 * size**2)
    axis = normal / size  # about which start, interim and goal follow each other
    out, end = a - center, c - center
    angle = atan2(float(axis @ np.cross(out, end)), float(out @ end)) % tau
    return Arc(start, goal, center, axis, angle)


def arc_about(start: Sequence[float], center: Vector3, goal: Sequence[float]) -> Arc:
    """The shorter arc from start to goal about a centre. Raises PlanningError where that is none or not one."""
    a, middle, c = (np.array(point[:3], dtype=float) for point in (start, center, goal))
    chord = c - a
    out, end = a - middle, c - middle
    radii = float(np.linalg.norm(out)), float(np.linalg.norm(end))
    if abs(radii[0] - radii[1]) > _RADII_M:
        raise PlanningError(
            f"CIRC: the centre is {radii[0]:.4f} m from the start and {radii[1]:.4f} m from the goal: no circle about "
            "it has both"
        )
    axis = np.cross(out, end)
    size = float(np.linalg.norm(axis))
    if size <= _COLLINEAR * radii[0] * radii[1] or size == 0.0:
        raise PlanningError("CIRC: start, centre and goal are on one line, so that the plane is open: give an interim")
    middle = middle + chord * float((0.5 * (a + c) - middle) @ chord) / float(chord @ chord)  # as far from both
    out, end = a - middle, c - middle
    angle = acos(max(-1.0, min(1.0, float(out @ end) / float(np.linalg.norm(out) * np.linalg.norm(end)))))
    return Arc(start, goal, middle, axis / size, angle)


@dataclass(frozen=True, slots=True)
class Followed:
    """How far joints follow a way: by a path of `COLUMNS`, None for no step at all; up to a share of the way.

    shares: of the way, at the end of each piece. stopped_by: why not to its end.
    """

    path: PiecewisePath | None
    q_end: Joints
    shares: tuple[float, ...] = ()
    stopped_by: str = ""

    @property
    def reached(self) -> float:
        """As a share of the way."""
        return self.shares[-1] if self.shares else 0.0


class Follower:
    """Of one arm with one TCP."""

    def __init__(self, model: RobotModel, kinematics: Kinematics, tcp_offset: Sequence[float]) -> None:
        if len(tcp_offset) != 6 or not all(map(isfinite, tcp_offset)):
            raise PlanningError(f"a TCP offset is six finite numbers, not {list(tcp_offset)}")
        self._model = model
        self._kinematics = kinematics
        self._tcp = tuple(map(float, tcp_offset))
        self._flange = pose_inv(self._tcp)

    def pose(self, q_rad: Sequence[float]) -> Pose:
        """Of the TCP."""
        return self._kinematics.forward(q_rad, self._tcp)

    def follow(self, way: ToolPath, start_rad: Joints, step_m: float = STEP_M) -> Followed:
        """The joints' way from here along a way of the TCP that begins here."""
        size = max(way.length_m, way.turn_rad / TURN_RAD_M)
        if size < 1e-9:
            return Followed(None, start_rad, (1.0,))
        coarsest = min(1.0, step_m / size)
        pieces: list[Array] = []
        shares = [0.0]
        q, begin = start_rad, self._knot(way, 0.0, start_rad)
        if begin is None:
            return Followed(None, start_rad, stopped_by=self._why(way, 0.0, start_rad))
        step = coarsest
        while shares[-1] < 1.0:
            there = min(1.0, shares[-1] + step)
            if 1.0 - there < 0.01 * step:  # no crumb at the end
                there = 1.0
            after = self._solved(way, there, q)
            end = None if after is None else self._knot(way, there, after)
            piece = None if end is None else hermite(begin, end, there - shares[-1])
            if piece is None or not self._is_on(way, shares[-1], there, piece):
                step *= 0.5
                if step < _FINEST:
                    break
                continue
            assert after is not None
            assert end is not None
            pieces.append(piece)
            shares.append(there)
            q, begin, step = after, end, min(coarsest, 2.0 * step)
        path = PiecewisePath(np.array(pieces), np.diff(shares).tolist(), _PARTS) if pieces else None
        why = "" if shares[-1] >= 1.0 else self._why(way, min(1.0, shares[-1] + 2.0 * _FINEST), q)
        return Followed(path, q, tuple(shares[1:]), why)

    def _solved(self, way: ToolPath, share: float, q_near: Joints) -> Joints | None:
        low, high = self._model.position_limits
        return self._kinematics.inverse_near(pose_trans(way.pose(share), self._flange), q_near, low, high)

    def _knot(self, way: ToolPath, share: float, q: Joints) -> tuple[Array, Array, Array] | None:
        """Columns and their first and second derivatives by the share; None at a singular arm."""
        velocity, acceleration = way.motion(share)
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
            np.array([*q, share * way.length_m, share * way.turn_rad]),
            np.array([*rate, way.length_m, way.turn_rad]),
            np.array([*gain, 0.0, 0.0]),
        )

    def _jacobian(self, q: Sequence[float] | Array) -> Array:
        a, b, c, d, e, f = (float(angle) for angle in q)
        return np.array(self._kinematics.jacobian((a, b, c, d, e, f), self._tcp))

    def _is_on(self, way: ToolPath, low: float, high: float, piece: Array) -> bool:
        q = (0.5 * (high - low)) ** np.arange(6) @ piece
        is_at, wanted = self.pose(q[:6].tolist()), way.pose(0.5 * (low + high))
        off = float(np.linalg.norm(np.subtract(is_at[:3], wanted[:3])))
        return off < _OFF_M and float(np.linalg.norm(_turn(is_at, wanted))) < _OFF_RAD

    def _why(self, way: ToolPath, share: float, q: Joints) -> str:
        """What is in the way of the step to this share."""
        pose = way.pose(share)
        flange = pose_trans(pose, self._flange)
        if not self._kinematics.inverse_all(flange, q):
            where = f"p[{', '.join(f'{value:.4f}' for value in pose)}]"
            beside, least = self._beside_base(flange), abs(self._model.dh.d[3])
            if beside < least:
                return (
                    f"{where} would bring the wrist {1000 * beside:.0f} mm near to the base's axis, and it cannot come "
                    f"nearer than {1000 * least:.0f} mm: go around the base, by CIRC or PTP"
                )
            return f"{where} is out of the reach of a {self._model.title}"
        if self._solved(way, share, q) is None:
            return "a joint would be beyond its limits; begin in another posture"
        return f"{self._singularity(q)}: the joints would have to jump there; begin in another posture, or take PTP"

    def _beside_base(self, flange: Pose) -> float:
        """How far from the base's axis the axes of joints 5 and 6 cross [m]."""
        x, y, *_ = pose_trans(flange, (0.0, 0.0, -self._model.dh.d[5], 0.0, 0.0, 0.0))
        return hypot(x, y)

    def _singularity(self, q: Joints) -> str:
        """Which one the arm is nearest to, by what makes the Jacobian's determinant zero."""
        beside = self._beside_base(self._kinematics.forward(q))
        found = {
            f"wrist singularity (wrist 2 at {q[4]:.3f} rad)": abs(sin(q[4])),
            f"elbow singularity (elbow at {q[2]:.3f} rad)": abs(sin(q[2])),
            f"shoulder singularity (the wrist is {1000 * beside:.0f} mm from the base's axis)": (
                abs(beside - abs(self._model.dh.d[3])) / self._model.reach_m
            ),
        }
        name = min(found, key=found.__getitem__)
        return f"the arm meets its {name}" if found[name] < _SINGULAR else f"the arm is near its {name}"


def _turn(start: Sequence[float], goal: Sequence[float]) -> Array:
    """The rotation vector from one orientation to another, in base axes."""
    relative = pose_trans(pose_inv((0.0, 0.0, 0.0, *start[3:])), (0.0, 0.0, 0.0, *goal[3:]))
    turned: Array = np.array(rotvec_to_matrix(*start[3:])).reshape(3, 3) @ np.array(relative[3:])
    return turned
