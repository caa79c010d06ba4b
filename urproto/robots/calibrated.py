"""Kinematics of a calibrated arm, whose geometry deviates slightly from the shape that the closed form solves.

Forward kinematics follows the chain of ``urproto.robots.calibration``. Inverse kinematics starts from the joint angles
that the solution should be close to, or else from the closed-form solutions of the nominal arm. It continues with
Newton steps, damped by the square of the error (Levenberg), so that it also converges where the arm is singular. The
number of steps is limited.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import cos, dist, inf, sin, sqrt
from operator import mul
from typing import Final

from urproto.robots.calibration import chain_of
from urproto.robots.kinematics import Jacobian, Kinematics, unwind, wrap
from urproto.robots.model import DH, Joints, RobotModel
from urproto.robots.pose import matrix_to_rotvec, rotvec_to_matrix
from urproto.vectors import Matrix3, Vector3, times6

_CONVERGED: Final = 1e-10  # m and rad
_STEPS: Final = 12  # two or three are enough from a close start; singular configurations need more
# Within this many steps, the error falls to this fraction even near singularities, or it never will (guess).
_STALL_STEPS: Final = 3
_STALLED: Final = 0.7
_STEP_RAD: Final = 0.3  # maximum length of a step
_MAX_STEPS: Final = 80  # for a pose, all starts together
_MAX_STARTS: Final = 3  # when only the nearest solution is needed
_NEAR_RAD: Final = 0.1  # a solution this close to the given joint angles is accepted as the nearest one (guess)
# Where the closed form searches for starts: a pose just beyond the nominal arm's reach may be reachable (guess).
_SCALES: Final = (1.0, 0.99, 1.01)
_MAX_SHIFT_RAD: Final = 0.5  # how far Newton steps may lead away from the closed-form solution (guess)
_DISTINCT_RAD: Final = 1e-6
_EPSILON: Final = 1e-24  # a pivot below this is zero apart from rounding

_JointFrame = tuple[Vector3, Matrix3]


def kinematics_of(model: RobotModel) -> Kinematics:
    """The closed-form kinematics for a nominal arm, the slower `CalibratedKinematics` for a calibrated one."""
    return Kinematics(model.dh) if model.calibration is None else CalibratedKinematics(model.dh, model.calibration)


class CalibratedKinematics(Kinematics):
    """The kinematics of an arm with these parameters. nominal: those of its model. Raises CalibrationError for
    parameters that no arm can have."""

    def __init__(self, nominal: DH, calibrated: DH) -> None:
        super().__init__(nominal)
        self._chain = chain_of(calibrated)
        self._height = nominal.d[0]

    def flange_axes(self, q_rad: Sequence[float]) -> tuple[Vector3, Matrix3]:
        """As for a nominal arm."""
        return self._joint_frames(q_rad)[-1]

    def elbow_position(self, q_rad: Sequence[float], offset_m: float = 0.0) -> Vector3:
        """As for a nominal arm, from the origin of joint 3."""
        return _along_axis(self._joint_frames(q_rad)[2], offset_m)

    def wrist_position(self, q_rad: Sequence[float], offset_m: float = 0.0) -> Vector3:
        """As for a nominal arm."""
        return _along_axis(self._joint_frames(q_rad)[3], offset_m - self._chain[3].position[2])

    def jacobian_at(self, q_rad: Sequence[float], pose_base_tcp: Sequence[float]) -> Jacobian:
        """As for a nominal arm."""
        return _jacobian(self._joint_frames(q_rad), pose_base_tcp)

    def twist_at(self, q_rad: Sequence[float], qd: Sequence[float], pose_base_tcp: Sequence[float]) -> Joints:
        """As for a nominal arm."""
        return times6(self.jacobian_at(q_rad, pose_base_tcp), qd)

    def joint_torques_at(
        self, q_rad: Sequence[float], wrench: Sequence[float], pose_base_tcp: Sequence[float]
    ) -> Joints:
        """As for a nominal arm."""
        return times6(tuple(zip(*self.jacobian_at(q_rad, pose_base_tcp), strict=True)), wrench)

    def inverse_all(self, pose_base_flange: Sequence[float], q_near: Sequence[float] | None = None) -> list[Joints]:
        """As for a nominal arm; in a singular configuration, one of the possible solutions."""
        found: list[Joints] = []
        for q in self._solutions(pose_base_flange, lambda starts: starts, q_near):
            if all(_max_difference(q, other) > _DISTINCT_RAD for other in found):
                a, b, c, d, e, f = map(wrap, q)
                found.append((a, b, c, d, e, f))
        return found

    def inverse_near(
        self,
        pose_base_flange: Sequence[float],
        q_near: Sequence[float],
        q_min: Sequence[float],
        q_max: Sequence[float],
    ) -> Joints | None:
        """As for a nominal arm."""
        best, _ = self._refine(q_near, pose_base_flange)
        best = None if best is None else unwind(best, q_near, q_min, q_max)
        least = inf if best is None else dist(best, q_near)
        if least < _NEAR_RAD:
            return best

        def nearest_first(starts: Iterable[Joints]) -> Iterator[Joints]:
            unwound = [unwind(start, q_near, q_min, q_max) for start in starts]
            for start in sorted(unwound, key=lambda q: dist(q, q_near))[:_MAX_STARTS]:
                if dist(start, q_near) < least + _MAX_SHIFT_RAD:
                    yield start

        for q in self._solutions(pose_base_flange, nearest_first, q_near):
            unwound = unwind(q, q_near, q_min, q_max)
            if dist(unwound, q_near) < least:
                best, least = unwound, dist(unwound, q_near)
        return best if least < inf else None

    def _solutions(
        self,
        flange: Sequence[float],
        chosen: Callable[[Iterable[Joints]], Iterable[Joints]],
        q_near: Sequence[float] | None,
    ) -> Iterator[Joints]:
        """Refine the chosen closed-form solutions with Newton steps, until the maximum number of steps is reached."""
        steps, found = _MAX_STEPS, False
        for share in _SCALES:
            x, y, z, *turn = flange
            scaled = (x * share, y * share, self._height + (z - self._height) * share, *turn)
            for start in chosen(super().inverse_all(scaled, q_near)):
                q, count = self._refine(start, flange, steps)
                steps -= count
                if q is not None:
                    found = True
                    yield q
            if found or steps <= 0:
                break

    def _refine(
        self, start: Sequence[float], flange: Sequence[float], steps: int = _STEPS
    ) -> tuple[Joints | None, int]:
        """Joint angles near the start that reach this pose (None if there are none), and the number of steps."""
        px, py, pz, rx, ry, rz = flange
        aim = rotvec_to_matrix(rx, ry, rz)
        a, b, c, d, e, f = start
        q: Joints = (a, b, c, d, e, f)
        sizes: list[float] = []
        for step in range(min(steps, _STEPS)):
            joint_frames = self._joint_frames(q)
            (x, y, z), axes = joint_frames[-1]
            error = (px - x, py - y, pz - z, *matrix_to_rotvec(_times_transposed(aim, axes)))
            sizes.append(max(map(abs, error)))
            if sizes[-1] < _CONVERGED:
                return q, step + 1
            if step > _STALL_STEPS and sizes[-1] > _STALLED * sizes[-1 - _STALL_STEPS]:
                return None, step + 1
            q = _newton_step(q, _jacobian(joint_frames, (x, y, z)), error)
        return None, _STEPS

    def _joint_frames(self, q_rad: Sequence[float]) -> list[_JointFrame]:
        """Origin and axes of each joint's frame, rotated by its angle, in the base frame."""
        x, y, z = 0.0, 0.0, 0.0
        a, b, c, d, e, f, g, h, i = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        joint_frames = []
        for ((u, v, w), (r, s, t, j, k, m, n, o, p)), angle in zip(self._chain, q_rad, strict=True):
            x, y, z = x + a * u + b * v + c * w, y + d * u + e * v + f * w, z + g * u + h * v + i * w
            sine, cosine = sin(angle), cos(angle)
            r, s = r * cosine + s * sine, s * cosine - r * sine
            j, k = j * cosine + k * sine, k * cosine - j * sine
            n, o = n * cosine + o * sine, o * cosine - n * sine
            a, b, c, d, e, f, g, h, i = (
                *(a * r + b * j + c * n, a * s + b * k + c * o, a * t + b * m + c * p),
                *(d * r + e * j + f * n, d * s + e * k + f * o, d * t + e * m + f * p),
                *(g * r + h * j + i * n, g * s + h * k + i * o, g * t + h * m + i * p),
            )
            joint_frames.append(((x, y, z), (a, b, c, d, e, f, g, h, i)))
        return joint_frames


