"""Check whether an arm that is moving may continue."""

from collections.abc import Sequence
from math import dist
from typing import Final

import numpy as np

from client.planning.collisions import CollisionChecker
from client.planning.parameterisation import Trajectory

_SHARES: Final = (1.0, 0.5, 0.25, 0.1)  # of a speed that are tried; guess


def blocking_reason(checker: CollisionChecker, trajectory: Trajectory, q_rad: Sequence[float]) -> str:
    """What blocks the rest of a trajectory; "" if nothing does.

    q_rad: the arm's configuration (6,). The check covers the motion from there to the nearest point of the trajectory,
    and from that point to the end.
    """
    configurations = trajectory.q.tolist()
    before = list(q_rad)
    nearest = min(range(len(configurations)), key=lambda i: dist(configurations[i], before))
    for q in configurations[nearest:]:
        if not checker.path_is_free(before, q):
            near = checker.collisions(q)
            return f"the scene has changed, and the path is blocked{f': {near[0]}' if near else ''}"
        before = q
    return ""


def free_share(checker: CollisionChecker, q_rad: Sequence[float], qd_rad_s: Sequence[float], ahead_s: float) -> float:
    """The share of the joint speeds (6,) at which an arm meets nothing for the next ``ahead_s``, from 0 to 1.

    An arm that is in collision already may move slowly if that takes it out.
    """
    q = np.asarray(q_rad, dtype=float)
    way = ahead_s * np.asarray(qd_rad_s, dtype=float)
    for share in _SHARES:
        if checker.path_is_free(q, q + share * way):
            return share
    leaves = not checker.is_free(q) and checker.clearance(q + _SHARES[-1] * way) > checker.clearance(q)
    return _SHARES[-1] if leaves else 0.0
