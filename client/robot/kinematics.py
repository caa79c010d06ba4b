"""Kinematics, dynamics and other values as the controller itself knows them, during any motion.

The queries are answered by the control program, which the first of them starts, as the first motion does. Joint angles
are (6,) [rad], poses base to TCP (6,) [m, rotation vector]; arguments that are left out default to the robot's present
values. Matrices are six rows of six. Queries raise the same errors as moves, RobotRefused for a feature that the
PolyScope version lacks, and NoAnswerError.
"""

from collections.abc import Sequence
from typing import Final, cast

from client.quantities import checked
from client.robot.readiness import Readiness
from urproto.external_control import Query
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_trans

Matrix = tuple[Joints, ...]
Numbers = Sequence[float]

_SIX: Final = 6


@checked
class Kinematics:
    """Forward and inverse kinematics, safety limits and Jacobians, computed by the controller."""

    def __init__(self, readiness: Readiness) -> None:
        self._query = readiness.query

    async def forward(self, q_rad: Numbers | None = None, tcp_offset: Numbers | None = None) -> Pose:
        """Pose of the TCP (6,) at these joint angles, with this TCP offset."""
        return cast(Pose, await self._query("forward", Query.FORWARD_KIN, q_rad, None, tcp_offset))

    async def inverse(
        self, pose_base_tcp: Numbers, near_q_rad: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> Joints | None:
        """Joint angles (6,) for a pose, nearest to ``near_q_rad``; None without a solution. PolyScope 3.15, 5.10."""
        arguments = (pose_base_tcp, near_q_rad, tcp_offset)
        values = await self._query("inverse", Query.INVERSE_KIN, *arguments, gate="inverse_kin")
        return cast(Joints, values) if values else None

    async def has_solution(
        self, pose_base_tcp: Numbers, near_q_rad: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> bool:
        """Whether `inverse` has a solution; PolyScope 3.15 and 5.10 or newer."""
        arguments = (pose_base_tcp, near_q_rad, tcp_offset)
        query = Query.INVERSE_KIN_HAS_SOLUTION
        return bool((await self._query("has_solution", query, *arguments, gate="inverse_kin"))[0])

    async def pose_within_limits(self, pose_base_tcp: Numbers) -> bool:
        """Whether the pose is within the safety limits."""
        return bool((await self._query("limits", Query.POSE_WITHIN_SAFETY_LIMITS, pose_base_tcp))[0])

    async def joints_within_limits(self, q_rad: Numbers) -> bool:
        """Whether the joint angles are within the safety limits."""
        return bool((await self._query("limits", Query.JOINTS_WITHIN_SAFETY_LIMITS, q_rad))[0])

    async def jacobian(self, q_rad: Numbers | None = None, tcp_offset: Numbers | None = None) -> Matrix:
        """Jacobian of the TCP in the base frame (6, 6): linear rows, then angular rows; PolyScope 5.23 or newer."""
        answer = await self._query("jacobian", Query.JACOBIAN, q_rad, None, tcp_offset, gate="dynamics")
        return _matrix(answer)

    async def jacobian_time_derivative(
        self, q_rad: Numbers | None = None, qd_rad_s: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> Matrix:
        """Time derivative of the Jacobian (6, 6) at these joint speeds (6,) [rad/s]; PolyScope 5.23 or newer."""
        arguments = (q_rad, qd_rad_s, tcp_offset)
        query = Query.JACOBIAN_TIME_DERIVATIVE
        return _matrix(await self._query("jacobian", query, *arguments, gate="dynamics"))

    async def flange_pose(self) -> Pose:
        """Pose of the tool flange (6,), as measured."""
        return cast(Pose, await self._query("flange_pose", Query.FLANGE_POSE))

    async def freedrive_status(self) -> int:
        """Distance to a singularity: 0 far, 1 near, 2 too near for constrained freedrive; PolyScope 5.10 or newer."""
        return round((await self._query("freedrive_status", Query.FREEDRIVE_STATUS, gate="freedrive_axes"))[0])

    @staticmethod
    def pose_trans(pose_from: Numbers, pose_from_to: Numbers) -> Pose:
        """Concatenate two poses (6,), like URScript's pose_trans; computed locally."""
        return pose_trans(pose_from, pose_from_to)


@checked
class Dynamics:
    """Mass matrix, torques and accelerations, computed by the controller."""

    def __init__(self, readiness: Readiness) -> None:
        self._query = readiness.query

    async def mass_matrix(self, q_rad: Numbers | None = None, *, include_rotors: bool = False) -> Matrix:
        """Joint-space mass matrix, including the payload (6, 6) [kg m2]; PolyScope 5.23 or newer."""
        number = int(include_rotors)
        return _matrix(await self._query("mass_matrix", Query.MASS_MATRIX, q_rad, number=number, gate="dynamics"))

    async def coriolis_torques(self, q_rad: Numbers | None = None, qd_rad_s: Numbers | None = None) -> Joints:
        """Coriolis and centrifugal torques (6,) [Nm] at these joint speeds (6,) [rad/s]; PolyScope 5.23 or newer."""
        query = Query.CORIOLIS_AND_CENTRIFUGAL_TORQUES
        return cast(Joints, await self._query("coriolis_torques", query, q_rad, qd_rad_s, gate="dynamics"))

    async def joint_torques(self) -> Joints:
        """External joint torques (6,) [Nm]: those beyond what moves and holds the arm."""
        return cast(Joints, await self._query("joint_torques", Query.JOINT_TORQUES))

    async def target_accelerations(self) -> Joints:
        """Commanded joint accelerations (6,) [rad/s2]; PolyScope 5.23 or newer.

        RTDE offers the same from 3.3 on: ``state.values["target_qdd"]``.
        """
        query = Query.TARGET_JOINT_ACCELERATIONS
        return cast(Joints, await self._query("target_accelerations", query, gate="dynamics"))


def _matrix(values: Numbers) -> Matrix:
    return tuple(cast(Joints, tuple(values[start : start + _SIX])) for start in range(0, len(values), _SIX))


class Queries:
    """The queries of `AsyncRobot`; those about kinematics and dynamics have their own components."""

    def __init__(self, readiness: Readiness) -> None:
        self._query = readiness.query

    async def tcp_offset(self) -> Pose:
        """The active TCP as a pose in the flange frame (6,) [m, rotation vector]; PolyScope 3.6 or newer."""
        return cast(Pose, await self._query("tcp_offset", Query.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured ``steps`` control periods ago; PolyScope 5.4 or newer."""
        return cast(Joints, await self._query("history", Query.JOINT_POSITIONS_HISTORY, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has been at rest for a while, and is in neither force mode nor freedrive."""
        return bool((await self._query("is_steady", Query.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self._query("step_time", Query.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Target TCP pose (6,) [m, rotation vector] of the move under way; PolyScope 5.3 or newer."""
        return cast(Pose, await self._query("target_waypoint", Query.TARGET_WAYPOINT, gate="target_waypoint"))
