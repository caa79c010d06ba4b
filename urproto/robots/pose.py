"""Pose algebra in Universal Robots' conventions, on plain floats.

A pose is x, y, z [m] and a rotation vector rx, ry, rz [rad] (axis times angle). Every
function takes any sequence of six numbers and returns tuples; rotation vectors that come
out are at most pi long. A sequence of another length raises ValueError.

Rotations are composed as unit quaternions (w, x, y, z), which are accurate near angles 0 and pi, where computing with
the trace of a matrix loses half of the digits.
"""

from collections.abc import Callable, Sequence
from math import atan2, cos, hypot, sin, sqrt

from urproto.vectors import ZERO3, Axes, Matrix3, Vector3, Vector6

Pose = Vector6

_Quaternion = tuple[float, float, float, float]


def pose_trans(pose_a_b: Sequence[float], pose_b_c: Sequence[float]) -> Pose:
    """Frame c in frame a: the product of the two homogeneous transforms."""
    ax, ay, az, arx, ary, arz = pose_a_b
    bx, by, bz, brx, bry, brz = pose_b_c
    a = _quaternion(arx, ary, arz)
    x, y, z = _rotate(a, bx, by, bz)
    return (ax + x, ay + y, az + z, *_rotvec(_multiply(a, _quaternion(brx, bry, brz))))


def pose_inv(pose_a_b: Sequence[float]) -> Pose:
    """Frame a in frame b: the inverse transform."""
    px, py, pz, rx, ry, rz = pose_a_b
    x, y, z = _rotate(_quaternion(-rx, -ry, -rz), px, py, pz)
    return (-x, -y, -z, *_rotvec(_quaternion(-rx, -ry, -rz)))


def pose_add(pose_1: Sequence[float], pose_2: Sequence[float]) -> Pose:
    """Positions add, rotations multiply: R = R1 R2 (Script Manual, pose_add)."""
    ax, ay, az, arx, ary, arz = pose_1
    bx, by, bz, brx, bry, brz = pose_2
    turn = _multiply(_quaternion(arx, ary, arz), _quaternion(brx, bry, brz))
    return (ax + bx, ay + by, az + bz, *_rotvec(turn))


def adder_to(pose_2: Sequence[float]) -> Callable[[Sequence[float]], Pose]:
    """`pose_add` for many first poses and one second, whose orientation is converted only once."""
    bx, by, bz, brx, bry, brz = pose_2
    second = _quaternion(brx, bry, brz)

    def add_to(pose_1: Sequence[float]) -> Pose:
        ax, ay, az, arx, ary, arz = pose_1
        return (ax + bx, ay + by, az + bz, *_rotvec(_multiply(_quaternion(arx, ary, arz), second)))

    return add_to


def pose_sub(pose_to: Sequence[float], pose_from: Sequence[float]) -> Pose:
    """The pose that, added to ``pose_from``, gives ``pose_to``: pose_add(pose_sub(a, b), b) = a.

    Source: a Universal Robots employee in the vendor's forum, thread 8431. The rotation is
    therefore about the base axes: R = R_to R_from^-1.
    """
    ax, ay, az, arx, ary, arz = pose_to
    bx, by, bz, brx, bry, brz = pose_from
    turn = _multiply(_quaternion(arx, ary, arz), _quaternion(-brx, -bry, -brz))
    return (ax - bx, ay - by, az - bz, *_rotvec(turn))


def interpolate_pose(pose_from: Sequence[float], pose_to: Sequence[float], alpha: float) -> Pose:
    """The pose at the fraction ``alpha`` between two poses: position on a line, orientation about one fixed axis.

    0 is the first pose, 1 the second, and other values extrapolate. The rotation takes the shorter direction.
    """
    ax, ay, az, arx, ary, arz = pose_from
    bx, by, bz, brx, bry, brz = pose_to
    start = _quaternion(arx, ary, arz)
    rx, ry, rz = _rotvec(_multiply(_quaternion(-arx, -ary, -arz), _quaternion(brx, bry, brz)))
    turn = _multiply(start, _quaternion(alpha * rx, alpha * ry, alpha * rz))
    return (ax + alpha * (bx - ax), ay + alpha * (by - ay), az + alpha * (bz - az), *_rotvec(turn))


def point_dist(pose_from: Sequence[float], pose_to: Sequence[float]) -> float:
    """Distance between two positions [m]; orientations are ignored."""
    ax, ay, az, _, _, _ = pose_from
    bx, by, bz, _, _, _ = pose_to
    return hypot(bx - ax, by - ay, bz - az)


