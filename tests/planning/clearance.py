"""The distance of an arm from its surroundings, by separate geometry code of the tests: no Pinocchio, no coal, no
checker.
"""

from collections.abc import Sequence

import numpy as np

from client.planning import Box, Plane, PlanningScene, Sphere
from urproto.robots import RobotModel
from urproto.robots.calibration import chain_of
from urproto.robots.pose import rotvec_to_matrix
from urproto.robots.shapes import cylinders

_ALONG = np.linspace(0.0, 1.0, 41)[:, None]
_ROUND = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[:, None]


class Clearance:
    """Measures the cylinders of the upper arm, the forearm and the wrists, and a round tool.

    Each cylinder is represented by spheres along its axis, inside it, and by points on its rims.
    """

    def __init__(self, model: RobotModel, scene: PlanningScene) -> None:
        self._frames = [(np.array(f.axes).reshape(3, 3), np.array(f.position)) for f in chain_of(model.dh)]
        self._parts = [[_parts(c.start, c.end, c.radius) for c in link] for link in cylinders(model)]
        self._scene = scene

    def __call__(self, q_rad: Sequence[float]) -> float:
        """The smallest distance [m] to an object of the scene, accurate to 1 mm given the spacing of the points."""
        places, radii = list[np.ndarray](), list[np.ndarray]()

        def put(points: np.ndarray, radius: float) -> None:
            places.append(place + points @ turn.T)
            radii.append(np.full(len(points), radius))

        turn, place = np.eye(3), np.zeros(3)
        for number, ((axes, position), angle) in enumerate(zip(self._frames, q_rad, strict=True), 1):
            place = place + turn @ position
            s, c = np.sin(angle), np.cos(angle)
            turn = turn @ axes @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            if number > 1:  # the shoulder turns on the spot
                for points, radius, rims in self._parts[number]:
                    put(points, radius)
                    put(rims, 0.0)
        for obj in self._scene.objects.values():
            if obj.attached:
                assert isinstance(obj.shape, Sphere)
                put(np.array(obj.pose[:3])[None], obj.shape.radius)
        points, radius = np.concatenate(places), np.concatenate(radii)
        around = [obj for obj in self._scene.objects.values() if not obj.attached]
        return min(float(np.min(_distance(points, obj.shape, obj.pose) - radius)) for obj in around)


def _parts(start: Sequence[float], end: Sequence[float], radius: float) -> tuple[np.ndarray, float, np.ndarray]:
    """The centres of the spheres, their radius, and the points of both rims."""
    first, last = np.array(start), np.array(end)
    length = float(np.linalg.norm(last - first))
    axis = (last - first) / length
    across = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    rim = radius * (np.cos(_ROUND) * across + np.sin(_ROUND) * np.cross(axis, across))
    ball = min(radius, 0.5 * length)
    middles = first + ball * axis + _ALONG * (length - 2.0 * ball) * axis
    return middles, ball, np.concatenate((first + rim, last + rim))


def _distance(points: np.ndarray, shape: object, pose: Sequence[float]) -> np.ndarray:
    inside = (points - np.array(pose[:3])) @ np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
    if isinstance(shape, Plane):
        return inside[:, 2]
    if isinstance(shape, Sphere):
        return np.linalg.norm(inside, axis=1) - shape.radius
    assert isinstance(shape, Box)
    beyond = abs(inside) - 0.5 * np.array(shape.size)
    return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
