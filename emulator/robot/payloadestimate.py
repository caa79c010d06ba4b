"""Mass and centre of gravity of a payload, from the wrenches it exerts in several orientations.

In the flange's axes, the payload's weight rotates from pose to pose while the sensor's offset
stays constant. Both are solved for by least squares, so a sensor that was zeroed in one of the
poses gives the same result (that the controller does so too is a guess).
"""

import math
from collections.abc import Sequence
from typing import Final

from urproto.robots.pose import pose_inv, pose_sub, rotvec_to_matrix
from urproto.vectors import ZERO3, Vector3, cross, dot, rotate

MIN_POSES: Final = 4  # Script Manual, estimate_payload
_SINGULAR: Final = 1e-6  # a smaller spread of the weights is not sufficient
_NO_MASS_KG: Final = 1e-9  # a smaller mass has no defined centre of gravity


class EstimateError(ValueError):
    """The measurements do not determine the payload."""


def estimate_payload(
    flange_poses: Sequence[Sequence[float]], wrenches: Sequence[Sequence[float]], gravity: Vector3
) -> tuple[float, Vector3]:
    """Mass [kg] and centre of gravity in the flange frame [m].

    ``flange_poses`` in the base frame; ``wrenches`` that the payload exerts on the flange, at the
    flange, in base axes [N, Nm]; ``gravity`` as set_gravity [m/s2]. Raises EstimateError.
    """
    if len(flange_poses) < MIN_POSES or len(wrenches) != len(flange_poses):
        raise EstimateError(f"{len(flange_poses)} poses and {len(wrenches)} wrenches: give {MIN_POSES} or more of each")
    _check_spread(flange_poses)
    pulls, forces, torques = [], [], []
    for pose, wrench in zip(flange_poses, wrenches, strict=True):
        axes = rotvec_to_matrix(*pose_inv(pose)[3:])
        pulls.append(rotate(axes, [-part for part in gravity]))
        forces.append(rotate(axes, wrench[:3]))
        torques.append(rotate(axes, wrench[3:]))
    pulls, forces, torques = _varying(pulls), _varying(forces), _varying(torques)
    spread = sum(dot(pull, pull) for pull in pulls)
    if spread <= _SINGULAR:
        raise EstimateError("the weight has the same direction in all poses: tilt the tool instead of only rotating it")
    mass = sum(dot(pull, force) for pull, force in zip(pulls, forces, strict=True)) / spread
    if abs(mass) < _NO_MASS_KG:
        return mass, ZERO3
    x, y, z = _lever(pulls, torques, spread)
    return mass, (x / mass, y / mass, z / mass)


def _check_spread(poses: Sequence[Sequence[float]]) -> None:
    """Script Manual: no two orientations may be closer than pi / 2n."""
    least = math.pi / (2 * len(poses))
    for i, one in enumerate(poses):
        for k, other in enumerate(poses[:i]):
            angle = math.hypot(*pose_sub(one, other)[3:])
            if angle < least:
                raise EstimateError(
                    f"the orientations of poses {k} and {i} differ by only {angle:.3f} rad; with {len(poses)} poses, "
                    f"any two must differ by {least:.3f} rad or more"
                )


def _lever(pulls: list[Vector3], torques: list[Vector3], spread: float) -> Vector3:
    """c of c x pull = torque, by least squares: the normal equations by Cramer's rule."""
    rows = [
        [sum((dot(p, p) if i == k else 0.0) - p[i] * p[k] for p in pulls) / spread for k in range(3)] for i in range(3)
    ]
    moments = [cross(pull, torque) for pull, torque in zip(pulls, torques, strict=True)]
    right = [sum(moment[i] for moment in moments) / spread for i in range(3)]
    volume = dot(rows[0], cross(rows[1], rows[2]))
    if volume <= _SINGULAR:
        raise EstimateError("the weight rotates about one axis only: tilt the tool about a second axis too")
    columns = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])]
    x, y, z = (sum(columns[i][k] * right[i] for i in range(3)) / volume for k in range(3))
    return (x, y, z)


def _varying(vectors: list[Vector3]) -> list[Vector3]:
    """The vectors without their mean."""
    mean = [sum(vector[i] for vector in vectors) / len(vectors) for i in range(3)]
    return [(v[0] - mean[0], v[1] - mean[1], v[2] - mean[2]) for v in vectors]