def pose_dist(pose_from: Sequence[float], pose_to: Sequence[float]) -> float:
    """Distance between two poses [m]: that of the positions (guess: the manual does not name another metric)."""
    return point_dist(pose_from, pose_to)


def wrench_trans(pose_from_to: Sequence[float], wrench_from: Sequence[float]) -> Pose:
    """A wrench (force [N], torque [Nm]) expressed in another frame, whose pose in the first one is given.

    The torque is moved to the new origin first; then both are rotated into the new axes.
    """
    px, py, pz, rx, ry, rz = pose_from_to
    fx, fy, fz, tx, ty, tz = wrench_from
    back = _quaternion(-rx, -ry, -rz)
    tx, ty, tz = tx - (py * fz - pz * fy), ty - (pz * fx - px * fz), tz - (px * fy - py * fx)
    return (*_rotate(back, fx, fy, fz), *_rotate(back, tx, ty, tz))


def rotvec_to_matrix(rx: float, ry: float, rz: float) -> Matrix3:
    """Rotation matrix, row by row, of a rotation vector [rad]."""
    w, x, y, z = _quaternion(rx, ry, rz)
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    return (1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy)


def axes_of(pose: Sequence[float]) -> Axes:
    """The axes of a pose's orientation, in the frame that the pose is given in."""
    m = rotvec_to_matrix(*pose[3:])
    return (m[0], m[3], m[6]), (m[1], m[4], m[7]), (m[2], m[5], m[8])


def rotvec_to_quaternion(rx: float, ry: float, rz: float) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w (as ROS writes them) of a rotation vector [rad]."""
    w, x, y, z = _quaternion(rx, ry, rz)
    return (x, y, z, w)


def quaternion_to_rotvec(x: float, y: float, z: float, w: float) -> Vector3:
    """Rotation vector [rad], at most pi long, of a quaternion in ROS's order and of any length except 0."""
    return _rotvec((w, x, y, z))


def matrix_to_rotvec(matrix: Sequence[float]) -> Vector3:
    """Rotation vector [rad], at most pi long, of a rotation matrix given row by row.

    The quaternion is built around its largest component, which the matrix holds exactly.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = matrix
    if xx + yy + zz > 0.0:
        return _rotvec((1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy))
    if xx >= yy and xx >= zz:
        return _rotvec((zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx))
    if yy >= zz:
        return _rotvec((xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy))
    return _rotvec((yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz))


def rpy_to_rotvec(roll: float, pitch: float, yaw: float) -> Vector3:
    """Rotation vector of rotations about the fixed axes x, y, z in this order (R = Rz Ry Rx), all in rad."""
    yaw_pitch = _multiply(_quaternion(0.0, 0.0, yaw), _quaternion(0.0, pitch, 0.0))
    return _rotvec(_multiply(yaw_pitch, _quaternion(roll, 0.0, 0.0)))


def rotvec_to_rpy(rx: float, ry: float, rz: float) -> Vector3:
    """Roll, pitch, yaw [rad] about fixed axes; pitch in [-pi/2, pi/2], yaw 0 where roll and yaw coincide."""
    r = rotvec_to_matrix(rx, ry, rz)
    level = hypot(r[0], r[3])
    if level < 1e-9:  # gimbal lock: only yaw -+ roll is determined
        return (atan2(-r[5], r[4]), atan2(-r[6], level), 0.0)
    return (atan2(r[7], r[8]), atan2(-r[6], level), atan2(r[3], r[0]))


def _quaternion(rx: float, ry: float, rz: float) -> _Quaternion:
    angle = sqrt(rx * rx + ry * ry + rz * rz)
    if angle < 1e-9:  # sin(a/2)/a is 1/2 to the last digit
        return (1.0, 0.5 * rx, 0.5 * ry, 0.5 * rz)
    scale = sin(0.5 * angle) / angle
    return (cos(0.5 * angle), scale * rx, scale * ry, scale * rz)


def _rotvec(quaternion: _Quaternion) -> Vector3:
    """The rotation vector of a quaternion of any non-zero length."""
    w, x, y, z = quaternion
    size = sqrt(x * x + y * y + z * z)
    if size < 1e-150:  # squares underflow; the angle is zero for all purposes
        return ZERO3
    scale = 2.0 * atan2(size, w) / size if w >= 0.0 else -2.0 * atan2(size, -w) / size
    return (scale * x, scale * y, scale * z)


def _multiply(a: _Quaternion, b: _Quaternion) -> _Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _rotate(quaternion: _Quaternion, vx: float, vy: float, vz: float) -> Vector3:
    w, x, y, z = quaternion
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + (y * tz - z * ty),
        vy + w * ty + (z * tx - x * tz),
        vz + w * tz + (x * ty - y * tx),
    )
