"""Conversions between joint angles and TCP poses, with the arm and TCP of the running program."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from emulator.builtins.host import ProgramHost
from emulator.robot.worldmodel import ArmPose
from urproto.robots.pose import pose_inv, pose_trans
from urproto.vectors import ZERO6, Vector3, Vector6, as_six
from urscript.errors import RuntimeFault
from urscript.values import Pose, is_number

OUT_OF_RANGE: Final = (IndexError, OverflowError, ValueError)
"""What signals, registers and the like raise for numbers and names that they do not have."""

_NO_TCP = ZERO6


def three(values: Sequence[float], what: str) -> Vector3:
    """Three floats; raises a RuntimeFault that names ``what`` when they are not."""
    x, y, z = numbers(values, 3, what)
    return (float(x), float(y), float(z))


def numbers(values: Sequence[float], count: int, what: str) -> Sequence[float]:
    """The values, if they are ``count`` finite numbers; raises a RuntimeFault that names ``what`` otherwise."""
    if len(values) != count or not all(is_number(value) and math.isfinite(value) for value in values):
        raise RuntimeFault(f"{what} must be {count} finite numbers")
    return values


@contextmanager
def within_range() -> Iterator[None]:
    """Turn these errors into runtime faults."""
    try:
        yield
    except OUT_OF_RANGE as error:
        raise RuntimeFault(str(error)) from error


def forward(host: ProgramHost, q: Sequence[float], tcp: Sequence[float] | None = None) -> Vector6:
    """TCP pose in the base frame of joint angles; with the active TCP unless another is given."""
    return host.arm.kinematics.forward(as_six(q), active_tcp(host) if tcp is None else as_six(tcp))


def inverse(
    host: ProgramHost, pose: Sequence[float], q_near: Sequence[float] | None = None, tcp: Sequence[float] | None = None
) -> Vector6 | None:
    """Joint angles for a TCP pose within their limits, nearest to ``q_near`` (default: the present ones), or None."""
    flange = pose_trans(pose, pose_inv(active_tcp(host) if tcp is None else tcp))
    near = host.motion.q if q_near is None else as_six(q_near)
    if not all(map(math.isfinite, flange)):
        return None
    return host.arm.kinematics.inverse_near(flange, near, *host.machine.model.position_limits)


def in_joint_range(host: ProgramHost, q: Sequence[float]) -> bool:
    """Whether every joint angle is within its limits."""
    lowest, highest = host.machine.model.position_limits
    return all(low <= angle <= high for low, angle, high in zip(lowest, q, highest, strict=True))


def joints_for(host: ProgramHost, target: Sequence[float]) -> Vector6:
    """Joint angles for a target given as a pose or as joint angles; RuntimeFault if it is out of reach."""
    if not isinstance(target, Pose):
        if not in_joint_range(host, target):
            raise RuntimeFault(f"the target [{_listed(target)}] is outside the joint limits")
        return as_six(target)
    q = inverse(host, target)
    if q is None:
        raise no_solution(target)
    return q


def pose_for(host: ProgramHost, target: Sequence[float]) -> Vector6:
    """TCP pose for a target given as a pose or as joint angles."""
    return as_six(target) if isinstance(target, Pose) else forward(host, target)


def twist_of(host: ProgramHost, q: Vector6, qd: Vector6) -> Vector6:
    """TCP velocity in the base frame [m/s, rad/s]."""
    rows = host.arm.kinematics.jacobian(q, active_tcp(host))
    return as_six([_dot(row, qd) for row in rows])


def active_tcp(host: ProgramHost) -> Vector6:
    """The TCP in use, flange to TCP."""
    return host.machine.installation.tcp


def arm_pose(host: ProgramHost) -> ArmPose:
    """Poses of flange and TCP, for the world model."""
    return ArmPose(forward(host, host.motion.q, _NO_TCP), active_tcp(host))


def no_solution(pose: Sequence[float]) -> RuntimeFault:
    """The error of movej and get_inverse_kin for a pose out of reach."""
    place = _listed(pose)
    return RuntimeFault(f"no inverse kinematics solution for p[{place}]: it is out of reach for this arm and TCP")


def nearest_angle(angle: float, near: float) -> float:
    """The angle equivalent to ``angle`` that is nearest to ``near`` [rad]."""
    return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
