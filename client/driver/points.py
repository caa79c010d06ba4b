"""Points of a trajectory, each named after the move that leads to it.

Joint angles are (6,) [rad], poses base to TCP (6,) [m, rotation vector]. v and a are speed and acceleration of the
leading joint [rad/s, rad/s2] or of the TCP [m/s, m/s2]; for optimoves they are shares, above 0 and up to 1, of the
arm's limits. A duration_s above 0 replaces both. blend_radius_m: distance from the point at which the next move may
begin; the last point of a trajectory must not blend.
"""

from collections.abc import Sequence

from client.quantities import checked_call
from urproto.errors import LocalProtocolError
from urproto.external_control import MotionType, TrajectoryPoint

spline = checked_call(TrajectoryPoint.spline)


@checked_call
def movej(
    q_rad: Sequence[float], *, v: float = 1.04, a: float = 1.4, duration_s: float = 0.0, blend_radius_m: float = 0.0
) -> TrajectoryPoint:
    """Move all joints along a straight line in joint space."""
    return _point(MotionType.MOVEJ, q_rad, (v, a), duration_s, blend_radius_m)


@checked_call
def movej_pose(
    pose_base_tcp: Sequence[float],
    *,
    near_q_rad: Sequence[float] | None = None,
    v: float = 1.04,
    a: float = 1.4,
    duration_s: float = 0.0,
    blend_radius_m: float = 0.0,
) -> TrajectoryPoint:
    """Like movej, to the inverse kinematics solution of a pose nearest to `near_q_rad`, or to the present angles."""
    near = (0.0,) * 6 if near_q_rad is None else near_q_rad
    options = (v, a, 0.0 if near_q_rad is None else 1.0)
    return _point(MotionType.MOVEJ_POSE, pose_base_tcp, options, duration_s, blend_radius_m, near)


@checked_call
def movel(
    pose_base_tcp: Sequence[float],
    *,
    v: float = 0.25,
    a: float = 1.2,
    duration_s: float = 0.0,
    blend_radius_m: float = 0.0,
) -> TrajectoryPoint:
    """Move the TCP in a straight line."""
    return _point(MotionType.MOVEL, pose_base_tcp, (v, a), duration_s, blend_radius_m)


@checked_call
def movep(
    pose_base_tcp: Sequence[float], *, v: float = 0.25, a: float = 1.2, blend_radius_m: float = 0.0
) -> TrajectoryPoint:
    """Move the TCP in a straight line at constant speed."""
    return _point(MotionType.MOVEP, pose_base_tcp, (v, a), 0.0, blend_radius_m)


@checked_call
def movec(
    via_base_tcp: Sequence[float],
    pose_base_tcp: Sequence[float],
    *,
    v: float = 0.25,
    a: float = 1.2,
    blend_radius_m: float = 0.0,
    fixed_orientation: bool = False,
) -> TrajectoryPoint:
    """Move the TCP on the circular arc through a via pose; its orientation is interpolated, or fixed to the arc."""
    options = (v, a, float(fixed_orientation))
    return _point(MotionType.MOVEC, pose_base_tcp, options, 0.0, blend_radius_m, via_base_tcp)


@checked_call
def optimovej(
    q_rad: Sequence[float], *, v: float = 0.3, a: float = 0.3, blend_radius_m: float = 0.0
) -> TrajectoryPoint:
    """Like movej, as fast as these shares of the arm's limits allow; PolyScope 5.21 or newer."""
    _check_shares(v, a)
    return _point(MotionType.OPTIMOVEJ, q_rad, (v, a), 0.0, blend_radius_m)


@checked_call
def optimovel(
    pose_base_tcp: Sequence[float], *, v: float = 0.3, a: float = 0.3, blend_radius_m: float = 0.0
) -> TrajectoryPoint:
    """Like movel, as fast as these shares of the arm's limits allow; PolyScope 5.21 or newer."""
    _check_shares(v, a)
    return _point(MotionType.OPTIMOVEL, pose_base_tcp, (v, a), 0.0, blend_radius_m)


def _check_shares(v: float, a: float) -> None:
    if not (0.0 < v <= 1.0 and 0.0 < a <= 1.0):
        raise LocalProtocolError(f"v and a of an optimove are shares above 0 and up to 1, not {v} and {a}")


def _point(
    kind: MotionType,
    target: Sequence[float],
    options: Sequence[float],
    duration_s: float,
    blend_radius_m: float,
    second: Sequence[float] = (0.0,) * 6,
) -> TrajectoryPoint:
    parameters = (*options, *(0.0,) * (6 - len(options)))
    return TrajectoryPoint(kind, tuple(target), tuple(second), parameters, duration_s, blend_radius_m)
