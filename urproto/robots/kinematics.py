"""Forward and inverse kinematics in closed form, on plain floats.

Every Universal Robots arm has the same shape, and only six lengths differ: joint 1 turns
about the vertical; joints 2, 3 and 4 are parallel and move the arm in one vertical plane;
joint 5 is perpendicular to joint 4, and joint 6 to joint 5. In the notation below, x1 is the
horizontal axis of that plane, z1 its normal (the direction of axes 2, 3 and 4), z4 the axis
of joint 5, and z6 that of joint 6 and of the flange:

    x1 = (c1, s1, 0)      z1 = (s1, -c1, 0)      z4 = s234 x1 - c234 z      (z is up)
    z6 = c5 z1 - s5 (c234 x1 + s234 z)
    p6 = d1 z + a2 (c2 x1 + s2 z) + a3 (c23 x1 + s23 z) + d4 z1 + d5 z4 + d6 z6

The inverse solves this from the flange inwards. p5 = p6 - d6 z6 lies d4 away from the plane
through the base axis, which gives joint 1 (two shoulders). The flange's axes seen along
z1 give joints 5 and 6 (two wrists). The rest is a triangle in the plane with the sides
a2 and a3 (two elbows): up to eight solutions.

Where two solutions coincide, rounding must neither lose them nor be amplified: within
``_MERGE`` of the boundary they count as one, and a wrist within ``_SINGULAR_WRIST`` of
straight keeps its joint 6, because only the sum or difference of joints 4 and 6 is
determined there.
"""

from collections.abc import Sequence
from math import acos, atan2, copysign, cos, dist, hypot, inf, pi, remainder, sin, sqrt, tau
from typing import Final

from urproto.robots.model import DH, Joints
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_trans, rotvec_to_matrix
from urproto.vectors import Matrix3, Vector3, cross, largest, sub, within

Jacobian = tuple[Joints, Joints, Joints, Joints, Joints, Joints]
"""Six rows: linear x, y, z [m/rad], angular x, y, z [rad/rad]; one column per joint."""

# A cosine (a ratio of lengths) up to this much above 1 counts as 1; the arm then stops 2 to 4 nm short of the pose.
# Rounding requires this: if the wrist is nearly singular as well, rounding errors here are up to 5e-9.
_OUT_OF_REACH: Final = 1e-8
# A cosine this close to 1 counts as 1. This is ten times the rounding of a pose (1e-15), so the angle changes by 1.4e-7
# rad at most, and the pose by less than 1e-14 m.
_MERGE: Final = 1e-14
# Sine of joint 5. Rounding makes joint 6 uncertain by 1e-15 over this sine, and near a singular shoulder the sine
# itself by 5e-9. Keeping joint 6 turns the tool by no more than twice this [rad].
_SINGULAR_WRIST: Final = 1e-7
_RIGHT_ANGLE_ERROR: Final = 1e-6  # rad; data files give pi/2 with nine decimals

_FlangeInPlane = tuple[float, float, float, float]  # x1 and z components of its x axis, then of its y axis
_Branch = tuple[float, float, float, _FlangeInPlane, float, float]  # q1, q5, q6; p5 at (x, z), seen from joint 2


