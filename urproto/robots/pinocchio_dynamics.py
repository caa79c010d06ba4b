"""Rigid-body dynamics of an arm with its payload, by Pinocchio.

The model is built in code from the arm's data. Pinocchio's joint i turns about z of Denavit-Hartenberg frame i-1, and
the link's mass properties are given in frame i, one fixed transform further. The base frame is the robot's base. Joint
torques do not include friction, nor the inertia of the rotors unless it is set (``urproto.robots.measured`` has
numbers).
"""

import threading
from collections.abc import Sequence
from copy import copy
from math import cos, hypot, sin
from struct import Struct
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from urproto.robots.calibration import chain_of
from urproto.robots.kinematics import Jacobian
from urproto.robots.model import DH, UPRIGHT_GRAVITY, Joints, RobotModel
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO6

_NO_INERTIA: Final = ZERO6
_Vector = npt.NDArray[np.float64]
_MOTION: Final = Struct("=18d")


class Dynamics:
    """Torques, accelerations and momenta of one arm. Joint vectors are (6,): rad, rad/s, rad/s2, Nm.

    Vectors of another length raise ValueError. Any thread may call `torques_and_momentum`, `linear_momentum` and
    `base_wrench`.
    """

    def __init__(self, model: RobotModel) -> None:
        self._pin = _build(model)
        self._flange = _to_next_link(model.dh, 5) if model.calibration is None else pin.SE3.Identity()
        self._wrist_3 = pin.Inertia(self._pin.inertias[6])
        self._tcp = self._pin.addFrame(pin.Frame("tcp", 6, 0, self._flange, pin.FrameType.OP_FRAME))
        self.set_gravity(UPRIGHT_GRAVITY)
        self._make_room()

    def _make_room(self) -> None:
        self._data, self._report = self._pin.createData(), self._pin.createData()
        # reused in every control period: creating three new arrays takes as long as computing the torques
        self._motion = bytearray(_MOTION.size)
        self._q, self._qd, self._qdd = np.frombuffer(self._motion).reshape(3, 6)
        self._lock = threading.Lock()  # for what may be called from any thread

    def copy(self) -> "Dynamics":
        """The same arm with the same load, which can be given another one."""
        other = copy(self)
        other._pin = pin.Model(self._pin)
        other._make_room()
        return other

    def set_payload(self, mass_kg: float, cog_m: Sequence[float], inertia_kg_m2: Sequence[float] = _NO_INERTIA) -> None:
        """Replace the payload.

        ``cog_m``: centre of gravity (3,) in the flange frame. ``inertia_kg_m2``: Ixx, Iyy, Izz,
        Ixy, Ixz, Iyz about it, axes as the flange's (as URScript's set_target_payload). A
        negative mass raises ValueError.
        """
        if mass_kg < 0.0:
            raise ValueError(f"payload of {mass_kg} kg: a mass cannot be negative")
        payload = _inertia(mass_kg, cog_m, inertia_kg_m2)
        self._pin.inertias[6] = self._wrist_3 + self._flange.act(payload)

    def set_gravity(self, acceleration_m_s2: Sequence[float]) -> None:
        """Set gravity (3,) in the base frame, as in URScript's set_gravity: (0, 0, 9.82) for an upright base."""
        x, y, z = acceleration_m_s2
        self._pin.gravity.linear = np.array((-x, -y, -z))

    def set_rotor_inertia(self, inertia_kg_m2: Sequence[float]) -> None:
        """Set the inertia of the rotors (6,), referred to the joint side of the gears; initially 0."""
        a, b, c, d, e, f = inertia_kg_m2
        self._pin.armature = _vector((a, b, c, d, e, f))

    def inverse_dynamics(self, q_rad: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Joints:
        """Torques that result in the accelerations ``qdd``."""
        return _joints(pin.rnea(self._pin, self._data, _vector(q_rad), _vector(qd), _vector(qdd)))

    def torques_and_momentum(self, q_rad: Joints, qd: Joints, qdd: Joints) -> tuple[Joints, float]:
        """`inverse_dynamics` and `linear_momentum` of one motion, faster than both calls; used every control period."""
        with self._lock:
            _MOTION.pack_into(self._motion, 0, *q_rad, *qd, *qdd)
            torques = pin.rnea(self._pin, self._report, self._q, self._qd, self._qdd)
            momentum = pin.computeCentroidalMomentum(self._pin, self._report)  # for the velocities computed before
            return _joints(torques), hypot(*momentum.linear.tolist())

    def inverse_dynamics_along(self, q_rad: _Vector, qd: _Vector, qdd: _Vector) -> _Vector:
        """`inverse_dynamics` for each row of a motion: all (n, 6)."""
        rows = zip(q_rad, qd, qdd, strict=True)
        return np.array([pin.rnea(self._pin, self._data, *row) for row in rows]).reshape(-1, 6)

    def last_link_regressor(self, q_rad: _Vector, qd: _Vector, qdd: _Vector) -> _Vector:
        """Regressor (n, 6, 10) for a body attached to the last link: multiplied by the body's parameters (see
        `payload_of`), it gives the torques that the body adds for each row of a motion.
        """
        rows = zip(q_rad, qd, qdd, strict=True)
        last = [pin.computeJointTorqueRegressor(self._pin, self._data, *row)[:, -10:] for row in rows]
        return np.array(last).reshape(-1, 6, 10)

    def payload_of(self, parameters: Sequence[float]) -> tuple[float, tuple[float, float, float]]:
        """Mass [kg] and centre of gravity [m] in the flange frame from the ten parameters of `last_link_regressor`:
        mass, first moments, and six of inertia. The mass must not be 0.
        """
        mass, *moments = parameters[:4]
        x, y, z = self._flange.actInv(np.array(moments) / mass).tolist()
        return float(mass), (x, y, z)

    def base_wrench(self, q_rad: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> Joints:
        """Wrench of arm and payload on the base (6,): force [N], torque [Nm] about its origin, in base axes.

        The weight of an upright arm is a negative z.
        """
        with self._lock:
            pin.rnea(self._pin, self._report, _vector(q_rad), _vector(qd), _vector(qdd))
            return _joints(-self._report.liMi[1].act(self._report.f[1]).vector)

    def forward_dynamics(self, q_rad: Sequence[float], qd: Sequence[float], torque_Nm: Sequence[float]) -> Joints:
        """Accelerations under the torques."""
        return _joints(pin.aba(self._pin, self._data, _vector(q_rad), _vector(qd), _vector(torque_Nm)))

    def gravity_torques(self, q_rad: Sequence[float]) -> Joints:
        """Torques that hold the arm still."""
        return _joints(pin.computeGeneralizedGravity(self._pin, self._data, _vector(q_rad)))

    def coriolis_torques(self, q_rad: Sequence[float], qd: Sequence[float]) -> Joints:
        """Torques for Coriolis and centrifugal forces: C(q, qd) qd."""
        q = _vector(q_rad)
        all_torques = pin.nonLinearEffects(self._pin, self._data, q, _vector(qd))
        return _joints(all_torques - pin.computeGeneralizedGravity(self._pin, self._data, q))

    def mass_matrix(self, q_rad: Sequence[float]) -> Jacobian:
        """Joint-space mass matrix [kg m2], six rows; symmetric."""
        upper = np.triu(pin.crba(self._pin, self._data, _vector(q_rad)))
        return _rows(upper + np.triu(upper, 1).T)

    def energy(self, q_rad: Sequence[float], qd: Sequence[float]) -> tuple[float, float]:
        """Kinetic and potential energy of arm, payload and rotors [J]."""
        q, v = _vector(q_rad), _vector(qd)
        kinetic = pin.computeKineticEnergy(self._pin, self._data, q, v)
        return float(kinetic), float(pin.computePotentialEnergy(self._pin, self._data, q))

    def linear_momentum(self, q_rad: Sequence[float], qd: Sequence[float]) -> float:
        """Magnitude of the linear momentum of arm and payload [kg m/s]."""
        with self._lock:
            momentum = pin.computeCentroidalMomentum(self._pin, self._report, _vector(q_rad), _vector(qd))
            return hypot(*momentum.linear.tolist())

    def jacobian_time_derivative(
        self, q_rad: Sequence[float], qd: Sequence[float], tcp_offset: Sequence[float] | None = None
    ) -> Jacobian:
        """Time derivative of ``Kinematics.jacobian`` for ``qd``: six rows, linear, angular, base axes, at the TCP."""
        offset = pin.SE3.Identity() if tcp_offset is None else _placement(tcp_offset)
        self._pin.frames[self._tcp].placement = self._flange * offset
        pin.computeJointJacobiansTimeVariation(self._pin, self._data, _vector(q_rad), _vector(qd))
        pin.updateFramePlacement(self._pin, self._data, self._tcp)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return _rows(pin.getFrameJacobianTimeVariation(self._pin, self._data, self._tcp, axes))


def _build(model: RobotModel) -> Any:  # pinocchio ships no types
    if model.calibration is not None:
        return _build_calibrated(model, model.calibration)
    built = pin.Model()
    parent, placement = 0, pin.SE3.Identity()
    for i, link in enumerate(model.links):
        parent = built.addJoint(parent, pin.JointModelRZ(), placement, f"joint_{i + 1}")
        placement = _to_next_link(model.dh, i)
        built.appendBodyToJoint(parent, _inertia(link.mass_kg, link.com_m, link.inertia_kg_m2), placement)
    return built


def _build_calibrated(model: RobotModel, calibration: DH) -> Any:
    """Build the model with joints in the frames of the calibration; links in their joints' frames are nominal."""
    built, parent = pin.Model(), 0
    for i, (link, frame) in enumerate(zip(model.links, chain_of(calibration), strict=True)):
        placement = pin.SE3(np.array(frame.axes).reshape(3, 3), np.array(frame.position))
        parent = built.addJoint(parent, pin.JointModelRZ(), placement, f"joint_{i + 1}")
        body = _to_next_link(model.dh, i)
        body.translation = np.array((model.dh.a[i], 0.0, 0.0))  # the joint's frame already includes d
        built.appendBodyToJoint(parent, _inertia(link.mass_kg, link.com_m, link.inertia_kg_m2), body)
    return built


def _to_next_link(dh: DH, i: int) -> Any:
    """Trans_z(d) Trans_x(a) Rot_x(alpha): the transform after the rotation of joint i (from 0)."""
    s, c = sin(dh.alpha[i]), cos(dh.alpha[i])
    rotation = np.array(((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)))
    return pin.SE3(rotation, np.array((dh.a[i], 0.0, dh.d[i])))


def _placement(pose: Sequence[float]) -> Any:
    x, y, z, rx, ry, rz = pose
    return pin.SE3(np.array(rotvec_to_matrix(rx, ry, rz)).reshape(3, 3), np.array((x, y, z)))


def _inertia(mass_kg: float, com_m: Sequence[float], inertia_kg_m2: Sequence[float]) -> Any:
    xx, yy, zz, xy, xz, yz = inertia_kg_m2
    tensor = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    return pin.Inertia(mass_kg, np.array(com_m, dtype=float), tensor)


def _vector(values: Sequence[float]) -> _Vector:
    return np.array(values, dtype=np.float64)


def _joints(values: _Vector) -> Joints:
    a, b, c, d, e, f = values.tolist()
    return (a, b, c, d, e, f)


def _rows(matrix: _Vector) -> Jacobian:
    a, b, c, d, e, f = (_joints(row) for row in matrix)
    return (a, b, c, d, e, f)
