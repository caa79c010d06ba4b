"""Rigid-body dynamics of an arm with its payload in plain Python, for systems without Pinocchio.

The recursive Newton-Euler algorithm (Luh, Walker and Paul 1980) with three-dimensional vectors: velocities and
accelerations from the base outwards, forces and moments from the flange back, all in the links' own frames. The mass
matrix takes six passes, one for each unit acceleration. Frames and arguments are those of
``urproto.robots.pinocchio_dynamics``, and the results agree to a relative error of 1e-9.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from math import cos, hypot, sin
from typing import Final, NamedTuple

from urproto.robots.calibration import chain_of
from urproto.robots.kinematics import Jacobian
from urproto.robots.model import DH, UPRIGHT_GRAVITY, Joints, RobotModel
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO3, ZERO6, Matrix3, Vector3, add3, as_six, cross, dot, rotate, rotate_back, scaled3, sub3

_IDENTITY: Final[Matrix3] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_JOINTS: Final = 6


class _Placement(NamedTuple):
    """Pose of a frame in another one."""

    axes: Matrix3
    position: Vector3

    def times(self, inner: "_Placement") -> "_Placement":
        """Pose in the other frame of a frame that is given in this one."""
        return _Placement(_product(self.axes, inner.axes), add3(self.position, rotate(self.axes, inner.position)))


@dataclass(frozen=True, slots=True)
class _Body:
    """A rigid body: mass [kg], its centre [m] in a frame, and the inertia about that centre [kg m2] in that frame's
    axes."""

    mass: float
    centre: Vector3
    inertia: Matrix3

    def seen_from(self, place: _Placement) -> "_Body":
        """The body expressed in the frame in which its own frame is placed."""
        rows = _product(place.axes, self.inertia)
        turned = _product(rows, _transposed(place.axes))
        return _Body(self.mass, add3(place.position, rotate(place.axes, self.centre)), turned)

    def joined(self, other: "_Body") -> "_Body":
        """Both bodies combined, in the frame in which both are given."""
        mass = self.mass + other.mass
        if not mass:
            return _Body(0.0, ZERO3, _sum(self.inertia, other.inertia))
        centre = scaled3(add3(scaled3(self.centre, self.mass), scaled3(other.centre, other.mass)), 1.0 / mass)
        inertia = _sum(self._about(centre), other._about(centre))
        return _Body(mass, centre, inertia)

    def _about(self, point: Vector3) -> Matrix3:
        """The inertia about another point (parallel axis theorem)."""
        x, y, z = sub3(self.centre, point)
        m = self.mass
        xy, xz, yz = -m * x * y, -m * x * z, -m * y * z
        squares = (m * (y * y + z * z), xy, xz, xy, m * (x * x + z * z), yz, xz, yz, m * (x * x + y * y))
        return _sum(self.inertia, squares)


class _Moving(NamedTuple):
    """The motion of a link in its own frame: pose in the previous frame, velocities and accelerations."""

    place: _Placement
    turn: Vector3  # rad/s
    turn_rate: Vector3  # rad/s2
    acceleration: Vector3  # of the frame's origin, m/s2; gravity is an acceleration of the base


class PlainDynamics:
    """Torques, accelerations and momenta of one arm, with the methods of `pinocchio_dynamics.Dynamics`."""

    def __init__(self, model: RobotModel) -> None:
        self._places, self._links = _chain(model)
        self._flange = _to_next_link(model.dh, 5) if model.calibration is None else _Placement(_IDENTITY, ZERO3)
        self._wrist_3 = self._links[5]
        self._gravity: Vector3 = UPRIGHT_GRAVITY
        self._rotors: Joints = ZERO6

    def copy(self) -> "PlainDynamics":
        other = copy(self)
        other._links = list(self._links)
        return other

    def set_payload(self, mass_kg: float, cog_m: Sequence[float], inertia_kg_m2: Sequence[float] = ZERO6) -> None:
        if mass_kg < 0.0:
            raise ValueError(f"payload of {mass_kg} kg: a mass cannot be negative")
        payload = _body(mass_kg, cog_m, inertia_kg_m2).seen_from(self._flange)
        self._links[5] = self._wrist_3.joined(payload)

    def set_gravity(self, acceleration_m_s2: Sequence[float]) -> None:
        x, y, z = acceleration_m_s2
        self._gravity = (x, y, z)

    def set_rotor_inertia(self, inertia_kg_m2: Sequence[float]) -> None:
        self._rotors = _six(inertia_kg_m2)

    def inverse_dynamics(self, q_rad: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Joints:
        return self._torques(q_rad, qd, qdd, self._gravity)

    def torques_and_momentum(self, q_rad: Joints, qd: Joints, qdd: Joints) -> tuple[Joints, float]:
        return self.inverse_dynamics(q_rad, qd, qdd), self.linear_momentum(q_rad, qd)

    def base_wrench(self, q_rad: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Joints:
        moving = self._moving(_six(q_rad), _six(qd), _six(qdd), self._gravity)
        force, moment = self._loads(moving)[0]
        place = moving[0].place
        force = rotate(place.axes, force)
        moment = add3(rotate(place.axes, moment), cross(place.position, force))
        return (*scaled3(force, -1.0), *scaled3(moment, -1.0))

    def forward_dynamics(self, q_rad: Sequence[float], qd: Sequence[float], torque_Nm: Sequence[float]) -> Joints:
        bias = self.inverse_dynamics(q_rad, qd, ZERO6)
        return _solved(self.mass_matrix(q_rad), [own - taken for own, taken in zip(_six(torque_Nm), bias, strict=True)])

    def gravity_torques(self, q_rad: Sequence[float]) -> Joints:
        return self._torques(q_rad, ZERO6, ZERO6, self._gravity)

    def coriolis_torques(self, q_rad: Sequence[float], qd: Sequence[float]) -> Joints:
        return self._torques(q_rad, qd, ZERO6, ZERO3)

    def mass_matrix(self, q_rad: Sequence[float]) -> Jacobian:
        columns = list[Joints]()
        for i in range(_JOINTS):
            a, b, c, d, e, f = (1.0 if j == i else 0.0 for j in range(_JOINTS))
            columns.append(self._torques(q_rad, ZERO6, (a, b, c, d, e, f), ZERO3))
        upper = [[columns[max(i, j)][min(i, j)] for j in range(_JOINTS)] for i in range(_JOINTS)]
        a_, b_, c_, d_, e_, f_ = (as_six(row) for row in upper)
        return (a_, b_, c_, d_, e_, f_)

    def energy(self, q_rad: Sequence[float], qd: Sequence[float]) -> tuple[float, float]:
        speeds = _six(qd)
        kinetic = sum(0.5 * own * speed * speed for own, speed in zip(self._rotors, speeds, strict=True))
        potential = 0.0
        for body, frame, (velocity, turn) in self._velocities(q_rad, speeds):
            kinetic += 0.5 * (body.mass * dot(velocity, velocity) + dot(turn, rotate(body.inertia, turn)))
            potential += body.mass * dot(self._gravity, add3(frame.position, rotate(frame.axes, body.centre)))
        return kinetic, potential

    def linear_momentum(self, q_rad: Sequence[float], qd: Sequence[float]) -> float:
        total = ZERO3
        for body, frame, (velocity, _) in self._velocities(q_rad, _six(qd)):
            total = add3(total, scaled3(rotate(frame.axes, velocity), body.mass))
        return hypot(*total)

    def jacobian_time_derivative(
        self, q_rad: Sequence[float], qd: Sequence[float], tcp_offset: Sequence[float] | None = None
    ) -> Jacobian:
        frames, speeds = self._frames(_six(q_rad)), _six(qd)
        last = frames[-1].times(self._flange)
        tcp = last.position if tcp_offset is None else last.times(_placement(tcp_offset)).position
        axes = [(f.axes[2], f.axes[5], f.axes[8]) for f in frames]
        axis_rates, origin_speeds = list[Vector3](), list[Vector3]()
        turn, speed, origin = ZERO3, ZERO3, ZERO3  # of the frames one after the other
        for frame, axis, rate in zip(frames, axes, speeds, strict=True):
            speed = add3(speed, cross(turn, sub3(frame.position, origin)))
            origin = frame.position
            axis_rates.append(cross(turn, axis))
            origin_speeds.append(speed)
            turn = add3(turn, scaled3(axis, rate))
        tcp_speed = add3(speed, cross(turn, sub3(tcp, origin)))
        columns = list[tuple[float, ...]]()
        for frame, axis, axis_rate, origin_speed in zip(frames, axes, axis_rates, origin_speeds, strict=True):
            lever, lever_rate = sub3(tcp, frame.position), sub3(tcp_speed, origin_speed)
            columns.append((*add3(cross(axis_rate, lever), cross(axis, lever_rate)), *axis_rate))
        a, b, c, d, e, f = (as_six(row) for row in zip(*columns, strict=True))
        return (a, b, c, d, e, f)

    def _torques(self, q_rad: Sequence[float], qd: Sequence[float], qdd: Sequence[float], felt: Vector3) -> Joints:
        rates = _six(qdd)
        loads = self._loads(self._moving(_six(q_rad), _six(qd), rates, felt))
        return as_six(
            moment[2] + rotor * rate for (_, moment), rotor, rate in zip(loads, self._rotors, rates, strict=True)
        )

    def _moving(self, q: Joints, qd: Joints, qdd: Joints, felt: Vector3) -> list[_Moving]:
        """The motion of every link, from the base outwards."""
        moving = list[_Moving]()
        turn, turn_rate, acceleration = ZERO3, ZERO3, felt
        for fixed, angle, speed, rate in zip(self._places, q, qd, qdd, strict=True):
            place = _turned(fixed, angle)
            sweep = add3(cross(turn_rate, place.position), cross(turn, cross(turn, place.position)))
            acceleration = rotate_back(place.axes, add3(acceleration, sweep))
            x, y, z = rotate_back(place.axes, turn)
            u, v, w = rotate_back(place.axes, turn_rate)
            turn = (x, y, z + speed)
            turn_rate = (u + y * speed, v - x * speed, w + rate)
            moving.append(_Moving(place, turn, turn_rate, acceleration))
        return moving

    def _loads(self, moving: list[_Moving]) -> list[tuple[Vector3, Vector3]]:
        """Force and moment on each link from the previous one, in its own frame, about its origin."""
        loads = list[tuple[Vector3, Vector3]]()
        force, moment = ZERO3, ZERO3  # on the next link, in this link's frame
        for link, body in zip(reversed(moving), reversed(self._links), strict=True):
            turn = link.turn
            sweep = add3(cross(link.turn_rate, body.centre), cross(turn, cross(turn, body.centre)))
            own = scaled3(add3(link.acceleration, sweep), body.mass)
            spin = add3(rotate(body.inertia, link.turn_rate), cross(turn, rotate(body.inertia, turn)))
            force = add3(force, own)
            moment = add3(add3(moment, spin), cross(body.centre, own))
            loads.append((force, moment))
            force = rotate(link.place.axes, force)
            moment = add3(rotate(link.place.axes, moment), cross(link.place.position, force))
        loads.reverse()
        return loads

    def _frames(self, q: Joints) -> list[_Placement]:
        """The joints' frames in the base frame."""
        frames, frame = list[_Placement](), _Placement(_IDENTITY, ZERO3)
        for fixed, angle in zip(self._places, q, strict=True):
            frame = frame.times(_turned(fixed, angle))
            frames.append(frame)
        return frames

    def _velocities(
        self, q_rad: Sequence[float], qd: Joints
    ) -> list[tuple[_Body, _Placement, tuple[Vector3, Vector3]]]:
        """Every link with its pose in the base frame, and the velocity of its centre and its angular velocity in its
        own frame."""
        found = list[tuple[_Body, _Placement, tuple[Vector3, Vector3]]]()
        q = _six(q_rad)
        turn, speed = ZERO3, ZERO3
        for fixed, angle, rate, frame, body in zip(self._places, q, qd, self._frames(q), self._links, strict=True):
            place = _turned(fixed, angle)
            speed = rotate_back(place.axes, add3(speed, cross(turn, place.position)))
            x, y, z = rotate_back(place.axes, turn)
            turn = (x, y, z + rate)
            found.append((body, frame, (add3(speed, cross(turn, body.centre)), turn)))
        return found


