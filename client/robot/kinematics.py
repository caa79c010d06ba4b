"""What the controller itself says about its geometry and dynamics: asked for, beside any motion.

The control program is asked, so it has to run: the first question starts it as the first motion does.
Joint angles are (6,) [rad], poses base to TCP (6,) [m, rotation vector]; what is left out is the
robot's present one. Matrices are six rows of six. Raises the errors of the moves, RobotRefused for what
a PolyScope version lacks, and NoAnswerError.
"""

from collections.abc import Sequence
from typing import Final, cast

from client.robot.readiness import Readiness
from urproto.external_control import Question
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_trans

Matrix = tuple[Joints, ...]
Numbers = Sequence[float]

_SIX: Final = 6


class Kinematics:
    """Where the arm would be, how it gets there, and whether it may."""

    def __init__(self, readiness: Readiness) -> None:
        self._ask = readiness.ask

    async def forward(self, q_rad: Numbers | None = None, tcp_offset: Numbers | None = None) -> Pose:
        """Pose of the TCP (6,) with these joint angles and this TCP."""
        return cast(Pose, await self._ask("forward", Question.FORWARD_KIN, q_rad, None, tcp_offset))

    async def inverse(
        self, pose_base_tcp: Numbers, near_q_rad: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> Joints | None:
        """Joint angles (6,) of a pose, those nearest to ``near_q_rad``; None if there are none. From 3.15, 5.10 on."""
        arguments = (pose_base_tcp, near_q_rad, tcp_offset)
        values = await self._ask("inverse", Question.INVERSE_KIN, *arguments, gate="inverse_kin")
        return cast(Joints, values) if values else None

    async def has_solution(
        self, pose_base_tcp: Numbers, near_q_rad: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> bool:
        """Whether `inverse` finds joint angles. From 3.15 and 5.10 on."""
        arguments = (pose_base_tcp, near_q_rad, tcp_offset)
        question = Question.INVERSE_KIN_HAS_SOLUTION
        return bool((await self._ask("has_solution", question, *arguments, gate="inverse_kin"))[0])

    async def pose_within_limits(self, pose_base_tcp: Numbers) -> bool:
        """Whether the safety limits let the TCP be there."""
        return bool((await self._ask("limits", Question.POSE_WITHIN_SAFETY_LIMITS, pose_base_tcp))[0])

    async def joints_within_limits(self, q_rad: Numbers) -> bool:
        """Whether the safety limits let the joints be there."""
        return bool((await self._ask("limits", Question.JOINTS_WITHIN_SAFETY_LIMITS, q_rad))[0])

    async def jacobian(self, q_rad: Numbers | None = None, tcp_offset: Numbers | None = None) -> Matrix:
        """Of the TCP in the base frame (6, 6): linear rows, then angular. From 5.23 on."""
        answer = await self._ask("jacobian", Question.JACOBIAN, q_rad, None, tcp_offset, gate="dynamics")
        return _matrix(answer)

    async def jacobian_time_derivative(
        self, q_rad: Numbers | None = None, qd_rad_s: Numbers | None = None, tcp_offset: Numbers | None = None
    ) -> Matrix:
        """Of the Jacobian (6, 6), at these joint speeds (6,) [rad/s]. From 5.23 on."""
        arguments = (q_rad, qd_rad_s, tcp_offset)
        question = Question.JACOBIAN_TIME_DERIVATIVE
        return _matrix(await self._ask("jacobian", question, *arguments, gate="dynamics"))

    async def flange_pose(self) -> Pose:
        """Pose of the tool flange (6,), as measured."""
        return cast(Pose, await self._ask("flange_pose", Question.FLANGE_POSE))

    async def freedrive_status(self) -> int:
        """How close a singularity is: 0 far, 1 near, 2 too near for constrained freedrive. From 5.10 on."""
        return round((await self._ask("freedrive_status", Question.FREEDRIVE_STATUS, gate="freedrive_axes"))[0])

    @staticmethod
    def pose_trans(pose_from: Numbers, pose_from_to: Numbers) -> Pose:
        """A pose seen from another one (6,); asks nobody."""
        return pose_trans(pose_from, pose_from_to)


class Dynamics:
    """What it takes to move the arm."""

    def __init__(self, readiness: Readiness) -> None:
        self._ask = readiness.ask

    async def mass_matrix(self, q_rad: Numbers | None = None, *, include_rotors: bool = False) -> Matrix:
        """Of the joints, with payload (6, 6) [kg m2]. From 5.23 on."""
        number = int(include_rotors)
        return _matrix(await self._ask("mass_matrix", Question.MASS_MATRIX, q_rad, number=number, gate="dynamics"))

    async def coriolis_torques(self, q_rad: Numbers | None = None, qd_rad_s: Numbers | None = None) -> Joints:
        """Torques (6,) [Nm] that joint speeds (6,) [rad/s] cause: Coriolis and centrifugal. From 5.23 on."""
        question = Question.CORIOLIS_AND_CENTRIFUGAL_TORQUES
        return cast(Joints, await self._ask("coriolis_torques", question, q_rad, qd_rad_s, gate="dynamics"))

    async def joint_torques(self) -> Joints:
        """Torques (6,) [Nm] beyond those that move and hold the arm: what the outside causes."""
        return cast(Joints, await self._ask("joint_torques", Question.JOINT_TORQUES))

    async def target_accelerations(self) -> Joints:
        """Of the joints (6,) [rad/s2], as commanded. From 5.23 on; by RTDE `state.values["target_qdd"]`, from 3.3."""
        question = Question.TARGET_JOINT_ACCELERATIONS
        return cast(Joints, await self._ask("target_accelerations", question, gate="dynamics"))


def _matrix(values: Numbers) -> Matrix:
    return tuple(cast(Joints, tuple(values[start : start + _SIX])) for start in range(0, len(values), _SIX))
