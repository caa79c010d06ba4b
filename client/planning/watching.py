"""Whether an arm that follows a way may go on, when what is around it has changed."""

from collections.abc import Sequence
from math import dist

from client.planning.collisions import CollisionChecker
from client.planning.timing import TimedPath


def in_the_way(checker: CollisionChecker, timed: TimedPath, q_rad: Sequence[float]) -> str:
    """What is in the way of what is left of a path; "" for nothing.

    q_rad: where the arm is (6,). What is looked at is the way from there to the nearest place of the path, and on.
    """
    places = timed.q.tolist()
    before = list(q_rad)
    nearest = min(range(len(places)), key=lambda i: dist(places[i], before))
    for q in places[nearest:]:
        if not checker.way_is_free(before, q):
            near = checker.collisions(q)
            return f"the scene has changed, and the way is blocked{f': {near[0]}' if near else ''}"
        before = q
    return ""
