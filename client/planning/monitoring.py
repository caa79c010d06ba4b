"""Check whether an arm that is following a trajectory may continue after the scene has changed."""

from collections.abc import Sequence
from math import dist

from client.planning.collisions import CollisionChecker
from client.planning.parameterisation import Trajectory


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
