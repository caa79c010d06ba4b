"""How far an arm is from a singular configuration."""

from math import cos, sin

from emulator.motion.vectors import Joints
from urproto.robots.model import DH

__all__ = ["distance_to_singularity"]


def distance_to_singularity(dh: DH, q_rad: Joints) -> float:
    """0 in a singularity, up to 1 far from each: the smallest of three factors of the Jacobian's determinant.

    Elbow: stretched or folded. Wrist: joints 4 and 6 parallel. Shoulder: the wrist above the base joint's axis; how far
    it is from there, as a share of the two long links.
    """
    _, q2, q3, q4, q5, _ = q_rad
    outward = dh.a[1] * cos(q2) + dh.a[2] * cos(q2 + q3) + dh.d[4] * sin(q2 + q3 + q4)
    return min(abs(sin(q3)), abs(sin(q5)), abs(outward) / (abs(dh.a[1]) + abs(dh.a[2])))
