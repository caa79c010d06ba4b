"""The motions of industrial robots: PTP, LIN, CIRC, and sequences of them that blend without stopping.

Names and meaning are those of MoveIt's pilz_industrial_motion_planner. These motions do not avoid obstacles: an
obstacle on the path is an error. Unlike in Pilz' planner, the tool slows down near a singularity instead of failing,
and a blend is a joint-space curve with continuous speed and acceleration.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import dist
from typing import Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.goals import CircGoal, Goal, GoalSet, PoseGoal, goal_configurations
from client.planning.lines import (
    COLUMNS,
    Arc,
    CartesianInterpolator,
    Interpolation,
    StraightLine,
    ToolPath,
    arc_about,
    arc_through,
)
from client.planning.parameterisation import Array, Limits, Scalings
from client.planning.path import PiecewisePath, RoundedPath, concatenate, hermite
from client.quantities import check_fields
from urproto.robots import Joints
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six

INDUSTRIAL: Final = ("PTP", "LIN", "CIRC")

_DISTINCT_RAD: Final = 1e-9
_BISECTIONS: Final = 30
_SHRINKINGS: Final = 6  # attempts with a smaller radius when a blend leaves its sphere
_SAMPLES: Final = 16  # of a blend, to check whether it stays in its sphere


class IncompletePathError(PlanningError):
    """A motion cannot be followed to its end; the message says where it ends and why.

    fraction: the part of the motion that can be followed. q_rad: the configuration (6,) where that part ends.
    """

    def __init__(self, text: str, fraction: float, q_rad: Joints) -> None:
        super().__init__(text)
        self.fraction = fraction
        self.q_rad = q_rad


@dataclass(frozen=True, slots=True)
class CartesianLimits:
    """Limits of the TCP on lines and arcs: speed [m/s], acceleration [m/s2], angular speed [rad/s].

    The defaults are those in the manual of Pilz' planner (pilz_cartesian_limits.yaml); ur_moveit_config has none. As
    there, the angular acceleration is the angular speed times the ratio of acceleration to speed. Deceleration has the
    same limit as acceleration.
    """

    velocity_m_s: float = 1.0
    acceleration_m_s2: float = 2.25
    rotation_rad_s: float = 1.57

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)

    def combined_with(self, limits: Limits) -> Limits:
        """These limits next to those of the joints, for a path of `COLUMNS`."""
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
    """One motion of a sequence, and how it blends into the next.

    planner: any of them. blend_radius_m: within this distance of the goal, the TCP leaves this motion for the next one,
    which it has joined when it leaves the sphere again; 0 stops at the goal. velocity_scaling, acceleration_scaling: of
    this motion, in addition to those of the whole sequence.
    """

    goal: Goal
    planner: str = "LIN"
    blend_radius_m: float = 0.0
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)


@dataclass(frozen=True, slots=True)
class PlannedSegment:
    """One motion.

    path: None if nothing moves. waypoints: the configurations at its corners. pose_of: forward kinematics to the TCP of
    the goal. shortcutting_s: wall-clock time of shortcutting and rounding.
    """

    path: PiecewisePath | None
    waypoints: tuple[Joints, ...]
    pose_of: Callable[[Sequence[float]], Pose]
    shortcutting_s: float = 0.0


def ptp_segment(checker: CollisionChecker, start: Joints, goal: Goal) -> PlannedSegment:
    """PTP: all joints go straight to the goal and arrive together. Raises the same as `goal_configurations`."""
    end = goal_configurations(goal, start, checker)[0]
    apart = max(abs(one - other) for one, other in zip(start, end, strict=True)) > _DISTINCT_RAD
    path = RoundedPath([start, end]).with_columns(COLUMNS) if apart else None
    return PlannedSegment(path, (start, end), interpolator_for(checker, goal).pose)


def cartesian_segment(
    checker: CollisionChecker, start: Joints, goal: Goal, name: str, limits: CartesianLimits
) -> PlannedSegment:
    """LIN or CIRC. Raises IncompletePathError, PlanningError."""
    interpolator = interpolator_for(checker, goal)
    tool_path = _tool_path(interpolator.pose(start), goal, name)
    found = interpolator.interpolate(tool_path, start)
    if found.stopped_by:
        raise IncompletePathError(
            f"{name} can be followed for {100 * found.reached:.1f} % of its path, then {found.stopped_by}",
            found.reached,
            found.q_end,
        )
    return PlannedSegment(_limit_centripetal(found, tool_path, limits), (start, found.q_end), interpolator.pose)


def _limit_centripetal(found: Interpolation, tool_path: ToolPath, limits: CartesianLimits) -> PiecewisePath | None:
    """The path, with the TCP's distance on a tight arc weighted so that its speed limit bounds the centripetal
    acceleration, too."""
    if found.path is None or not isinstance(tool_path, Arc):
        return found.path
    fastest = (limits.acceleration_m_s2 * tool_path.radius_m) ** 0.5
    coefficients = found.path.coefficients.copy()
    coefficients[:, :, 6] *= max(1.0, limits.velocity_m_s / fastest)
    return PiecewisePath(coefficients, found.path.sizes.tolist(), (len(found.path.gridpoints) - 1) // len(coefficients))


def interpolator_for(checker: CollisionChecker, goal: Goal) -> CartesianInterpolator:
    """An interpolator for the scene's arm and the goal's TCP, or the flange if the goal has none."""
    goal = goal.goals[0] if isinstance(goal, GoalSet) else goal
    tcp_offset = goal.tcp_offset if isinstance(goal, PoseGoal | CircGoal) else None
    offset = ZERO6 if tcp_offset is None else tcp_offset
    return CartesianInterpolator(checker.scene.model, checker.scene.kinematics, offset)


def _tool_path(start: Pose, goal: Goal, name: str) -> ToolPath:
    if name == "LIN":
        if not isinstance(goal, PoseGoal):
            raise PlanningError(
                "LIN needs a pose: give a PoseGoal; for joint angles, that is scene.kinematics.forward(q, tcp_offset)"
            )
        return StraightLine(start, goal.pose)
    if not isinstance(goal, CircGoal):
        raise PlanningError("CIRC needs a point of its circle: give a CircGoal")
    points = [point for point in (goal.interim, goal.center) if point is not None]
    if len(points) != 1:
        raise PlanningError("CIRC needs a point of its circle: give the CircGoal either an interim point or a center")
    return (
        arc_about(start, points[0], goal.pose) if goal.center is not None else arc_through(start, points[0], goal.pose)
    )


# collisions


def first_collision(checker: CollisionChecker, path: PiecewisePath) -> tuple[int, Joints] | None:
    """The first piece in collision (or nearer than the padding), and a configuration in it; None for a free path."""
    for piece in range(len(path.sizes)):
        at = path.piece_function(piece)
        where = checker.blocked_at(at, path.max_travel(piece)[:6])
        if where is not None:
            return piece, as_six(at(where))
    return None


# sequences


@dataclass(frozen=True, slots=True)
class BlendedMotion:
    """Motions without a stop between them, as one path.

    items: for each piece of the path, the number of the item it belongs to. scalings: for each piece, the shares of
    the velocity and acceleration limits it may use.
    """

    path: PiecewisePath
    items: tuple[int, ...]
    scalings: tuple[tuple[float, float], ...]

    def scaling_function(self) -> Scalings:
        """The scalings as a function of the place on the path, for `parameterise`."""
        scalings = np.array(self.scalings)

        def scalings_at(s: Array) -> Array:
            found: Array = scalings[self.path.piece_at(s)]
            return found

        return scalings_at


def blended_motions(segments: Sequence[PlannedSegment], items: Sequence[MotionSequenceItem]) -> Iterator[BlendedMotion]:
    """Join the motions that blend. Raises PlanningError for a radius that is too large."""
    paths: list[tuple[PiecewisePath, int, tuple[float, float]]] = []
    for number, (segment, item) in enumerate(zip(segments, items, strict=True)):
        if segment.path is None:
            if item.blend_radius_m or (number and items[number - 1].blend_radius_m):
                raise PlanningError(f"motion {number + 1} is already at its goal, so nothing can be blended with it")
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
            yield _blended_motion(paths)
            paths = []
    if paths:
        raise PlanningError("the last motion of a sequence has nothing to blend with: set its blend radius to 0")


def _blended_motion(paths: Sequence[tuple[PiecewisePath, int, tuple[float, float]]]) -> BlendedMotion:
    counted = [(len(path.sizes), number, scaling) for path, number, scaling in paths]
    return BlendedMotion(
        concatenate([path for path, _, _ in paths]),
        tuple(number for count, number, _ in counted for _ in range(count)),
        tuple(scaling for count, _, scaling in counted for _ in range(count)),
    )


def blend(
    one: PiecewisePath, other: PiecewisePath, corner: PlannedSegment, radius_m: float, number: int
) -> tuple[PiecewisePath, PiecewisePath, PiecewisePath]:
    """Blend two motions within a sphere about the goal of the first: what remains of them, and the curve between.

    The path parameter s of the second is rescaled so that its part in the sphere is as long as that of the first.
    """
    center = corner.pose_of(corner.waypoints[-1])[:3]

    def distance_from_center(path: PiecewisePath, s: float) -> float:
        return dist(corner.pose_of(path.at(s)[:6].tolist())[:3], center)

    radius = radius_m
    for _ in range(_SHRINKINGS):
        leave = _crossing(one, one.gridpoints[::-1].tolist(), distance_from_center, radius)
        arrive = _crossing(other, other.gridpoints.tolist(), distance_from_center, radius)
        if leave is None or arrive is None:
            raise PlanningError(
                f"the blend radius of motion {number}, {1000 * radius_m:g} mm, is too large: motion "
                f"{number if leave is None else number + 1} lies entirely within it, or within it and the blend before"
            )
        inside = one.length - leave
        scaled = other.scaled(inside / arrive)
        begin, end = ([value[0] for value in path(np.array([s]))] for path, s in ((one, leave), (scaled, inside)))
        end[0][6:] += one(np.array([one.length]))[0][0, 6:]  # the distances that the TCP has covered add up
        size = 2.5 * inside
        between = PiecewisePath(hermite(begin, end, size)[None], [size])
        if all(distance_from_center(between, s) <= radius_m * 1.001 for s in np.linspace(0.0, size, _SAMPLES)):
            return one.subpath(0.0, leave), between, scaled.subpath(inside, scaled.length)
        radius *= 0.7
    raise PlanningError(
        f"motion {number} cannot be blended with the next one within {1000 * radius_m:g} mm: set its blend radius to 0"
    )


def _crossing(
    path: PiecewisePath,
    samples: Sequence[float],
    distance_from_center: Callable[[PiecewisePath, float], float],
    radius_m: float,
) -> float | None:
    """Where the TCP leaves the sphere, searching outwards from its centre."""
    inside = samples[0]
    for place in samples[1:]:
        if distance_from_center(path, place) >= radius_m:
            for _ in range(_BISECTIONS):
                middle = 0.5 * (inside + place)
                inside, place = (middle, place) if distance_from_center(path, middle) < radius_m else (inside, middle)
            return place
        inside = place
    return None
