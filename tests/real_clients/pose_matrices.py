"""Rotation vectors and poses as matrices, for independent calculations."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_matrix(rotation_vector: Sequence[float]) -> Array:
    """Rodrigues' formula, (3, 3)."""
    vector = np.array(rotation_vector, dtype=float)
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def transform(pose: Sequence[float]) -> Array:
    """Homogeneous matrix (4, 4) of a UR pose."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_matrix(pose[3:]), pose[:3]
    return matrix
