"""The arm as the generators see it: its limits, and conversions between joints and tool poses."""

from collections.abc import Sequence
from math import cos, inf, sin
from operator import mul
from typing import Final

from emulator.motion.faults import MotionFault, Singularity, path_out_of_reach, unreachable
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import DH, Joints, RobotModel
from urproto.robots.pose import Pose, pose_inv, pose_sub, pose_trans
from urproto.vectors import ZERO6, as_six

_SINGULAR: Final = 1e-3  # of distance_to_singularity(): an arm this near to one is in it (guess)
# Damps a step in a direction in which the joints move the tool by less than this [m/rad, rad/rad] (guess).
_DAMPING = 0.05
_NO_LIMITS: Joints = (inf, inf, inf, inf, inf, inf)
_NO_LIMITS_BELOW: Joints = (-inf, -inf, -inf, -inf, -inf, -inf)


def dexterity(dh: DH, q_rad: Joints) -> float:
    """Square of the Jacobian's determinant, from its three factors: the controller's "dexterity" of the robot.

    Confirmed by captures of a UR5e and a UR3e simulator and of a UR10, which agree with it to all digits.
    """
    factor = dh.a[1] * dh.a[2] * sin(q_rad[2]) * sin(q_rad[4]) * _outward(dh, q_rad)
    return factor * factor


def distance_to_singularity(dh: DH, q_rad: Joints) -> float:
    """Distance from 0 in a singularity to 1 far from all: the smallest of three factors of the Jacobian's determinant.

    Elbow: stretched or folded. Wrist: joints 4 and 6 parallel. Shoulder: the wrist is above the base joint's axis; its
    distance from there counts as a fraction of the length of the two long links.
    """
    return min(_distances(dh, q_rad).values())


def singularity(dh: DH, q_rad: Joints) -> Singularity | None:
    """The singularity that the arm is in, elbow and shoulder before the wrist; None if it is in none."""
    return next((kind for kind, distance in _distances(dh, q_rad).items() if distance < _SINGULAR), None)


def _distances(dh: DH, q_rad: Joints) -> dict[Singularity, float]:
    outward = _outward(dh, q_rad) / (abs(dh.a[1]) + abs(dh.a[2]))
    return {
        Singularity.ELBOW: abs(sin(q_rad[2])),
        Singularity.SHOULDER: abs(outward),
        Singularity.WRIST: abs(sin(q_rad[4])),
    }


def _outward(dh: DH, q_rad: Joints) -> float:
    """Distance of the wrist from the base joint's axis [m], in the arm's plane."""
    _, q2, q3, q4, _, _ = q_rad
    return dh.a[1] * cos(q2) + dh.a[2] * cos(q2 + q3) + dh.d[4] * sin(q2 + q3 + q4)


class Reach:
    """One arm with one TCP. A movement keeps the TCP with which it was planned."""

    def __init__(self, model: RobotModel, kinematics: Kinematics, tcp_offset: Pose) -> None:
        self.model = model
        self.kinematics = kinematics
        self.tcp_offset = tcp_offset
        self._tcp_inverse = pose_inv(tcp_offset)

    def pose(self, q_rad: Joints) -> Pose:
        """TCP in the base frame."""
        return self.kinematics.forward(q_rad, self.tcp_offset)

    def joints(self, pose_base_tcp: Pose, q_near_rad: Joints) -> Joints:
        """The joint configuration for a TCP pose that continues q_near. Raises MotionFault if out of reach.

        Position limits are not considered: a path is followed by continuity, and the limits are checked every step.
        """
        flange = pose_base_tcp if self.tcp_offset == ZERO6 else pose_trans(pose_base_tcp, self._tcp_inverse)
        q = self.kinematics.inverse_near(flange, q_near_rad, _NO_LIMITS_BELOW, _NO_LIMITS)
        if q is None:
            raise unreachable(pose_base_tcp)
        return q

    def follow(self, pose_base_tcp: Pose, q_near_rad: Joints) -> Joints:
        """As `joints`, for a pose on a path that has begun: the fault says that the path leaves the workspace."""
        try:
            return self.joints(pose_base_tcp, q_near_rad)
        except MotionFault:
            raise path_out_of_reach(pose_base_tcp) from None

    def step_towards(self, pose_base_tcp: Pose, q_rad: Joints) -> Joints:
        """Joint displacement [rad] that moves the TCP towards a nearby pose; it stays small near a singularity."""
        rows = self.kinematics.jacobian(q_rad, self.tcp_offset)
        change = pose_sub(pose_base_tcp, self.pose(q_rad))
        squares = [[sum(map(mul, one, other)) for other in rows] for one in rows]
        for i in range(6):
            squares[i][i] += _DAMPING**2
        weights = _solve(squares, change)
        return as_six(sum(map(mul, column, weights)) for column in zip(*rows, strict=True))

    def twist(self, q_rad: Joints, qd_rad_s: Joints) -> Joints:
        """TCP velocity in the base frame: m/s, rad/s."""
        rows = self.kinematics.jacobian(q_rad, self.tcp_offset)
        return as_six(sum(map(mul, row, qd_rad_s)) for row in rows)


def _solve(matrix: Sequence[Sequence[float]], right: Sequence[float]) -> list[float]:
    """x of matrix x = right, by elimination; the matrix is symmetric and positive definite."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i, pivot in enumerate(rows):
        for row in rows:
            if row is not pivot:
                factor = row[i] / pivot[i]
                for k in range(i + 1, len(row)):
                    row[k] -= factor * pivot[k]
    return [row[-1] / row[i] for i, row in enumerate(rows)]
