"""Checks whether the arm can reach a target before the target is sent."""

import math
from collections.abc import Sequence
from typing import Final

from client.calibration import geometry_of
from client.driver.link import RobotLink
from client.errors import OutOfReachError
from urproto.external_control import MotionType, TrajectoryPoint
from urproto.joints import JOINT_LABELS
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo
from urproto.robots import Kinematics
from urproto.robots.pose import Pose, pose_inv, pose_trans

_JOINTS: Final = frozenset(
    [
        MotionType.MOVEJ,
        MotionType.OPTIMOVEJ,
        MotionType.MOVEL_JOINT,
        MotionType.MOVEP_JOINT,
        MotionType.MOVEC_JOINT,
        MotionType.MOVEC_POSE_JOINT,
        MotionType.OPTIMOVEL_JOINT,
        MotionType.SPLINE,
    ]
)
_SLACK: Final = 0.01  # of the distance; guess: calibrations differ by some millimetres in a metre
_ROUNDING_RAD: Final = 1e-6  # resolution of a number in the driver's messages


class Reach:
    """Reach of an arm at the joint angles ``q_rad``, with the TCP offset flange to TCP (6,) [m, rotation vector]."""

    def __init__(
        self,
        arm: ConfigurationData,
        tcp_offset: Sequence[float],
        q_rad: Sequence[float],
        calibration: KinematicsInfo | None = None,
    ) -> None:
        self._arm = arm
        self._tcp_inverse = pose_inv(tcp_offset)
        self._q_rad = q_rad
        self._limits = ((*arm.q_min[:5], -math.inf), (*arm.q_max[:5], math.inf))
        self._kinematics = geometry_of(arm, calibration)

    def check(self, operation: str, points: Sequence[TrajectoryPoint]) -> None:
        """Raise OutOfReachError for the first point that the arm cannot reach."""
        for number, point in enumerate(points):
            problem = self._find_problem(point)
            if problem is not None:
                which = f"point {number} " if len(points) > 1 else "the target "
                raise OutOfReachError(operation, which + problem, number)

    def _find_problem(self, point: TrajectoryPoint) -> str | None:
        if point.type in _JOINTS:
            return self._beyond_limits(point.target)
        if not self._reachable(point.target):
            return f"p[{_format(point.target)}] has no joint angles within the arm's limits: choose a nearer pose"
        return None

    def _beyond_limits(self, q_rad: Sequence[float]) -> str | None:
        without_wrist_3 = JOINT_LABELS[:-1]  # it has no end stop on some arms
        for name, low, angle, high in zip(without_wrist_3, self._arm.q_min, q_rad, self._arm.q_max, strict=False):
            if not low - _ROUNDING_RAD <= angle <= high + _ROUNDING_RAD:
                return f"needs {name} at {angle:.4f} rad, outside its limits of {low:.4f} to {high:.4f} rad"
        return None

    def _reachable(self, pose_base_tcp: Sequence[float]) -> bool:
        if self._kinematics is None:
            return True
        flange = pose_trans(pose_base_tcp, self._tcp_inverse)
        scales = (1.0, 1.0 - _SLACK, 1.0 + _SLACK)
        return any(self._has_solution(self._kinematics, self._scaled(flange, scale)) for scale in scales)

    def _scaled(self, pose: Pose, scale: float) -> Pose:
        """Move a pose towards the shoulder (scale below 1) or away from it."""
        height = self._arm.dh_d[0]
        x, y, z, *turn = pose
        rx, ry, rz = turn
        return (x * scale, y * scale, height + (z - height) * scale, rx, ry, rz)

    def _has_solution(self, kinematics: Kinematics, flange: Pose) -> bool:
        return kinematics.inverse_near(flange, self._q_rad, *self._limits) is not None


def reach_of(link: RobotLink, q_rad: Sequence[float]) -> Reach | None:
    """Reach of a connected robot with the TCP that it reports; None until it has reported its arm and TCP."""
    arm, state = link.configuration, link.primary_state
    if arm is None or state is None or state.cartesian is None:
        return None
    return Reach(arm, state.cartesian.tcp_offset, q_rad, link.calibration)


def _format(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4f}" for value in values)
