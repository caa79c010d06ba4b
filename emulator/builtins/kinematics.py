"""Kinematics and dynamics of the arm the program runs on."""

from collections.abc import Sequence
from typing import Final

from emulator.builtins.geometry import active_tcp, forward, in_joint_range, inverse, no_solution
from emulator.builtins.host import ProgramHost
from urproto.vectors import Vector6, as_six
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.values import Bool, Joints, Matrix, Num, Pose, PoseArg, PoseOrJoints

LIBRARY = Library("kinematics", host=True, physical=True)

# Measured cost of a calculation beyond that of any call [meter units of about 50 ns].
_FORWARD: Final = 30
_INVERSE: Final = 350
_INVERSE_CALIBRATED: Final = 20_000
_JACOBIAN: Final = 350
_DYNAMICS: Final = 800


@LIBRARY.builtin(cb3="3.1", e="5.0", work=60)
def get_forward_kin(host: ProgramHost, q: Joints | None = None, tcp: PoseOrJoints | None = None) -> Pose:
    """TCP pose in the base frame for joint angles `q` [rad] (default: present) and `tcp` (default: active)."""
    charge(_FORWARD)
    return Pose(forward(host, host.target_q if q is None else q, tcp))


@LIBRARY.builtin(note="always solved to 1e-10; the error limits have no effect")
def get_inverse_kin(
    host: ProgramHost,
    x: PoseArg,
    qnear: Joints | None = None,
    maxPositionError: Num = 1e-10,
    maxOrientationError: Num = 1e-10,
    tcp: PoseOrJoints | None = None,
) -> list[float]:
    """Joint angles [rad] for a TCP pose, nearest to `qnear` (default: the present ones).

    The program ends with an error if there are none within the joint limits.
    """
    charge(_inverse_work(host))
    q = inverse(host, x, qnear, tcp)
    if q is None:
        raise no_solution(x)
    return list(q)


@LIBRARY.builtin(cb3="3.14", e="5.9.4", note="always solved to 1e-10; the error limits have no effect")
def get_inverse_kin_has_solution(
    host: ProgramHost,
    pose: PoseArg,
    qnear: Joints | None = None,
    maxPositionError: Num = 1e-10,
    maxOrientationError: Num = 1e-10,
    tcp: PoseOrJoints | None = None,
) -> bool:
    """Whether get_inverse_kin would find joint angles."""
    charge(_inverse_work(host))
    return inverse(host, pose, qnear, tcp) is not None


@LIBRARY.builtin(
    status="partial",
    note="reach and joint limits; safety planes and tool direction limits are not emulated",
    aliases={"pose": ("pose", "position")},
)
def is_within_safety_limits(host: ProgramHost, pose: PoseOrJoints, qNear: Joints | None = None) -> bool:
    """Whether a TCP pose, or joint angles, can be reached within the joint limits.

    `qNear`: of a pose's solutions the nearest to these joint angles counts; the present ones when omitted.
    """
    charge(_inverse_work(host))
    if isinstance(pose, Pose):
        return inverse(host, pose, qNear) is not None
    return in_joint_range(host, pose)


@LIBRARY.builtin(cb3=None, e="5.20")
def get_jacobian(host: ProgramHost, q: Joints | None = None, tcp: PoseOrJoints | None = None) -> Matrix:
    """Geometric Jacobian at the TCP in the base frame, 6×6: linear rows, then angular."""
    charge(_JACOBIAN)
    return _matrix(host.arm.kinematics.jacobian(_q(host, q), _tcp(host, tcp)))


@LIBRARY.builtin(cb3=None, e="5.20")
def get_jacobian_time_derivative(
    host: ProgramHost, q: Joints | None = None, qd: Joints | None = None, tcp: PoseOrJoints | None = None
) -> Matrix:
    """Time derivative of the Jacobian for joint speeds `qd` [rad/s]."""
    charge(_DYNAMICS)
    return _matrix(host.arm.dynamics.jacobian_time_derivative(_q(host, q), _qd(host, qd), _tcp(host, tcp)))


@LIBRARY.builtin(cb3=None, e="5.20", status="partial", note="without the inertia of the rotors, which is not known")
def get_mass_matrix(host: ProgramHost, q: Joints | None = None, include_rotors_inertia: Bool = False) -> Matrix:
    """Joint-space mass matrix with payload, 6×6 [kg m2]."""
    if include_rotors_inertia:
        raise RuntimeFault("get_mass_matrix: the inertia of the rotors is not emulated")
    charge(_DYNAMICS)
    return _matrix(host.arm.dynamics.mass_matrix(_q(host, q)))


@LIBRARY.builtin(cb3=None, e="5.20")
def get_coriolis_and_centrifugal_torques(
    host: ProgramHost, q: Joints | None = None, qd: Joints | None = None
) -> list[float]:
    """Joint torques [Nm] that the joint speeds cause."""
    charge(_DYNAMICS)
    return list(host.arm.dynamics.coriolis_torques(_q(host, q), _qd(host, qd)))


def _q(host: ProgramHost, q: Sequence[float] | None) -> Vector6:
    return host.target_q if q is None else as_six(q)


def _qd(host: ProgramHost, qd: Sequence[float] | None) -> Vector6:
    return host.motion.qd if qd is None else as_six(qd)


def _tcp(host: ProgramHost, tcp: Sequence[float] | None) -> Vector6:
    return active_tcp(host) if tcp is None else as_six(tcp)


def _matrix(rows: Sequence[Sequence[float]]) -> Matrix:
    return Matrix(tuple(tuple(float(value) for value in row) for row in rows))


def _inverse_work(host: ProgramHost) -> int:
    return _INVERSE if host.machine.model.calibration is None else _INVERSE_CALIBRATED