def _chain(model: RobotModel) -> tuple[list[_Placement], list[_Body]]:
    """The pose of each joint's frame in the previous one at angle 0, and each link in its joint's frame."""
    bodies = [_body(link.mass_kg, link.com_m, link.inertia_kg_m2) for link in model.links]
    places = [_to_next_link(model.dh, i) for i in range(_JOINTS)]
    if model.calibration is None:
        joints = [_Placement(_IDENTITY, ZERO3), *places[:-1]]
    else:
        joints = [_Placement(frame.axes, frame.position) for frame in chain_of(model.calibration)]
        # the joint's frame already includes d
        places = [_Placement(place.axes, (model.dh.a[i], 0.0, 0.0)) for i, place in enumerate(places)]
    return joints, [body.seen_from(place) for body, place in zip(bodies, places, strict=True)]


def _to_next_link(dh: DH, i: int) -> _Placement:
    """Trans_z(d) Trans_x(a) Rot_x(alpha): the transform after the rotation of joint i (from 0)."""
    s, c = sin(dh.alpha[i]), cos(dh.alpha[i])
    return _Placement((1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c), (dh.a[i], 0.0, dh.d[i]))


def _placement(pose: Sequence[float]) -> _Placement:
    x, y, z, rx, ry, rz = pose
    return _Placement(rotvec_to_matrix(rx, ry, rz), (x, y, z))


