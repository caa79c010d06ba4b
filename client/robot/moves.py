"""Moves: one, or several as one trajectory."""

import asyncio
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from client.calibration import geometry_of
from client.control_program import SPEED_ACCELERATION
from client.driver import points
from client.driver.endpoint import LONGEST_REAL_TIME_S
from client.errors import MotionError, MotionStoppedError, OutOfReachError
from client.robot.core import RobotCore
from client.robot.state import RobotState
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import MotionType, Question, TrajectoryPoint, TrajectoryResult, to_words
from urproto.primary.state import ConfigurationData, KinematicsInfo
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
_NAMES: Final = ("base", "shoulder", "elbow", "wrist 1", "wrist 2")  # wrist 3 has no end stop on some arms
_SLACK: Final = 0.01  # of the distance; guess: calibrations differ by some millimetres in a metre
_ROUNDING_RAD: Final = 1e-6  # a word of the wire is so much


class Reach:
    """Of an arm with this TCP, flange to TCP (6,) [m, rotation vector], that stands at ``q_rad``."""

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

    def check(self, doing: str, points: Sequence[TrajectoryPoint]) -> None:
        """Raise OutOfReachError for the first point the arm cannot get to."""
        for number, point in enumerate(points):
            problem = self._problem(point)
            if problem is not None:
                which = f"point {number} " if len(points) > 1 else "the target "
                raise OutOfReachError(doing, which + problem, number)

    def _problem(self, point: TrajectoryPoint) -> str | None:
        if point.type in _JOINTS:
            return self._beyond_limits(point.target)
        if not self._reachable(point.target):
            return f"p[{_listed(point.target)}] has no joint angles within the arm's limits: choose one nearer to it"
        return None

    def _beyond_limits(self, q_rad: Sequence[float]) -> str | None:
        for name, low, angle, high in zip(_NAMES, self._arm.q_min, q_rad, self._arm.q_max, strict=False):
            if not low - _ROUNDING_RAD <= angle <= high + _ROUNDING_RAD:
                return f"asks {name} for {angle:.4f} rad, and its limits are {low:.4f} and {high:.4f} rad"
        return None

    def _reachable(self, pose_base_tcp: Sequence[float]) -> bool:
        if self._kinematics is None:
            return True
        flange = pose_trans(pose_base_tcp, self._tcp_inverse)
        scales = (1.0, 1.0 - _SLACK, 1.0 + _SLACK)
        return any(self._solves(self._kinematics, self._moved(flange, scale)) for scale in scales)

    def _moved(self, pose: Pose, scale: float) -> Pose:
        """Nearer to the shoulder, or farther from it."""
        height = self._arm.dh_d[0]
        x, y, z, *turn = pose
        rx, ry, rz = turn
        return (x * scale, y * scale, height + (z - height) * scale, rx, ry, rz)

    def _solves(self, kinematics: Kinematics, flange: Pose) -> bool:
        return kinematics.inverse_near(flange, self._q_rad, *self._limits) is not None


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4f}" for value in values)


