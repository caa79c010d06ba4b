"""Distances of the arm from its boundaries: planes, the tool's orientation, and its own lower arm."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import acos, dist, inf
from typing import Final

from emulator.robot.arm import Arm
from urproto.modes import SafetyMode
from urproto.robots.model import RobotModel
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import Vector3, rotate
from urscript.polyscope.safety_configuration import BoundaryMode, Plane, SafetyConfiguration, ToolOrientation

# Between the sphere around the flange and the cylinder around the lower arm: 28 mm on a UR5e with 5.8 (vendor's answer
# in its forum, thread 16142, which has the radii of the model's data). 2 mm more, because a pose that is reported to
# stop a UR5e is 29.7 mm away here. That other arms keep the same distance is a guess.
_CLAMPING_GAP_M: Final = 0.028 + 0.002

_MODES: Final = {
    SafetyMode.NORMAL: (BoundaryMode.NORMAL, BoundaryMode.BOTH),
    SafetyMode.REDUCED: (BoundaryMode.REDUCED, BoundaryMode.BOTH),
}


@dataclass(frozen=True, slots=True)
class Point:
    """A monitored point of the arm in the base frame: the TCP, a tool sphere, or the elbow."""

    at: Vector3
    speed: Vector3
    radius: float = 0.0
    is_elbow: bool = False


class Boundaries:
    """Planes and orientation limit of one configuration, by the safety mode in which they apply."""

    def __init__(self, configuration: SafetyConfiguration, elbow_radius_m: float) -> None:
        self._configuration = configuration
        self._elbow_radius = elbow_radius_m
        self.triggers = tuple(p for p in configuration.planes if p.mode is BoundaryMode.TRIGGER)
        self._planes = {
            mode: tuple(p for p in configuration.planes if p.mode in counting) for mode, counting in _MODES.items()
        }

    @property
    def any(self) -> bool:
        return bool(self._configuration.planes or self._configuration.tool_orientation)

    def planes(self, mode: SafetyMode) -> tuple[Plane, ...]:
        """Planes that limit positions in this mode."""
        return self._planes.get(mode, ())

    def orientation(self, mode: SafetyMode) -> ToolOrientation | None:
        """Limit of the tool's direction in this mode."""
        orientation = self._configuration.tool_orientation
        return orientation if orientation and orientation.mode in _MODES.get(mode, ()) else None

    def points(self, arm: Arm) -> list[Point]:
        """All points that planes restrict."""
        x, y, z, *_ = arm.tcp_pose
        u, v, w, *_ = arm.tcp_speed
        found = [
            Point((x, y, z), (u, v, w)),
            Point(arm.elbow_position, arm.elbow_velocity, self._elbow_radius, is_elbow=True),
        ]
        return [*found, *self._spheres(arm)]

    def _spheres(self, arm: Arm) -> Iterator[Point]:
        spheres = self._configuration.tool_spheres
        if not spheres:
            return
        axes = rotvec_to_matrix(*arm.flange_pose[3:])
        u, v, w, p, q, r = arm.tcp_speed
        for sphere in spheres:
            place = rotate(axes, sphere.centre)
            at = (arm.flange_pose[0] + place[0], arm.flange_pose[1] + place[1], arm.flange_pose[2] + place[2])
            x, y, z = at[0] - arm.tcp_pose[0], at[1] - arm.tcp_pose[1], at[2] - arm.tcp_pose[2]
            yield Point(at, (u + q * z - r * y, v + r * x - p * z, w + p * y - q * x), sphere.radius)

    def beyond_trigger(self, arm: Arm, hysteresis: float) -> bool:
        """Whether a monitored point is beyond a trigger plane by more than ``hysteresis`` [m], possibly negative."""
        return any(
            plane.depth(point.at) - point.radius < -hysteresis
            for plane in self.triggers
            for point in self.points(arm)
            if plane.elbow or not point.is_elbow
        )


def tool_deviation(orientation: ToolOrientation, arm: Arm) -> float:
    """Angle between the tool's direction and the configured one [rad]."""
    x, y, z = rotate(rotvec_to_matrix(*arm.flange_pose[3:]), orientation.tool_direction)
    u, v, w = orientation.direction
    return acos(min(1.0, max(-1.0, x * u + y * v + z * w)))


def clamping_room(model: RobotModel, arm: Arm) -> float:
    """How far the flange may still come towards the lower arm before it could clamp a hand [m]; infinite on CB3."""
    shapes = model.clamping
    if shapes is None:
        return inf
    ax, ay, az = arm.kinematics.elbow_position(arm.q, shapes.lower_arm_offset)
    bx, by, bz = arm.kinematics.wrist_position(arm.q, shapes.lower_arm_offset)
    x, y, z, *_ = arm.flange_pose
    ux, uy, uz = bx - ax, by - ay, bz - az
    length = model.dh.a[2] * model.dh.a[2]
    share = ((x - ax) * ux + (y - ay) * uy + (z - az) * uz) / length
    share = min(1.0, max(0.0, share))
    distance = dist((x, y, z), (ax + share * ux, ay + share * uy, az + share * uz))
    return distance - shapes.flange_radius - shapes.lower_arm_radius - _CLAMPING_GAP_M
