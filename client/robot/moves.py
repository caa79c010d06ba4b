"""Moves: one, or several as one trajectory."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Final

from client.calibration import geometry_of
from client.driver import points
from client.driver.timeouts import LONGEST_REAL_TIME_S
from client.errors import MotionError, MotionStoppedError
from client.robot.core import RobotCore
from client.robot.reach import Reach
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import TrajectoryPoint, TrajectoryResult
from urproto.robots.pose import Pose

__all__ = ["Moves"]

_JOINT_SPEED: Final = 1.04  # rad/s and rad/s2, m/s and m/s2: the defaults of URScript
_JOINT_ACCELERATION: Final = 1.4
_TOOL_SPEED: Final = 0.25
_TOOL_ACCELERATION: Final = 1.2


class Moves(RobotCore):
    """Motions that end by themselves.

    Joint angles are (6,) [rad], base to wrist 3; poses are base to TCP (6,) [m, rotation
    vector]. With ``wait=False`` a call returns when the motion has begun; see `wait_done`,
    `moving`, `wait_for` and `stop`. The next motion replaces such a one: the arm slows down and goes on
    from there. While another caller waits for a motion a second one raises LocalProtocolError.

    Raises OutOfReachError before anything moves, for the first target that is; ProtectiveStopError
    and SafetyStopError with what the robot reports; MotionStoppedError when somebody stopped it;
    ProgramEndedError; RobotRefused in a mode in which it cannot move; RobotUnreachableError.
    The control program is started if it has not been, and again if it has ended because this machine was
    late; one that has ended otherwise is not started again without `make_ready`: somebody may have had a reason.
    """

    async def move_j(
        self,
        q_rad: Sequence[float] | None = None,
        *,
        pose_base_tcp: Sequence[float] | None = None,
        near_q_rad: Sequence[float] | None = None,
        speed_rad_s: float = _JOINT_SPEED,
        acceleration_rad_s2: float = _JOINT_ACCELERATION,
        duration_s: float = 0.0,
        wait: bool = True,
    ) -> None:
        """Turn all joints together to joint angles, or to those of a pose.

        Of a pose's joint angles those nearest to ``near_q_rad`` are taken, or to the present
        ones. speed and acceleration: of the joint that has farthest to go; a duration above 0
        replaces both.
        """
        speeds = {"v": speed_rad_s, "a": acceleration_rad_s2, "duration_s": duration_s}
        if (q_rad is None) == (pose_base_tcp is None):
            raise LocalProtocolError("move_j goes to joint angles or to a pose: give one of them")
        if q_rad is not None:
            point = points.movej(q_rad, **speeds)
        else:
            assert pose_base_tcp is not None
            point = points.movej_pose(pose_base_tcp, near_q_rad=near_q_rad, **speeds)
        await self._move("move_j", [point], wait)

    async def move_l(
        self,
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        duration_s: float = 0.0,
        wait: bool = True,
    ) -> None:
        """Move the tool in a straight line; a duration above 0 replaces speed and acceleration."""
        point = points.movel(pose_base_tcp, v=speed_m_s, a=acceleration_m_s2, duration_s=duration_s)
        await self._move("move_l", [point], wait)

    async def move_p(
        self,
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the tool in a straight line at constant speed, as for glueing."""
        await self._move("move_p", [points.movep(pose_base_tcp, v=speed_m_s, a=acceleration_m_s2)], wait)

    async def move_c(
        self,
        via_base_tcp: Sequence[float],
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        fixed_orientation: bool = False,
        wait: bool = True,
    ) -> None:
        """Move the tool on the arc through a via pose; its orientation turns on the way, or is fixed to the arc."""
        point = points.movec(
            via_base_tcp, pose_base_tcp, v=speed_m_s, a=acceleration_m_s2, fixed_orientation=fixed_orientation
        )
        await self._move("move_c", [point], wait)

    async def sequence(self, moves: Iterable[TrajectoryPoint], *, wait: bool = True) -> None:
        """Execute moves of `client.points` as one trajectory, without stops where they blend.

        ``points.movel(pose, blend_radius_m=0.02)``: from 2 cm before the pose on, the next
        move begins. The last one does not blend.
        """
        await self._move("the sequence", list(moves), wait)

    async def speed_j(self, qd_rad_s: Sequence[float], duration_s: float, *, wait: bool = True) -> None:
        """Turn the joints at speeds (6,) for some seconds, then come to rest."""

        def send() -> None:
            self.driver.speedj(qd_rad_s, LONGEST_REAL_TIME_S)

        await self._keep_sending("speed_j", send, duration_s, wait)

    async def speed_l(self, velocity_base: Sequence[float], duration_s: float, *, wait: bool = True) -> None:
        """Move the TCP at a velocity in the base frame (6,) [m/s, rad/s] for some seconds, then come to rest."""

        def send() -> None:
            self.driver.speedl(velocity_base, LONGEST_REAL_TIME_S)

        await self._keep_sending("speed_l", send, duration_s, wait)

    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """Where the TCP would be (6,) with these joint angles (6,), by the geometry that this very arm reports.

        Raises RobotRefused while the robot has not told its geometry, or for one that is not known here.
        """
        link = self.driver.robot
        arm, state = link.configuration, link.primary_state
        geometry = None if arm is None else geometry_of(arm, link.calibration)
        if geometry is None or state is None or state.cartesian is None:
            raise RobotRefused("its geometry", "it has not told one that is known here", "ask it: get_forward_kin()")
        return geometry.forward(q_rad, state.cartesian.tcp_offset)

    # what they have in common

    async def _move(self, doing: str, moves: list[TrajectoryPoint], wait: bool) -> None:
        for move in moves:
            move.encode()  # its numbers can be sent
        await self._ready(doing)
        self._check_reach(doing, moves)
        await self._launch(doing, partial(self._execute, doing, moves), wait)

    def _check_reach(self, doing: str, moves: list[TrajectoryPoint]) -> None:
        link = self.driver.robot
        arm, state = link.configuration, link.primary_state
        if arm is not None and state is not None and state.cartesian is not None:
            Reach(arm, state.cartesian.tcp_offset, self.q, link.calibration).check(doing, moves)

    async def _execute(self, doing: str, moves: list[TrajectoryPoint]) -> None:
        popups = self.driver.robot.popups
        popups.clear()
        result = await self.driver.execute(moves)
        if result is TrajectoryResult.FAILURE:
            raise MotionError(doing, "its points did not reach the robot in time: look at the network")
        if result is TrajectoryResult.CANCELED and not popups:
            await self._hear(lambda: bool(popups or self.driver.lost_why))
        if result is TrajectoryResult.CANCELED and self.driver.lost_why:
            raise await self._explanation(doing)
        if result is TrajectoryResult.CANCELED and popups:
            raise MotionError(doing, popups[-1].text)
        if result is TrajectoryResult.CANCELED:
            raise MotionStoppedError(doing, "it was cancelled")

    async def _keep_sending(self, doing: str, send: Callable[[], None], duration_s: float, wait: bool) -> None:
        if not duration_s > 0.0:
            raise LocalProtocolError(f"the duration of {doing} is above 0 s, not {duration_s}")
        await self._ready(doing, rolling=True)
        send()  # raises here what cannot be sent
        await self._launch(doing, partial(self._sending, doing, send, duration_s), wait)

    async def _sending(self, doing: str, send: Callable[[], None], duration_s: float) -> None:
        until = self.state.timestamp_s + duration_s
        try:
            while self.state.timestamp_s < until:
                send()
                await self._next_state(doing)
        finally:
            if self.driver.program_running and not self._rolling:
                self.driver.idle()
        await self._come_to_rest()