_JOINT_SPEED: Final = 1.04  # rad/s and rad/s2, m/s and m/s2: the defaults of URScript
_JOINT_ACCELERATION: Final = 1.4
_TOOL_SPEED: Final = 0.25
_TOOL_ACCELERATION: Final = 1.2
_JOG_ACCELERATION: Final = 0.5  # ur_rtde's
_READ_STATES: Final = 20  # guess: what was sent while the arm went back from a contact is read within this


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Of the motion that was begun here: its name, whether it is under way, at which point of how many, from 0.

    Both are 0 for motions without points. With a blend, a point counts from where the move to it begins.
    """

    doing: str
    running: bool
    point: int
    points: int


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

    async def speed_j(
        self,
        qd_rad_s: Sequence[float],
        duration_s: float,
        *,
        acceleration_rad_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Turn the joints at speeds (6,) for some seconds, then come to rest.

        One that replaces another goes on from its speeds, without a stop in between.
        """

        def send(_: RobotState) -> None:
            self.driver.speedj(qd_rad_s, LONGEST_REAL_TIME_S)

        await self._keep_sending("speed_j", send, duration_s, acceleration_rad_s2, wait)

    async def speed_l(
        self,
        velocity_base: Sequence[float],
        duration_s: float,
        *,
        acceleration_m_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the TCP at a velocity in the base frame (6,) [m/s, rad/s] for some seconds, then come to rest."""

        def send(_: RobotState) -> None:
            self.driver.speedl(velocity_base, LONGEST_REAL_TIME_S)

        await self._keep_sending("speed_l", send, duration_s, acceleration_m_s2, wait)

    async def jog(
        self,
        velocity: Sequence[float],
        *,
        frame: str | Sequence[float] = "base",
        acceleration_m_s2: float = _JOG_ACCELERATION,
    ) -> None:
        """Move the TCP at a velocity (6,) [m/s, rad/s] until `stop` or the next motion; returns at once.

        frame: "base", "tool" for the axes of the TCP as they turn, or a pose in the base frame (6,) whose axes
        count. Call it again for another velocity: there is no stop in between.
        """
        turn = _turn_of(frame)
        values = _six("a velocity", velocity)

        def send(state: RobotState) -> None:
            x, y, z = state.pose_base_tcp[3:] if turn is None else turn
            rotation: Pose = (0.0, 0.0, 0.0, x, y, z)
            linear = pose_trans(rotation, (*values[:3], 0.0, 0.0, 0.0))[:3]
            angular = pose_trans(rotation, (*values[3:], 0.0, 0.0, 0.0))[:3]
            self.driver.speedl((*linear, *angular), LONGEST_REAL_TIME_S)

        await self._keep_sending("jog", send, math.inf, acceleration_m_s2, False)

    async def move_until_contact(
        self,
        velocity_base: Sequence[float],
        *,
        direction_base: Sequence[float] = (0.0,) * 6,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        timeout_s: float = math.inf,
        wait: bool = True,
    ) -> None:
        """Move the TCP at a velocity (6,) [m/s, rad/s] until the tool touches something; from 5.4 on.

        Then the arm stops, goes back to where the contact began, and rests. direction_base: along which contact
        counts (6,), the first three in the base frame; all zero for the direction of motion. Raises MotionError
        when there is no contact within ``timeout_s`` seconds of the robot's.
        """
        self.driver._require("contact")
        work = partial(self._until_contact, _six("a velocity", velocity_base), direction_base, timeout_s)
        await self._ready("move_until_contact")
        await self._tune("move_until_contact", acceleration=acceleration_m_s2)
        self._points = ()
        await self._launch("move_until_contact", work, wait)

    async def progress(self) -> MotionProgress:
        """How far the motion that is under way has come, by the robot."""
        point, executing = await self.ask("progress", Question.PROGRESS)
        points = len(self._points) if self.moving else 0
        running = self.moving and (bool(executing) or not points)
        return MotionProgress(
            self._doing if running else "", running, max(0, round(point) - 1) if points else 0, points
        )

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

    _points: Sequence[TrajectoryPoint] = ()  # of the last motion that had some

    async def _move(self, doing: str, moves: list[TrajectoryPoint], wait: bool) -> None:
        for move in moves:
            move.encode()  # its numbers can be sent
        await self._ready(doing)
        self._check_reach(doing, moves)
        self._points = moves
        await self._launch(doing, partial(self._execute, doing, moves), wait)

    def _check_reach(self, doing: str, moves: list[TrajectoryPoint]) -> None:
        link = self.driver.robot
        arm, state = link.configuration, link.primary_state
        if arm is not None and state is not None and state.cartesian is not None:
            Reach(arm, state.cartesian.tcp_offset, self.q, link.calibration).check(doing, moves)

    async def _execute(self, doing: str, moves: list[TrajectoryPoint]) -> None:
        popups = self.driver.robot.popups
        popups.clear()
        losses = self.driver.losses
        result = await self.driver.execute(moves)
        if result is TrajectoryResult.FAILURE:
            raise MotionError(doing, "its points did not reach the robot in time: look at the network")
        if result is TrajectoryResult.CANCELED and not popups:
            await self._hear(lambda: bool(popups or self.driver.losses > losses or self.driver.pulse.bitten))
        if result is TrajectoryResult.CANCELED and (self.driver.losses > losses or self.driver.pulse.bitten):
            raise await self._explanation(doing)
        if result is TrajectoryResult.CANCELED and popups:
            raise MotionError(doing, popups[-1].text)
        if result is TrajectoryResult.CANCELED:
            raise MotionStoppedError(doing, "it was cancelled")

    async def _keep_sending(
        self, doing: str, send: Callable[[RobotState], None], duration_s: float, acceleration: float, wait: bool
    ) -> None:
        if not duration_s > 0.0:
            raise LocalProtocolError(f"the duration of {doing} is above 0 s, not {duration_s}")
        await self._ready(doing, rolling=True)
        await self._tune(doing, acceleration=acceleration)
        self._check_nobody_moves(doing)
        send(self.state)  # raises here what cannot be sent
        self._points = ()
        await self._launch(doing, partial(self._sending, doing, send, duration_s), wait)

    async def _sending(self, doing: str, send: Callable[[RobotState], None], duration_s: float) -> None:
        until = self.state.timestamp_s + duration_s
        try:
            while (state := self.state).timestamp_s < until:
                send(state)
                await self._next_state(doing)
        finally:
            if self.driver.program_running and not self._rolling:
                self.driver.idle()
        await self._come_to_rest()

    async def _until_contact(
        self, velocity: Sequence[float], direction_base: Sequence[float], timeout_s: float
    ) -> None:
        doing = "move_until_contact"
        self.driver.start_tool_contact(direction_base)
        result = asyncio.create_task(self.driver.tool_contact_result())
        until = self.state.timestamp_s + timeout_s
        try:
            while not result.done():
                if self.state.timestamp_s >= until:
                    raise MotionError(doing, f"the tool has met nothing within {timeout_s:g} s")
                self.driver.speedl(velocity, LONGEST_REAL_TIME_S)
                await self._next_state(doing)
            result.result()
        finally:
            result.cancel()
            await asyncio.gather(result, return_exceptions=True)
            if self.driver.program_running:
                self.driver.idle()
                for _ in range(_READ_STATES):  # as long as it watches it follows no velocity that is on its way
                    await self._next_state(doing)
                self.driver.end_tool_contact()
        await self._come_to_rest()


def _six(what: str, values: Sequence[float]) -> tuple[float, ...]:
    to_words(values)
    if len(values) != 6:
        raise LocalProtocolError(f"{what} has 6 numbers, not {len(values)}")
    return tuple(values)


def _turn_of(frame: str | Sequence[float]) -> Sequence[float] | None:
    """The rotation vector of a frame, None for the tool's."""
    if frame == "base":
        return (0.0, 0.0, 0.0)
    if frame == "tool":
        return None
    if isinstance(frame, str):
        raise LocalProtocolError(f'a frame is "base", "tool" or a pose, not {frame!r}')
    return _six("the pose of a frame", frame)[3:]
