"""How far an arm is from what is around it, by geometry of the tests' own: no Pinocchio, no coal, no checker."""

from collections.abc import Sequence

import numpy as np

from client.planning import Box, Plane, PlanningScene, Sphere
from urproto.robots import Kinematics, RobotModel
from urproto.robots.pose import rotvec_to_matrix
from urproto.robots.shapes import ArmCapsules

_ALONG = np.linspace(0.0, 1.0, 41)[:, None]


class Clearance:
    """Of the upper arm, the forearm, the wrists and a round tool, by points along their axes."""

    def __init__(self, model: RobotModel, scene: PlanningScene) -> None:
        self._capsules = ArmCapsules(model)
        self._kinematics = Kinematics(model.dh)
        self._scene = scene

    def __call__(self, q_rad: Sequence[float]) -> float:
        """The least distance to a thing of the scene [m]: to 1 mm, as the points are near each other."""
        balls = []
        for number, (start, end) in enumerate(self._capsules.axes(q_rad)):
            if number == 0:  # the base
                continue
            stop = np.array(end)
            if number == 5:  # the flange is where the housing of wrist 3 ends
                way = stop - np.array(start)
                stop = stop - way / np.linalg.norm(way) * self._capsules.radii[number]
            balls.append((np.array(start) + _ALONG * (stop - np.array(start)), self._capsules.radii[number]))
        for thing in self._scene.objects.values():
            if thing.attached:
                assert isinstance(thing.shape, Sphere)
                tip = self._kinematics.forward(q_rad, thing.pose)
                balls.append((np.array([tip[:3]]), thing.shape.radius))
        around = [thing for thing in self._scene.objects.values() if not thing.attached]
        return min(
            float(np.min(_distance(points, thing.shape, thing.pose))) - radius
            for points, radius in balls
            for thing in around
        )


def _distance(points: np.ndarray, shape: object, pose: Sequence[float]) -> np.ndarray:
    inside = (points - np.array(pose[:3])) @ np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
    if isinstance(shape, Plane):
        return inside[:, 2]
    if isinstance(shape, Sphere):
        return np.linalg.norm(inside, axis=1) - shape.radius
    assert isinstance(shape, Box)
    beyond = abs(inside) - 0.5 * np.array(shape.size)
    return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