class Kinematics:
    """The kinematics of an arm. Raises ValueError for parameters that do not have this shape."""

    def __init__(self, dh: DH) -> None:
        _check_shape(dh)
        self._d1, _, _, self._d4, self._d5, self._d6 = dh.d
        _, self._a2, self._a3, _, _, _ = dh.a
        self._squares = self._a2 * self._a2 + self._a3 * self._a3
        self._double_product = 2.0 * self._a2 * self._a3

    def forward(self, q_rad: Sequence[float], tcp_offset: Sequence[float] | None = None) -> Pose:
        """Pose of the flange in the base frame for joint angles (6,), or of the TCP if ``tcp_offset`` is given."""
        position, axes = self.flange_axes(q_rad)
        flange = (*position, *matrix_to_rotvec(axes))
        return flange if tcp_offset is None else pose_trans(flange, tcp_offset)

    def flange_axes(self, q_rad: Sequence[float]) -> tuple[Vector3, Matrix3]:
        """Position [m] and rotation matrix (row by row) of the flange in the base frame."""
        q1, q2, q3, q4, q5, q6 = q_rad
        s1, c1, s5, c5, s6, c6 = sin(q1), cos(q1), sin(q5), cos(q5), sin(q6), cos(q6)
        q23, q234 = q2 + q3, q2 + q3 + q4
        s, c = sin(q234), cos(q234)
        # flange axes as (x1, z1, z) components
        ux, uy, uz = c * c5, s5, s * c5
        z6x, z6y, z6z = -c * s5, c5, -s * s5
        xx, xy, xz = c6 * ux - s6 * s, c6 * uy, c6 * uz + s6 * c
        yx, yy, yz = -s6 * ux - c6 * s, -s6 * uy, c6 * c - s6 * uz
        reach = self._a2 * cos(q2) + self._a3 * cos(q23) + self._d5 * s + self._d6 * z6x
        aside = self._d4 + self._d6 * z6y
        height = self._d1 + self._a2 * sin(q2) + self._a3 * sin(q23) - self._d5 * c + self._d6 * z6z
        return (c1 * reach + s1 * aside, s1 * reach - c1 * aside, height), (
            c1 * xx + s1 * xy,
            c1 * yx + s1 * yy,
            c1 * z6x + s1 * z6y,
            s1 * xx - c1 * xy,
            s1 * yx - c1 * yy,
            s1 * z6x - c1 * z6y,
            xz,
            yz,
            z6z,
        )

    def elbow_position(self, q_rad: Sequence[float], offset_m: float = 0.0) -> Vector3:
        """Intersection of joint 3's axis with the plane of the arm, or a point away from it along that axis.

        In the base frame [m].
        """
        q1, q2, *_ = q_rad
        s1, c1, reach = sin(q1), cos(q1), self._a2 * cos(q2)
        return (c1 * reach + s1 * offset_m, s1 * reach - c1 * offset_m, self._d1 + self._a2 * sin(q2))

    def wrist_position(self, q_rad: Sequence[float], offset_m: float = 0.0) -> Vector3:
        """Intersection of joint 4's axis with the plane of the arm, or a point away from it along that axis.

        In the base frame [m].
        """
        q1, q2, q3, *_ = q_rad
        s1, c1, reach = sin(q1), cos(q1), self._a2 * cos(q2) + self._a3 * cos(q2 + q3)
        height = self._d1 + self._a2 * sin(q2) + self._a3 * sin(q2 + q3)
        return (c1 * reach + s1 * offset_m, s1 * reach - c1 * offset_m, height)

    def jacobian(self, q_rad: Sequence[float], tcp_offset: Sequence[float] | None = None) -> Jacobian:
        """Geometric Jacobian at the TCP (at the flange without an offset), in base axes: [v, w] = J qd."""
        return self.jacobian_at(q_rad, self.forward(q_rad, tcp_offset))

    def jacobian_at(self, q_rad: Sequence[float], pose_base_tcp: Sequence[float]) -> Jacobian:
        """Like `jacobian`, if the TCP's pose in the base frame is already known; only its position is used."""
        px, py, pz, *_ = pose_base_tcp
        q1, q2, q3, q4, q5, _ = q_rad
        s1, c1, s5, c5 = sin(q1), cos(q1), sin(q5), cos(q5)
        s, c = sin(q2 + q3 + q4), cos(q2 + q3 + q4)
        x2, z2 = self._a2 * cos(q2), self._d1 + self._a2 * sin(q2)
        x3, z3 = x2 + self._a3 * cos(q2 + q3), z2 + self._a3 * sin(q2 + q3)
        along = c1 * px + s1 * py  # of the tool point, on x1
        # column of a joint: axis x (tool point - a point on the axis); axes 2-4 are z1 = (s1, -c1, 0)
        h1, h2, h3 = pz - self._d1, pz - z2, pz - z3
        z4 = (c1 * s, s1 * s, -c)
        z5 = (-c1 * c * s5 + s1 * c5, -s1 * c * s5 - c1 * c5, -s * s5)
        wrist = (c1 * x3 + s1 * self._d4, s1 * x3 - c1 * self._d4, z3)
        arm = (px - wrist[0], py - wrist[1], pz - wrist[2])
        # the axis of joint 6 runs d5 z4 further out
        arm_6 = (arm[0] - self._d5 * z4[0], arm[1] - self._d5 * z4[1], arm[2] - self._d5 * z4[2])
        v5, v6 = cross(z4, arm), cross(z5, arm_6)
        return (
            (-py, -c1 * h1, -c1 * h2, -c1 * h3, v5[0], v6[0]),
            (px, -s1 * h1, -s1 * h2, -s1 * h3, v5[1], v6[1]),
            (0.0, along, along - x2, along - x3, v5[2], v6[2]),
            (0.0, s1, s1, s1, z4[0], z5[0]),
            (0.0, -c1, -c1, -c1, z4[1], z5[1]),
            (1.0, 0.0, 0.0, 0.0, z4[2], z5[2]),
        )

    def twist_at(self, q_rad: Sequence[float], qd: Sequence[float], pose_base_tcp: Sequence[float]) -> Joints:
        """Velocity of the TCP with a known pose, in base axes [m/s, rad/s]: `jacobian_at` times ``qd``."""
        px, py, pz, *_ = pose_base_tcp
        q1, q2, q3, q4, q5, _ = q_rad
        v1, v2, v3, v4, v5, v6 = qd
        s1, c1, s5, c5 = sin(q1), cos(q1), sin(q5), cos(q5)
        q23, q234, v23, v234 = q2 + q3, q2 + q3 + q4, v2 + v3, v2 + v3 + v4
        s, c = sin(q234), cos(q234)
        # joints 2 to 4 turn about z1: the tool point along x1 and up, out of what each link adds
        xx, xz, yx, yz = self._a2 * cos(q2), self._a2 * sin(q2), self._a3 * cos(q23), self._a3 * sin(q23)
        dx, dy, dz = px - s1 * self._d4, py + c1 * self._d4, pz - self._d1
        along, up = c1 * dx + s1 * dy - xx - yx, dz - xz - yz
        outward = -v2 * xz - v23 * yz - v234 * up
        rising = v2 * xx + v23 * yx + v234 * along
        # joints 5 and 6, about z4 and z5
        ux, uy, uz = v5 * c1 * s, v5 * s1 * s, -v5 * c
        wx, wy, wz = v6 * (s1 * c5 - c1 * c * s5), -v6 * (c1 * c5 + s1 * c * s5), -v6 * s * s5
        ax, ay, az = dx - c1 * (xx + yx), dy - s1 * (xx + yx), up
        d5 = self._d5
        bx, by, bz = ax - d5 * c1 * s, ay - d5 * s1 * s, az + d5 * c
        return (
            c1 * outward - v1 * py + (uy * az - uz * ay) + (wy * bz - wz * by),
            s1 * outward + v1 * px + (uz * ax - ux * az) + (wz * bx - wx * bz),
            rising + (ux * ay - uy * ax) + (wx * by - wy * bx),
            s1 * v234 + ux + wx,
            -c1 * v234 + uy + wy,
            v1 + uz + wz,
        )

    def joint_torques_at(
        self, q_rad: Sequence[float], wrench: Sequence[float], pose_base_tcp: Sequence[float]
    ) -> Joints:
        """Joint torques [Nm] of a wrench at the TCP with a known pose, in base axes: `jacobian_at` transposed times it.

        ``wrench``: force (3,) [N] and torque (3,) [Nm].
        """
        px, py, pz, *_ = pose_base_tcp
        q1, q2, q3, q4, q5, _ = q_rad
        fx, fy, fz, mx, my, mz = wrench
        s1, c1, s5, c5 = sin(q1), cos(q1), sin(q5), cos(q5)
        q23, q234 = q2 + q3, q2 + q3 + q4
        s, c = sin(q234), cos(q234)
        x2, x3 = self._a2 * cos(q2), self._a3 * cos(q23)
        dx, dy, dz = px - s1 * self._d4, py + c1 * self._d4, pz - self._d1
        h2 = dz - self._a2 * sin(q2)
        h3 = h2 - self._a3 * sin(q23)
        # joints 2 to 4 turn about z1, with the tool point along x1 and up from each
        along, push = c1 * dx + s1 * dy, c1 * fx + s1 * fy
        about_z1 = s1 * mx - c1 * my
        # joints 5 and 6, about z4 and z5
        x4, y4 = c1 * s, s1 * s
        x5, y5, z5 = s1 * c5 - c1 * c * s5, -(c1 * c5 + s1 * c * s5), -s * s5
        ax, ay = dx - c1 * (x2 + x3), dy - s1 * (x2 + x3)
        d5 = self._d5
        bx, by, bz = ax - d5 * x4, ay - d5 * y4, h3 + d5 * c
        return (
            px * fy - py * fx + mz,
            along * fz - dz * push + about_z1,
            (along - x2) * fz - h2 * push + about_z1,
            (along - x2 - x3) * fz - h3 * push + about_z1,
            x4 * (ay * fz - h3 * fy + mx) + y4 * (h3 * fx - ax * fz + my) - c * (ax * fy - ay * fx + mz),
            x5 * (by * fz - bz * fy + mx) + y5 * (bz * fx - bx * fz + my) + z5 * (bx * fy - by * fx + mz),
        )

    def inverse_all(self, pose_base_flange: Sequence[float], q_near: Sequence[float] | None = None) -> list[Joints]:
        """All joint configurations (up to 8) for this flange pose; empty when it is out of reach.

        Angles are in (-pi, pi]. If the wrist is singular (axes 4 and 6 parallel), joint 6 is arbitrary: it is that of
        ``q_near``, or 0 without one; if the arm cannot reach the pose with it, it is the nearest reachable one.
        """
        q6_free = 0.0 if q_near is None else wrap(q_near[5])
        axes, p5 = self._wrist_centre(pose_base_flange)
        return [
            solution
            for q1 in _shoulders(p5[0], p5[1], self._d4)
            for branch in self._branches(q1, axes, p5, q6_free)
            for solution in self._arms(*branch)
        ]

    def inverse_near(
        self,
        pose_base_flange: Sequence[float],
        q_near: Sequence[float],
        q_min: Sequence[float],
        q_max: Sequence[float],
    ) -> Joints | None:
        """The configuration closest to ``q_near`` (Euclidean) within the joint limits, all (6,) in rad.

        Full turns are added if that is closer. None when no configuration within the limits reaches the pose.
        """
        axes, p5 = self._wrist_centre(pose_base_flange)
        if (continued := self._continued(axes, p5, q_near, q_min, q_max)) is not None:
            return continued
        # Nearest first. Shoulders, wrists and elbows are skipped if their own joints are already further away than a
        # complete solution; along a path, these are all except the arm's current one.
        n1, _, n3, _, n5, n6 = q_near
        best, least = None, inf
        for apart, q1 in sorted([(abs(remainder(q1 - n1, tau)), q1) for q1 in _shoulders(p5[0], p5[1], self._d4)]):
            if apart >= least:
                break
            ranked = [
                (hypot(apart, remainder(branch[1] - n5, tau), remainder(branch[2] - n6, tau)), branch)
                for branch in self._branches(q1, axes, p5, wrap(n6))
            ]
            for far, branch in sorted(ranked):
                if far >= least:
                    break
                elbows = self._arms(*branch)
                for solution in elbows if n3 > 0.0 else reversed(elbows):
                    if abs(remainder(solution[2] - n3, tau)) >= least:
                        continue
                    unwound = unwind(solution, q_near, q_min, q_max)
                    distance = dist(unwound, q_near)
                    if distance < least:
                        best, least = unwound, distance
        return best

    def _continued(
        self,
        axes: Matrix3,
        p5: Vector3,
        q_near: Sequence[float],
        q_min: Sequence[float],
        q_max: Sequence[float],
    ) -> Joints | None:
        """`inverse_near` for a step along a path, in one piece: with shoulder, wrist and elbow of ``q_near``.

        None unless it is certain that no other shoulder, wrist or elbow is nearer, and no joint has to be unwound.
        """
        n1, _, n3, _, n5, _ = q_near
        x5, y5, z = p5
        d4 = self._d4
        distance = hypot(x5, y5)
        if distance <= abs(d4) * (1.0 + _MERGE):
            return None
        bearing, along = atan2(y5, x5), sqrt((distance - d4) * (distance + d4))
        q1, other_q1 = bearing + atan2(d4, along), bearing + atan2(d4, -along)
        if abs(remainder(q1 - n1, tau)) > (away := abs(remainder(other_q1 - n1, tau))):
            q1, other_q1 = other_q1, q1
            away = abs(remainder(other_q1 - n1, tau))
        if not -pi < q1 <= pi:
            q1 = wrap(q1)
        s1, c1 = sin(q1), cos(q1)
        r00, r01, r02, r10, r11, r12, xz, yz, _ = axes
        normal_x, normal_y = s1 * r00 - c1 * r10, s1 * r01 - c1 * r11
        sine = hypot(normal_x, normal_y)
        if sine < _SINGULAR_WRIST:
            return None
        q5 = atan2(sine, s1 * r02 - c1 * r12)
        if n5 > 0.0:
            q6 = atan2(-normal_y, normal_x)
        else:
            q5, q6 = -q5, atan2(normal_y, -normal_x)
        if q6 == -pi:
            q6 = pi
        s6, c6 = sin(q6), cos(q6)
        xx, yx = c1 * r00 + s1 * r10, c1 * r01 + s1 * r11
        out, up = -(s6 * xx + c6 * yx), -(s6 * xz + c6 * yz)  # z4
        x4, z4 = c1 * x5 + s1 * y5 - self._d5 * out, z - self._d5 * up
        cosine = (x4 * x4 + z4 * z4 - self._squares) / self._double_product
        if abs(cosine) > 1.0 - _MERGE:
            return None
        sine = sqrt(1.0 - cosine * cosine)
        q3, aside = atan2(sine, cosine), atan2(self._a3 * sine, self._a2 + self._a3 * cosine)
        if n3 <= 0.0:
            q3, aside = -q3, -aside
        q2 = atan2(z4, x4) - aside
        q = (
            q1,
            q2 if -pi < q2 <= pi else wrap(q2),
            q3,
            wrap(atan2(out, -up) - q2 - q3),
            q5,
            q6,
        )
        apart = dist(q, q_near)
        nearest = (
            apart < away  # the other shoulder
            and apart < abs(remainder(q3 + n3, tau))  # the other elbow, which bends the opposite way
            and apart < abs(remainder(q5 + n5, tau))  # the other wrist
        )
        return q if nearest and apart <= pi and within(q_min, q, q_max) else None

    def _wrist_centre(self, pose_base_flange: Sequence[float]) -> tuple[Matrix3, Vector3]:
        """The flange's axes, and p5 relative to the height of joint 2, both in the base frame."""
        px, py, pz, rx, ry, rz = pose_base_flange
        axes = rotvec_to_matrix(rx, ry, rz)
        d6 = self._d6
        return axes, (px - d6 * axes[2], py - d6 * axes[5], pz - d6 * axes[8] - self._d1)

    def _branches(self, q1: float, axes: Matrix3, p5: Vector3, q6_free: float) -> list[_Branch]:
        """The wrists of a shoulder; only for a singular wrist is it certain that the arm reaches p5."""
        x5, y5, z = p5
        s1, c1 = sin(q1), cos(q1)
        x = c1 * x5 + s1 * y5
        # the flange's x and y axes in the plane of the arm
        flange = (c1 * axes[0] + s1 * axes[3], axes[6], c1 * axes[1] + s1 * axes[4], axes[7])
        wrists = _wrists(axes, s1, c1)
        if wrists is not None:
            return [(q1, q5, q6, flange, x, z) for q5, q6 in wrists]
        q5 = 0.0 if s1 * axes[2] > c1 * axes[5] else pi
        q6 = q6_free if self._arms(q1, q5, q6_free, flange, x, z) else self._reachable_q6(flange, x, z, q6_free)
        return [] if q6 is None else [(q1, q5, q6, flange, x, z)]

    def _arms(self, q1: float, q5: float, q6: float, flange: _FlangeInPlane, x: float, z: float) -> tuple[Joints, ...]:
        """The solutions of a branch: the triangle of upper arm and forearm bends either way, or is flat."""
        along, up = _axis_5(flange, q6)
        x4, z4 = x - self._d5 * along, z - self._d5 * up  # far end of the forearm, seen from joint 2
        cosine = (x4 * x4 + z4 * z4 - self._squares) / self._double_product
        if abs(cosine) > 1.0 + _OUT_OF_REACH:
            return ()
        bearing, q234 = atan2(z4, x4), atan2(along, -up)
        if abs(cosine) > 1.0 - _MERGE:
            bend = 0.0 if cosine > 0.0 else pi
            q2 = bearing - atan2(self._a3 * sin(bend), self._a2 + self._a3 * cos(bend))
            return ((q1, wrap(q2), bend, wrap(q234 - q2 - bend), q5, q6),)
        sine = sqrt(1.0 - cosine * cosine)
        bend, aside = atan2(sine, cosine), atan2(self._a3 * sine, self._a2 + self._a3 * cosine)
        left, right = bearing - aside, bearing + aside
        return (
            (q1, wrap(left), bend, wrap(q234 - left - bend), q5, q6),
            (q1, wrap(right), -bend, wrap(q234 - right + bend), q5, q6),
        )

    def _reachable_q6(self, flange: _FlangeInPlane, x: float, z: float, q6_free: float) -> float | None:
        """For a singular wrist at (x, z): the joint 6 nearest to ``q6_free`` for which the arm just reaches."""
        along, up = _axis_5(flange, q6_free)
        stretched, folded = abs(self._a2 + self._a3), abs(self._a2 - self._a3)
        too_far = hypot(x - self._d5 * along, z - self._d5 * up) > stretched
        limit, distance = stretched if too_far else folded, hypot(x, z)
        # the triangle of joint 2, p5 and p4, with p4 at the limit
        span = 2.0 * self._d5 * distance
        cosine = (distance * distance + self._d5 * self._d5 - limit * limit) / span if span else inf
        if abs(cosine) > 1.0 + _OUT_OF_REACH:
            return None
        bearing, aside = atan2(z, x), acos(max(-1.0, min(1.0, cosine)))
        turns = []
        for direction in (bearing + aside, bearing - aside):
            along, up = cos(direction), sin(direction)
            xx, xz, yx, yz = flange
            q6 = atan2(-(along * xx + up * xz), -(along * yx + up * yz))
            turns.append(remainder(q6 - q6_free, tau))
        return wrap(q6_free + min(turns, key=abs))