def _along_axis(joint_frame: _JointFrame, distance_m: float) -> Vector3:
    (x, y, z), axes = joint_frame
    return (x + distance_m * axes[2], y + distance_m * axes[5], z + distance_m * axes[8])


def _jacobian(joint_frames: Sequence[_JointFrame], point: Sequence[float]) -> Jacobian:
    px, py, pz, *_ = point
    columns = []
    for (x, y, z), axes in joint_frames:
        u, v, w = axes[2], axes[5], axes[8]
        rx, ry, rz = px - x, py - y, pz - z
        columns.append((v * rz - w * ry, w * rx - u * rz, u * ry - v * rx, u, v, w))
    a, b, c, d, e, f = zip(*columns, strict=True)
    return (a, b, c, d, e, f)


def _newton_step(q: Joints, rows: Jacobian, error: Sequence[float]) -> Joints:
    """A damped Newton step: dq = Jt (J Jt + s I)^-1 e, with s = e.e."""
    damping = sum(map(mul, error, error))
    squares = [[sum(map(mul, one, other)) for other in rows[: i + 1]] for i, one in enumerate(rows)]
    for i, line in enumerate(squares):
        line[i] += damping
    weights = _solve(squares, error)
    step = [sum(map(mul, column, weights)) for column in zip(*rows, strict=True)]
    longest = max(map(abs, step))
    scale = 1.0 if longest <= _STEP_RAD else _STEP_RAD / longest
    a, b, c, d, e, f = (angle + scale * change for angle, change in zip(q, step, strict=True))
    return (a, b, c, d, e, f)


