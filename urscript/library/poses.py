"""Poses: the algebra of `urproto.robots.pose` under the names scripts use (Script Manual, module urmath).

Positions in m, rotation vectors in rad.
"""

from urproto.robots import pose
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Joints, ListArg, Num, Pose, PoseArg, is_number

LIBRARY = Library("poses", physical=True)


def _three(name: str, values: list[float]) -> list[float]:
    if len(values) != 3 or not all(map(is_number, values)):
        raise RuntimeFault(f"Type error: {name} expected a list of 3 numbers")
    return values


@LIBRARY.builtin(work=60)
def pose_add(p_1: PoseArg, p_2: PoseArg) -> Pose:
    """Positions added, rotations multiplied."""
    return Pose(pose.pose_add(p_1, p_2))


@LIBRARY.builtin(work=60)
def pose_sub(p_to: PoseArg, p_from: PoseArg) -> Pose:
    """The pose that `pose_add` adds to `p_from` to give `p_to`."""
    return Pose(pose.pose_sub(p_to, p_from))


@LIBRARY.builtin()
def pose_inv(p_from: PoseArg) -> Pose:
    """The inverse transformation."""
    return Pose(pose.pose_inv(p_from))


@LIBRARY.builtin(work=60)
def pose_trans(p_from: PoseArg, p_from_to: PoseArg) -> Pose:
    """`p_from_to`, given in the frame `p_from`, in the frame `p_from` is given in."""
    return Pose(pose.pose_trans(p_from, p_from_to))


@LIBRARY.builtin()
def pose_dist(p_from: PoseArg, p_to: PoseArg) -> float:
    """Distance of the positions of two poses [m]."""
    return pose.pose_dist(p_from, p_to)


@LIBRARY.builtin()
def point_dist(p_from: PoseArg, p_to: PoseArg) -> float:
    """Distance of the positions of two poses [m]."""
    return pose.point_dist(p_from, p_to)


@LIBRARY.builtin(work=60)
def interpolate_pose(p_from: PoseArg, p_to: PoseArg, alpha: Num) -> Pose:
    """The pose at the fraction `alpha` between `p_from` (0) and `p_to` (1); extrapolates beyond."""
    return Pose(pose.interpolate_pose(p_from, p_to, alpha))


@LIBRARY.builtin(work=60)
def rotvec2rpy(rotation_vector: ListArg) -> list[float]:
    """Rotation vector to roll, pitch, yaw [rad]."""
    return list(pose.rotvec_to_rpy(*_three("rotvec2rpy", rotation_vector)))


@LIBRARY.builtin(work=60)
def rpy2rotvec(rpy_vector: ListArg) -> list[float]:
    """Roll, pitch, yaw to rotation vector [rad]."""
    return list(pose.rpy_to_rotvec(*_three("rpy2rotvec", rpy_vector)))


@LIBRARY.builtin(cb3="3.10", e="5.0", work=60)  # Script Manuals CB3 3.10 and 3.15.4
def wrench_trans(T_from_to: PoseArg, w_from: Joints) -> list[float]:
    """The wrench `w_from` [N, Nm] moved to the frame `T_from_to`."""
    return list(pose.wrench_trans(T_from_to, w_from))