def _check_shape(dh: DH) -> None:
    quarter = pi / 2
    expected = (quarter, 0.0, 0.0, quarter, -quarter, 0.0)
    square = all(abs(a - b) < _RIGHT_ANGLE_ERROR for a, b in zip(dh.alpha, expected, strict=True))
    lengths = (dh.a[0], dh.a[3], dh.a[4], dh.a[5], dh.d[1], dh.d[2])
    if not square or any(lengths) or any(dh.theta) or not (dh.a[1] and dh.a[2]):
        raise ValueError(
            f"{dh} is not the shape that the closed form solves: alpha must be pi/2, 0, 0, pi/2, -pi/2, 0, "
            "theta zero, and the only lengths d1, a2, a3, d4, d5, d6"
        )


def _axis_5(flange: _FlangeInPlane, q6: float) -> tuple[float, float]:
    """z4 in the plane of the arm, out of the flange's x and y axes there."""
    s6, c6 = sin(q6), cos(q6)
    xx, xz, yx, yz = flange
    return -(s6 * xx + c6 * yx), -(s6 * xz + c6 * yz)


def _shoulders(x5: float, y5: float, d4: float) -> tuple[float, ...]:
    """Joint 1 for a wrist centre seen from above, which is d4 away from the plane of the arm."""
    distance = hypot(x5, y5)
    if distance < abs(d4) * (1.0 - _OUT_OF_REACH):
        return ()
    bearing = atan2(y5, x5)
    if distance <= abs(d4) * (1.0 + _MERGE):
        return (wrap(bearing + copysign(pi / 2, d4)),)
    along = sqrt((distance - d4) * (distance + d4))
    return (wrap(bearing + atan2(d4, along)), wrap(bearing + atan2(d4, -along)))