def _solve(squares: Sequence[Sequence[float]], right: Sequence[float]) -> list[float]:
    """Solve matrix x = right by Cholesky decomposition; the symmetric matrix is given by the rows of its lower half."""
    lower: list[list[float]] = []
    y: list[float] = []
    for row, value in zip(squares, right, strict=True):
        line: list[float] = []
        for part, other in zip(row, lower, strict=False):
            line.append((part - sum(map(mul, line, other))) / other[-1])
        pivot = row[-1] - sum(map(mul, line, line))
        y.append((value - sum(map(mul, line, y))) / (root := sqrt(max(pivot, _EPSILON))))
        line.append(root)
        lower.append(line)
    x: list[float] = []
    for i in reversed(range(6)):
        known = sum(lower[k][i] * part for k, part in zip(range(5, i, -1), x, strict=True))
        x.append((y[i] - known) / lower[i][i])
    return x[::-1]


def _times_transposed(a: Matrix3, b: Matrix3) -> Matrix3:
    """a b^T."""
    a1, a2, a3, a4, a5, a6, a7, a8, a9 = a
    b1, b2, b3, b4, b5, b6, b7, b8, b9 = b
    return (
        *(a1 * b1 + a2 * b2 + a3 * b3, a1 * b4 + a2 * b5 + a3 * b6, a1 * b7 + a2 * b8 + a3 * b9),
        *(a4 * b1 + a5 * b2 + a6 * b3, a4 * b4 + a5 * b5 + a6 * b6, a4 * b7 + a5 * b8 + a6 * b9),
        *(a7 * b1 + a8 * b2 + a9 * b3, a7 * b4 + a8 * b5 + a9 * b6, a7 * b7 + a8 * b8 + a9 * b9),
    )


def _max_difference(one: Joints, other: Joints) -> float:
    return max(abs(wrap(a - b)) for a, b in zip(one, other, strict=True))
