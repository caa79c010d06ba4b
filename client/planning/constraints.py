"""Path constraints: an orientation with tolerances, and a box for the TCP."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import asin, atan2, pi
from typing import Final

import numpy as np

from client.errors import PlanningError
from client.planning.collisions import CollisionChecker
from client.planning.parameterisation import Array
from client.planning.scene import PlanningScene
from client.quantities import check_fields
from urproto.robots.pose import Pose, pose_inv, pose_trans, rotvec_to_matrix
from urproto.vectors import ZERO6, Vector3, as_six

_RESOLUTION_RAD: Final = 0.02  # between checks on a path (guess): the TCP rotates by less than six times this
_AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class OrientationConstraint:
    """Keep the TCP within tolerances of an orientation.

    orientation: rotation vector [rad] (3,) in the base frame. tolerance_rad: in both directions about x, y and z (3,)
    of the rotations Rx Ry Rz from the given to the actual orientation, as MoveIt's XYZ_EULER_ANGLES. The tolerances
    about x and y are below pi/2; pi about z leaves that rotation free. To keep a tool level, give an orientation with a
    vertical z.
    """

    orientation: Vector3
    tolerance_rad: Vector3

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)
        if max(self.tolerance_rad[:2]) >= pi / 2:
            raise PlanningError(f"tolerances about x and y must be below pi/2, not {list(self.tolerance_rad)}")

    def excess(self, pose: Pose) -> Array:
        """How far each rotation exceeds its tolerance [rad] (3,), with its sign."""
        target = (0.0, 0.0, 0.0, *self.orientation)
        r = rotvec_to_matrix(*pose_trans(pose_inv(target), (0.0, 0.0, 0.0, *pose[3:]))[3:])
        turns = (atan2(-r[5], r[8]), asin(max(-1.0, min(1.0, r[2]))), atan2(-r[1], r[0]))
        return _excess_over(np.array(turns), np.array(self.tolerance_rad))


@dataclass(frozen=True, slots=True)
class PositionConstraint:
    """Keep the TCP in a box. size: edge lengths [m] (3,); pose: of the box's centre in the base frame."""

    size: Vector3
    pose: Sequence[float] = ZERO6

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)

    def excess(self, pose: Pose) -> Array:
        """How far the TCP is outside the box along its axes [m] (3,), with its sign."""
        inside = pose_trans(pose_inv(self.pose), pose)[:3]
        return _excess_over(np.array(inside), 0.5 * np.array(self.size))


@dataclass(frozen=True, slots=True)
class PathConstraints:
    """Constraints along a whole path. tcp_offset: flange to TCP, as in a `PoseGoal`."""

    orientation: OrientationConstraint | None = None
    position: PositionConstraint | None = None
    tcp_offset: Sequence[float] | None = None

    def __post_init__(self) -> None:
        check_fields(self, PlanningError)

    def excess(self, pose: Pose) -> Array:
        """How far a pose exceeds the orientation [rad] and the position [m]: three numbers per constraint."""
        parts = [part.excess(pose) for part in (self.orientation, self.position) if part is not None]
        return np.concatenate([np.zeros(0), *parts])

    def violation(self, pose: Pose) -> str:
        """Which constraints a pose violates, and by how much; "" if none."""
        broken = []
        for part, name, unit, scale in (
            (self.orientation, "is rotated about", "rad", 1.0),
            (self.position, "is displaced along", "mm", 1000.0),
        ):
            for axis, over in zip(_AXES, () if part is None else part.excess(pose), strict=False):
                if over:
                    broken.append(
                        f"the TCP {name} {axis} by {_format(abs(scale * over))} {unit} more than the constraint allows"
                    )
        return "; ".join(broken)


class ConstrainedChecker(CollisionChecker):
    """A collision checker that treats the violation of a constraint as a collision."""

    def __init__(self, scene: PlanningScene, constraints: PathConstraints) -> None:
        super().__init__(scene)
        self.constraints = constraints

    def is_free(self, q_rad: Sequence[float] | Array) -> bool:
        """Whether the configuration is free of collisions and satisfies the constraints."""
        return self.satisfies_constraints(q_rad) and super().is_free(q_rad)

    def blocked_at(self, path: Callable[[float], Array], travel_rad: Array) -> float | None:
        """As in `CollisionChecker`. Constraints are checked every 0.02 rad of the joint that moves farthest."""
        samples = np.linspace(0.0, 1.0, 2 + int(travel_rad.max() / _RESOLUTION_RAD))
        for share in samples.tolist():
            if not self.satisfies_constraints(path(share)):
                return float(share)
        return super().blocked_at(path, travel_rad)

    def violation(self, q_rad: Sequence[float]) -> str:
        """Which constraint or joint limit is violated, or what is in collision; "" for a valid configuration."""
        return self.constraints.violation(self._pose(q_rad)) or super().violation(q_rad)

    def satisfies_constraints(self, q_rad: Sequence[float] | Array) -> bool:
        return not self.excess(q_rad).any()

    def excess(self, q_rad: Sequence[float] | Array) -> Array:
        return self.constraints.excess(self._pose(q_rad))

    def _pose(self, q_rad: Sequence[float] | Array) -> Pose:
        offset = self.constraints.tcp_offset
        return self.scene.kinematics.forward(as_six(q_rad), ZERO6 if offset is None else offset)


def _excess_over(values: Array, limit: Array) -> Array:
    over: Array = np.sign(values) * np.maximum(abs(values) - limit - 1e-9, 0.0)
    return over


def _format(number: float) -> str:
    return f"{number:.0f}" if number >= 100.0 else f"{number:.3g}"