def _wrists(axes: Matrix3, s1: float, c1: float) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Joints 5 and 6 from the flange's axes along z1, the normal of the arm's plane; None at a singular wrist."""
    x, y, z = s1 * axes[0] - c1 * axes[3], s1 * axes[1] - c1 * axes[4], s1 * axes[2] - c1 * axes[5]
    sine = hypot(x, y)
    if sine < _SINGULAR_WRIST:
        return None
    q5 = atan2(sine, z)
    return ((q5, wrap(atan2(-y, x))), (-q5, wrap(atan2(y, -x))))


def wrap(angle: float) -> float:
    """The same direction in (-pi, pi]."""
    if -pi < angle <= pi:
        return angle
    turned = angle % tau
    return turned if turned <= pi else turned - tau


def unwind(q: Joints, q_near: Sequence[float], q_min: Sequence[float], q_max: Sequence[float]) -> Joints:
    """Shift each angle by full turns as close to ``q_near`` as the limits allow; infinite if there is no such angle."""
    if within(q_min, q, q_max) and largest(sub(q_near, q)) <= pi:
        return q
    a, b, c, d, e, f = [
        _turned(angle, near, low, high) for angle, near, low, high in zip(q, q_near, q_min, q_max, strict=True)
    ]
    return (a, b, c, d, e, f)


def _turned(angle: float, near: float, low: float, high: float) -> float:
    nearest = angle if -pi <= near - angle <= pi else angle + tau * round((near - angle) / tau)
    if nearest > high:
        nearest -= tau
    elif nearest < low:
        nearest += tau
    return nearest if low <= nearest <= high else inf
