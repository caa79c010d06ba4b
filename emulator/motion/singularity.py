"""How far an arm is from a singular configuration."""

from math import cos, sin

from emulator.motion.vectors import Joints
from urproto.robots.model import DH

__all__ = ["dexterity", "distance_to_singularity"]


def dexterity(dh: DH, q_rad: Joints) -> float:
    """The square of the Jacobian's determinant, from its three factors: what controllers call the robot's dexterity.

    Found in captures of a UR5e and a UR3e simulator and of a UR10, which agree with it to all digits.
    """
    factor = dh.a[1] * dh.a[2] * sin(q_rad[2]) * sin(q_rad[4]) * _outward(dh, q_rad)
    return factor * factor


def distance_to_singularity(dh: DH, q_rad: Joints) -> float:
    """0 in a singularity, up to 1 far from each: the smallest of three factors of the Jacobian's determinant.

    Elbow: stretched or folded. Wrist: joints 4 and 6 parallel. Shoulder: the wrist above the base joint's axis; how far
    it is from there, as a share of the two long links.
    """
    outward = _outward(dh, q_rad) / (abs(dh.a[1]) + abs(dh.a[2]))
    return min(abs(sin(q_rad[2])), abs(sin(q_rad[4])), abs(outward))


def _outward(dh: DH, q_rad: Joints) -> float:
    """How far the wrist is from the base joint's axis [m], along the arm's plane."""
    _, q2, q3, q4, _, _ = q_rad
    return dh.a[1] * cos(q2) + dh.a[2] * cos(q2 + q3) + dh.d[4] * sin(q2 + q3 + q4)