def _turned(place: _Placement, angle: float) -> _Placement:
    """The placement followed by the joint's rotation about z."""
    s, c = sin(angle), cos(angle)
    m = place.axes
    axes = (
        *(c * m[0] + s * m[1], c * m[1] - s * m[0], m[2]),
        *(c * m[3] + s * m[4], c * m[4] - s * m[3], m[5]),
        *(c * m[6] + s * m[7], c * m[7] - s * m[6], m[8]),
    )
    return _Placement(axes, place.position)


def _body(mass_kg: float, com_m: Sequence[float], inertia_kg_m2: Sequence[float]) -> _Body:
    xx, yy, zz, xy, xz, yz = inertia_kg_m2
    x, y, z = com_m
    return _Body(mass_kg, (x, y, z), (xx, xy, xz, xy, yy, yz, xz, yz, zz))


def _six(values: Sequence[float]) -> Joints:
    if len(values) != _JOINTS:
        raise ValueError(f"a joint vector must have {_JOINTS} numbers, not {len(values)}")
    return as_six(values)


def _product(a: Matrix3, b: Matrix3) -> Matrix3:
    u = rotate(a, (b[0], b[3], b[6]))
    v = rotate(a, (b[1], b[4], b[7]))
    w = rotate(a, (b[2], b[5], b[8]))
    return (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])


def _transposed(m: Matrix3) -> Matrix3:
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


def _sum(a: Matrix3, b: Matrix3) -> Matrix3:
    c = [one + other for one, other in zip(a, b, strict=True)]
    return (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])


def _solved(matrix: Jacobian, right: Sequence[float]) -> Joints:
    """Solve a linear system with a symmetric positive definite matrix by Cholesky decomposition."""
    lower = [[0.0] * _JOINTS for _ in range(_JOINTS)]
    for i in range(_JOINTS):
        for j in range(i + 1):
            rest = matrix[i][j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            lower[i][j] = rest**0.5 if i == j else rest / lower[j][j]
    found = list(right)
    for i in range(_JOINTS):
        found[i] = (found[i] - sum(lower[i][k] * found[k] for k in range(i))) / lower[i][i]
    for i in reversed(range(_JOINTS)):
        found[i] = (found[i] - sum(lower[k][i] * found[k] for k in range(i + 1, _JOINTS))) / lower[i][i]
    return as_six(found)
