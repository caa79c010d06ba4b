"""Motions as industrial robots know them: PTP, LIN, CIRC, and sequences of them without stops between.

Names and meaning are those of MoveIt's pilz_industrial_motion_planner. They look for no way around anything: what is in
the way is an error. Other than there, a tool slows down near a singularity rather than failing, and a blend is a curve
of the joints that keeps speed and acceleration continuous.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import dist, isfinite
from typing import Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.goals import CircGoal, Goal, GoalSet, PoseGoal, candidates
from client.planning.lines import COLUMNS, Arc, Followed, Follower, Line, ToolPath, arc_about, arc_through
from client.planning.path import PiecewisePath, RoundedPath, hermite, joined
from client.planning.timing import Array, Limits, Shares
from urproto.robots import Joints
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6

INDUSTRIAL: Final = ("PTP", "LIN", "CIRC")

_APART_RAD: Final = 1e-9
_BISECTIONS: Final = 30
_SHRINKINGS: Final = 6  # of a blend that leaves its sphere
_LOOKS: Final = 16  # at where a blend is


class IncompletePathError(PlanningError):
    """A motion cannot be followed to its end; the text says where it ends and why.

    fraction: of it that can be. q_rad: the joint angles (6,) there.
    """

    def __init__(self, text: str, fraction: float, q_rad: Joints) -> None:
        super().__init__(text)
        self.fraction = fraction
        self.q_rad = q_rad


@dataclass(frozen=True, slots=True)
class CartesianLimits:
    """Of the TCP on lines and arcs: speed [m/s], acceleration [m/s2], turning [rad/s].

    The defaults are those in the manual of Pilz' planner (pilz_cartesian_limits.yaml); ur_moveit_config has none. As
    there, turning accelerates in the ratio of acceleration and speed. Braking is as hard as accelerating.
    """

    velocity_m_s: float = 1.0
    acceleration_m_s2: float = 2.25
    rotation_rad_s: float = 1.57

    def __post_init__(self) -> None:
        for value in (self.velocity_m_s, self.acceleration_m_s2, self.rotation_rad_s):
            if not (isfinite(value) and value > 0.0):
                raise PlanningError(f"Cartesian limits are above 0, not {value}")

    def beside(self, limits: Limits) -> Limits:
        """Those of the joints and these, for a path of `COLUMNS`."""
        gaining = self.acceleration_m_s2 / self.velocity_m_s
        ratio = float(np.min(limits.jerk / limits.acceleration))
        tool = np.array([self.velocity_m_s, self.rotation_rad_s])
        return Limits(
            np.concatenate((limits.velocity, tool)),
            np.concatenate((limits.acceleration, tool * gaining)),
            np.concatenate((limits.jerk, tool * gaining * ratio)),
        )


@dataclass(frozen=True, slots=True)
class MotionSequenceItem:
    """One motion of a sequence, and how it goes over into the next.

    planner: any. blend_radius_m: from where the TCP is so near to the goal, the arm goes over into the next motion, and
    is on it as far behind; 0 stops there. velocity_scaling, acceleration_scaling: of this motion, beside those of the
    whole sequence.
    """

    goal: Goal
    planner: str = "LIN"
    blend_radius_m: float = 0.0
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0

    def __post_init__(self) -> None:
        if not (isfinite(self.blend_radius_m) and self.blend_radius_m >= 0.0):
            raise PlanningError(f"a blend radius is 0 or above, not {self.blend_radius_m}")
        for name, share in (("velocity", self.velocity_scaling), ("acceleration", self.acceleration_scaling)):
            if not 0.0 < share <= 1.0:
                raise PlanningError(f"the {name} scaling is above 0 and at most 1, not {share}")


@dataclass(frozen=True, slots=True)
class Segment:
    """One motion: its path, None for no way at all, its corners, and where the TCP is. shortening_s: what that took."""

    path: PiecewisePath | None
    way: tuple[Joints, ...]
    pose_of: Callable[[Sequence[float]], Pose]
    shortening_s: float = 0.0


def straight_segment(checker: CollisionChecker, start: Joints, goal: Goal) -> Segment:
    """PTP: all joints straight to the goal, arriving together. Raises as `candidates`."""
    end = candidates(goal, start, checker)[0]
    apart = max(abs(one - other) for one, other in zip(start, end, strict=True)) > _APART_RAD
    path = RoundedPath([start, end]).widened(COLUMNS) if apart else None
    return Segment(path, (start, end), follower_of(checker, goal).pose)


def tool_segment(checker: CollisionChecker, start: Joints, goal: Goal, name: str, limits: CartesianLimits) -> Segment:
    """LIN or CIRC. Raises IncompletePathError, PlanningError."""
    follower = follower_of(checker, goal)
    way = _way(follower.pose(start), goal, name)
    found = follower.follow(way, start)
    if found.stopped_by:
        raise IncompletePathError(
            f"{name} can be followed for {100 * found.reached:.1f} % of its way, then {found.stopped_by}",
            found.reached,
            found.q_end,
        )
    return Segment(_slowed(found, way, limits), (start, found.q_end), follower.pose)


def _slowed(found: Followed, way: ToolPath, limits: CartesianLimits) -> PiecewisePath | None:
    """The way of the TCP counts for more on an arc on which its speed would let it leave sideways too fast."""
    if found.path is None or not isinstance(way, Arc):
        return found.path
    fastest = (limits.acceleration_m_s2 * way.radius_m) ** 0.5
    coefficients = found.path.coefficients.copy()
    coefficients[:, :, 6] *= max(1.0, limits.velocity_m_s / fastest)
    return PiecewisePath(coefficients, found.path.sizes.tolist(), (len(found.path.places) - 1) // len(coefficients))


def follower_of(checker: CollisionChecker, goal: Goal) -> Follower:
    """For the scene's arm with the goal's TCP; the flange without one."""
    goal = goal.goals[0] if isinstance(goal, GoalSet) else goal
    tcp_offset = goal.tcp_offset if isinstance(goal, PoseGoal | CircGoal) else None
    return Follower(checker.scene.model, checker.scene.kinematics, tcp_offset or ZERO6)


def _way(start: Pose, goal: Goal, name: str) -> ToolPath:
    if isinstance(goal, PoseGoal | CircGoal) and not (len(goal.pose) == 6 and all(map(isfinite, goal.pose))):
        raise PlanningError(f"{name}: a pose is six finite numbers, not {list(goal.pose)}")
    if name == "LIN":
        if not isinstance(goal, PoseGoal):
            raise PlanningError(
                "LIN goes to a pose: give a PoseGoal; that of joint angles is scene.kinematics.forward(q, tcp_offset)"
            )
        return Line(start, goal.pose)
    if not isinstance(goal, CircGoal):
        raise PlanningError("CIRC needs a point of its circle: give a CircGoal")
    points = [point for point in (goal.interim, goal.center) if point is not None]
    if len(points) != 1:
        raise PlanningError("CIRC needs a point of its circle: give the CircGoal an interim, or a center, and not both")
    if len(points[0]) != 3 or not all(map(isfinite, points[0])):
        raise PlanningError(f"CIRC: a point is three finite numbers, not {list(points[0])}")
    return (
        arc_about(start, points[0], goal.pose) if goal.center is not None else arc_through(start, points[0], goal.pose)
    )


# collisions


def blocked(checker: CollisionChecker, path: PiecewisePath) -> tuple[int, Joints] | None:
    """The first piece in which something is too near, and joint angles in it; None for a free way."""
    for piece in range(len(path.sizes)):
        at = path.within(piece)
        where = checker.blocked_at(at, path.travel(piece)[:6])
        if where is not None:
            a, b, c, d, e, f = at(where).tolist()
            return piece, (a, b, c, d, e, f)
    return None


# sequences


@dataclass(frozen=True, slots=True)
class Run:
    """Motions without a stop: the path, by what items its pieces are made, and what they may use of the limits."""

    path: PiecewisePath
    items: tuple[int, ...]
    scalings: tuple[tuple[float, float], ...]

    def shares(self) -> Shares:
        """For `time_optimal`."""
        scalings = np.array(self.scalings)

        def of(places: Array) -> Array:
            found: Array = scalings[self.path.piece_at(places)]
            return found

        return of


def runs(segments: Sequence[Segment], items: Sequence[MotionSequenceItem]) -> Iterator[Run]:
    """Motions put together where they blend. Raises PlanningError for radii that are too large."""
    paths: list[tuple[PiecewisePath, int, tuple[float, float]]] = []
    for number, (segment, item) in enumerate(zip(segments, items, strict=True)):
        if segment.path is None:
            if item.blend_radius_m or (number and items[number - 1].blend_radius_m):
                raise PlanningError(f"motion {number + 1} has no way, so nothing can be blended with it")
            continue
        scaling = (item.velocity_scaling, item.acceleration_scaling)
        path = segment.path
        if paths:
            before, earlier, slower = paths.pop()
            one, between, path = blend(before, path, segments[number - 1], items[number - 1].blend_radius_m, number)
            both = (min(slower[0], scaling[0]), min(slower[1], scaling[1]))
            paths += (one, earlier, slower), (between, earlier, both)
        paths.append((path, number, scaling))
        if not item.blend_radius_m:
            yield _run(paths)
            paths = []
    if paths:
        raise PlanningError("the last motion of a sequence has nothing to blend with: its blend radius is 0")


def _run(paths: Sequence[tuple[PiecewisePath, int, tuple[float, float]]]) -> Run:
    counted = [(len(path.sizes), number, scaling) for path, number, scaling in paths]
    return Run(
        joined([path for path, _, _ in paths]),
        tuple(number for count, number, _ in counted for _ in range(count)),
        tuple(scaling for count, _, scaling in counted for _ in range(count)),
    )


def blend(
    one: PiecewisePath, other: PiecewisePath, corner: Segment, radius_m: float, number: int
) -> tuple[PiecewisePath, PiecewisePath, PiecewisePath]:
    """What remains of two motions, and what is between them, within a sphere about the goal of the first.

    The second is given an s in which its part in the sphere is as long as that of the first.
    """
    middle = corner.pose_of(corner.way[-1])[:3]

    def away(path: PiecewisePath, s: float) -> float:
        return dist(corner.pose_of(path.at(s)[:6].tolist())[:3], middle)

    radius = radius_m
    for _ in range(_SHRINKINGS):
        leave = _crossing(one, one.places[::-1].tolist(), away, radius)
        arrive = _crossing(other, other.places.tolist(), away, radius)
        if leave is None or arrive is None:
            raise PlanningError(
                f"the blend radius of motion {number}, {1000 * radius_m:g} mm, is too large: motion "
                f"{number if leave is None else number + 1} is all within it, or within it and the blend before"
            )
        inside = one.length - leave
        scaled = other.scaled(inside / arrive)
        begin, end = ([value[0] for value in path(np.array([s]))] for path, s in ((one, leave), (scaled, inside)))
        end[0][6:] += one(np.array([one.length]))[0][0, 6:]  # ways of the TCP go on
        size = 2.5 * inside
        between = PiecewisePath(hermite(begin, end, size)[None], [size])
        if all(away(between, s) <= radius_m * 1.001 for s in np.linspace(0.0, size, _LOOKS)):
            return one.part(0.0, leave), between, scaled.part(inside, scaled.length)
        radius *= 0.7
    raise PlanningError(f"motion {number} cannot be blended with the next within {1000 * radius_m:g} mm: stop there")


def _crossing(
    path: PiecewisePath, places: Sequence[float], away: Callable[[PiecewisePath, float], float], radius_m: float
) -> float | None:
    """Where the TCP, coming from the corner, leaves the sphere."""
    inside = places[0]
    for place in places[1:]:
        if away(path, place) >= radius_m:
            for _ in range(_BISECTIONS):
                middle = 0.5 * (inside + place)
                inside, place = (middle, place) if away(path, middle) < radius_m else (inside, middle)
            return place
        inside = place
    return None
