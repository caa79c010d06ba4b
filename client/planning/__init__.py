"""Motion planning around obstacles; any robot can execute the plans. Needs the extra ``plan``."""

from importlib.util import find_spec

from client.errors import MissingExtraError

if find_spec("coal") is None:  # native Windows has none: WSL, a container or another machine has
    raise MissingExtraError("planning (Pinocchio, OMPL)", "plan")

from client.planning.collisions import CollisionChecker, PairDistance
from client.planning.constraints import OrientationConstraint, PathConstraints, PositionConstraint
from client.planning.goals import (
    NAMED_CONFIGURATIONS,
    CircGoal,
    Goal,
    GoalSet,
    GoalUnreachableError,
    JointGoal,
    NamedGoal,
    PoseGoal,
)
from client.planning.industrial import CartesianLimits, IncompletePathError, MotionSequenceItem
from client.planning.parameterisation import Limits, Trajectory
from client.planning.planner import (
    CartesianPath,
    NoPathError,
    Plan,
    Planner,
    PlannerName,
    StartInCollisionError,
    default_limits,
)
from client.planning.scene import (
    Box,
    Cylinder,
    Hull,
    Mesh,
    Plane,
    PlanningScene,
    SceneObject,
    Shape,
    Sphere,
    read_safety,
)

__all__ = [
    "NAMED_CONFIGURATIONS",
    "Box",
    "CartesianLimits",
    "CartesianPath",
    "CircGoal",
    "CollisionChecker",
    "Cylinder",
    "Goal",
    "GoalSet",
    "GoalUnreachableError",
    "Hull",
    "IncompletePathError",
    "JointGoal",
    "Limits",
    "Mesh",
    "MotionSequenceItem",
    "NamedGoal",
    "NoPathError",
    "OrientationConstraint",
    "PairDistance",
    "PathConstraints",
    "Plan",
    "Plane",
    "Planner",
    "PlannerName",
    "PlanningScene",
    "PoseGoal",
    "PositionConstraint",
    "SceneObject",
    "Shape",
    "Sphere",
    "StartInCollisionError",
    "Trajectory",
    "default_limits",
    "read_safety",
]
