"""Trajectories made ready for a controller: all joints in its order, and joined to the one under way.

Replacement follows the documentation of ros2_controllers ("Trajectory Replacement"): the old
trajectory counts until the new one's start, the new one from there on, with the same speed at
the seam; points in the past are left out. Joints that the new one leaves out go on as before.
"""

from collections.abc import Sequence
from dataclasses import replace

from client.controllers.goals import JointTrajectory, JointTrajectoryPoint
from client.controllers.trajectory import Path

__all__ = ["blended", "filled"]


def filled(trajectory: JointTrajectory, joints: Sequence[str], hold_rad: Sequence[float]) -> list[JointTrajectoryPoint]:
    """Its points for all joints; joints it does not name stay at ``hold_rad`` (n,)."""
    holding = JointTrajectoryPoint(tuple(hold_rad), *((0.0,) * len(joints),) * 3)
    return [_merged(point, trajectory.joint_names, joints, holding) for point in trajectory.points]


def blended(
    trajectory: JointTrajectory, joints: Sequence[str], path: Path, cursor_s: float, begin_s: float
) -> tuple[list[JointTrajectoryPoint], int] | None:
    """Points that lead from the path into the trajectory, timed from ``cursor_s`` on, and how many of them are old.

    cursor_s: how far the path has been followed; begin_s: where the trajectory begins, both in
    the path's time. None when it leaves joints out and does not say where the others end.
    """
    named = set(trajectory.joint_names)
    partial = len(named) < len(joints)
    if partial and not trajectory.points[-1].positions:
        return None
    bridge_s = max(begin_s, cursor_s)
    bridge = path.sample(bridge_s)
    new = []
    for point in trajectory.points:
        due_s = begin_s + point.time_from_start_s
        if due_s > bridge_s or point is trajectory.points[-1]:
            old = path.sample(due_s) if partial else None
            place = old.point if old else JointTrajectoryPoint((0.0,) * len(joints))
            new.append(_at(_merged(point, trajectory.joint_names, joints, place), due_s - cursor_s))
    prefix = [_at(point, due_s - cursor_s) for due_s, point in path.due() if cursor_s < due_s < bridge_s]
    if bridge is not None and bridge_s - cursor_s < new[0].time_from_start_s:
        prefix.append(_at(bridge.point, bridge_s - cursor_s))
    end_s = cursor_s + new[-1].time_from_start_s
    rest = [(due_s, point) for due_s, point in path.due() if due_s > end_s] if partial else []
    suffix = [_at(_held(point, new[-1], joints, named), due_s - cursor_s) for due_s, point in rest]
    return [*prefix, *new, *suffix], len(prefix)


def _merged(
    point: JointTrajectoryPoint, names: Sequence[str], joints: Sequence[str], others: JointTrajectoryPoint
) -> JointTrajectoryPoint:
    """The point in the order of the joints; those it does not name are as in ``others``."""

    def one(values: Sequence[float], rest: Sequence[float]) -> tuple[float, ...]:
        if not values:
            return ()
        by_name = dict(zip(names, values, strict=True))
        return tuple(by_name.get(joint, rest[place] if rest else 0.0) for place, joint in enumerate(joints))

    return JointTrajectoryPoint(
        one(point.positions, others.positions),
        one(point.velocities, others.velocities),
        one(point.accelerations, others.accelerations),
        one(point.effort, others.effort),
        point.time_from_start_s,
    )


def _held(
    point: JointTrajectoryPoint, last: JointTrajectoryPoint, joints: Sequence[str], named: set[str]
) -> JointTrajectoryPoint:
    """The point with the named joints at rest where they ended."""
    commanded = [joint in named for joint in joints]

    def one(values: Sequence[float], ends: Sequence[float]) -> tuple[float, ...]:
        pairs = zip(commanded, values, ends or (0.0,) * len(joints), strict=True) if values else ()
        return tuple(end if held else value for held, value, end in pairs)

    return replace(
        point,
        positions=one(point.positions, last.positions),
        velocities=one(point.velocities, ()),
        accelerations=one(point.accelerations, ()),
    )


def _at(point: JointTrajectoryPoint, time_from_start_s: float) -> JointTrajectoryPoint:
    return replace(point, time_from_start_s=time_from_start_s)
