"""Frames as 4x4 matrices, straight from the definitions, as a reference for kinematics."""

import math

import numpy as np

from urproto.robots import DH, Joints
from urproto.robots.pose import Pose, rotvec_to_matrix


def transform(pose: Pose) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(rotvec_to_matrix(*pose[3:])).reshape(3, 3)
    matrix[:3, 3] = pose[:3]
    return matrix


def product_of_links(dh: DH, q: Joints) -> np.ndarray:
    """Forward kinematics as the Denavit-Hartenberg definition reads."""
    total = np.eye(4)
    for a, d, alpha, theta, angle in zip(dh.a, dh.d, dh.alpha, dh.theta, q, strict=True):
        s, c, sa, ca = math.sin(theta + angle), math.cos(theta + angle), math.sin(alpha), math.cos(alpha)
        link = ((c, -s * ca, s * sa, a * c), (s, c * ca, -c * sa, a * s), (0, sa, ca, d), (0, 0, 0, 1))
        total = total @ np.array(link)
    return total
