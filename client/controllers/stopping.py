"""How an arm in motion is brought to rest."""

from collections.abc import Sequence

from client.controllers.goals import JointTrajectoryPoint

__all__ = ["deceleration"]


def deceleration(
    q_rad: Sequence[float], qd_rad_s: Sequence[float], limits_rad_s2: Sequence[float]
) -> list[JointTrajectoryPoint]:
    """Points of the way to rest on which each joint (n,) brakes steadily with its own limit.

    There is a point wherever a joint comes to rest; cubic interpolation between them is exact.
    """
    moments = sorted({0.0, *(abs(v) / a for v, a in zip(qd_rad_s, limits_rad_s2, strict=True))})
    return [_after(t, q_rad, qd_rad_s, limits_rad_s2) for t in moments]


def _after(
    t: float, q_rad: Sequence[float], qd_rad_s: Sequence[float], limits_rad_s2: Sequence[float]
) -> JointTrajectoryPoint:
    positions, speeds = [], []
    for q, v, a in zip(q_rad, qd_rad_s, limits_rad_s2, strict=True):
        stop_s = abs(v) / a
        share = 1.0 - min(t, stop_s) / stop_s if stop_s > 0.0 else 0.0  # of the speed that is left
        positions.append(q + v * stop_s * (1.0 - share * share) / 2.0)
        speeds.append(v * share)
    return JointTrajectoryPoint(tuple(positions), tuple(speeds), time_from_start_s=t)
