"""`AsyncRobot`: everything a program says to an arm, in one place; the parts beside it do it."""

import math
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, cast

from client.calibration import geometry_of
from client.driver import URDriver, points
from client.driver.control_program import DECELERATION, SPEED_ACCELERATION
from client.driver.endpoint import LONGEST_REAL_TIME_S, StreamStatistics
from client.robot.contact import Contact, Force
from client.robot.diagnosis import Diagnosis
from client.robot.io import IO
from client.robot.kinematics import Dynamics, Kinematics
from client.robot.motion import MotionRunner
from client.robot.moves import MotionProgress, Moves, six, turn_of
from client.robot.planned import PlannedMotion
from client.robot.programs import Dashboard, Programs
from client.robot.readiness import Readiness
from client.robot.settings import Settings
from client.robot.state import MORE_OUTPUTS, OUTPUTS, RobotState
from client.robot.streaming import Follow, setpoint_stream
from urproto.compat import Self
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import Question, TrajectoryPoint
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_trans

if TYPE_CHECKING:
    from client.planning import Goal, PlanningScene

_FREE_PORTS: Final = {"reverse_port": 0, "trajectory_port": 0, "command_port": 0, "sender_port": 0}
_JOINT_SPEED: Final = 1.04  # rad/s and rad/s2, m/s and m/s2: the defaults of URScript
_JOINT_ACCELERATION: Final = 1.4
_TOOL_SPEED: Final = 0.25
_TOOL_ACCELERATION: Final = 1.2
_JOG_ACCELERATION: Final = 0.5  # ur_rtde's
_SLOW: Final = (0.1, 0.1, 0.1, 0.17, 0.17, 0.17)  # m/s, rad/s where it complies, m, rad elsewhere; guess: slow


class AsyncRobot:
    """A robot for asyncio programs; use it with ``async with``. Options are those of `client.driver.DriverConfig`.

    The driver's ports are any free ones unless they are given, as a firewall may demand.

    Moves end by themselves. Joint angles are (6,) [rad], base to wrist 3; poses are base to TCP (6,) [m, rotation
    vector]. With ``wait=False`` a call returns when the motion has begun; see `wait_done`, `moving`, `wait_for` and
    `stop`. The next motion replaces such a one: the arm slows down and goes on from there. While another caller waits
    for a motion a second one raises LocalProtocolError. Contexts (`servo_j` to `force_mode`) last as long as their
    block: the arm obeys one at a time, and leaving it brings the arm to rest.

    Both raise OutOfReachError before anything moves, for the first target that is; ProtectiveStopError
    and SafetyStopError with what the robot reports; MotionStoppedError when somebody stopped it;
    ProgramEndedError; RobotRefused in a mode in which it cannot move; RobotUnreachableError.
    The control program is started if it has not been, and again if it has ended because this machine was
    late; one that has ended otherwise is not started again without `make_ready`: somebody may have had a reason.

    Settings work with and without the control program, and beside a motion. They raise LocalProtocolError for values
    that make no sense, RobotRefused when no effect is seen.

    In the order of this file:

    - state: `state`, `q`, `tcp_pose`, `digital_in`, `digital_out`, `tcp_pose_at`
    - readiness: `make_ready`, `recover`
    - motions: `move_j`, `move_l`, `move_p`, `move_c`, `sequence`, `plan_to`, `speed_j`, `speed_l`, `jog`,
      `move_until_contact`
    - the motion under way: `progress`, `moving`, `wait_done`, `wait_for`, `stop`
    - contexts: `servo_j` to `force_mode`; `stream`
    - settings: `set_digital_out`, `set_payload`, `set_tcp`, `set_speed_slider`, `set_watchdog` and others
    - questions: `tcp_offset`, `history`, `is_steady`, `step_time`, `target_waypoint`
    - for programs of the caller's own: `need_program`, `ask`, `free`, `start_again`

    Kinematics, dynamics, contact, force, planning, I/O, other programs and the dashboard are parts of their own, below.
    """

    driver: URDriver
    """For what this class does not offer."""
    kinematics: Kinematics
    """Where the arm would be and how it gets there, as the controller answers."""
    dynamics: Dynamics
    """What it takes to move the arm, as the controller answers."""
    contact: Contact
    """Whether the tool touches something."""
    force: Force
    """The force sensor, and force mode while it is in effect."""
    planning: PlannedMotion
    """Ways around what is in the way."""
    io: IO
    """Analog signals, tool voltage and registers."""
    programs: Programs
    """Other programs than the control program."""
    dashboard: Dashboard
    """The robot's dashboard."""

    def __init__(self, host: str, **options: Any) -> None:
        free = _FREE_PORTS if options.get("headless", True) else {}
        outputs = tuple(dict.fromkeys((*OUTPUTS, *options.pop("outputs", ()))))
        more = {"outputs_if_any": MORE_OUTPUTS}
        self.driver = URDriver(host, **(free | more | options), outputs=outputs)
        self._diagnosis = Diagnosis(self.driver)
        self._readiness = Readiness(self.driver, self._diagnosis)
        self._motion = MotionRunner(self._readiness)
        self._moves = Moves(self._motion)
        self._settings = Settings(self._motion)
        self._stream = partial(setpoint_stream, self._motion)
        self.kinematics = Kinematics(self._readiness)
        self.dynamics = Dynamics(self._readiness)
        self.contact = Contact(self._readiness)
        self.force = Force(self._readiness)
        self.planning = PlannedMotion(self.driver, self._moves)
        self.io = IO(self.driver)
        self.programs = Programs(self._motion)
        self.dashboard = Dashboard(self.driver)

    async def __aenter__(self) -> Self:
        """Connect. The arm does not move, and a program that runs on the robot goes on."""
        await self.driver.__aenter__()
        self._diagnosis.watch()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the arm and disconnect. A failure nobody has asked for is raised, unless another is on its way."""
        failure: BaseException | None = None
        try:
            failure = await self._motion.close()
        finally:
            await self.driver.__aexit__(kind, error, trace)
        if failure is not None and error is None:
            raise failure

    # state

    @property
    def state(self) -> RobotState:
        """The newest state."""
        return RobotState.of(self.driver.state)

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3."""
        return self.state.q_rad

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]."""
        return self.state.pose_base_tcp

    def digital_in(self, number: int) -> bool:
        """Level of a digital input: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return self.state.digital_in(number)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered as the inputs are."""
        return self.state.digital_out(number)

    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """Where the TCP would be (6,) with these joint angles (6,), by the geometry that this very arm reports.

        Raises RobotRefused while the robot has not reported its geometry, or for one that is not known here.
        """
        link = self.driver.robot
        arm, state = link.configuration, link.primary_state
        geometry = None if arm is None else geometry_of(arm, link.calibration)
        if geometry is None or state is None or state.cartesian is None:
            raise RobotRefused(
                "its geometry", "it has not reported one that is known here", "ask it: get_forward_kin()"
            )
        return geometry.forward(q_rad, state.cartesian.tcp_offset)

    # readiness

    async def make_ready(self, *, program: bool = True) -> None:
        """Power the arm on, release the brakes and start the control program, whatever of it is still to be done.

        program: False leaves the control program alone. The arm moves a little as its brakes are
        released. Raises SafetyStopError while a stop is in effect, RobotRefused when the robot says no.
        """
        await self._readiness.make_ready(program=program)

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        For a caller who knows why the arm stopped and that it may move. Raises RobotRefused
        when the stop comes back at once, SafetyStopError for another kind of stop.
        """
        await self._readiness.recover()

    # motions

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
        await self._moves.execute("move_j", [point], wait)

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
        await self._moves.execute("move_l", [point], wait)

    async def move_p(
        self,
        pose_base_tcp: Sequence[float],
        *,
        speed_m_s: float = _TOOL_SPEED,
        acceleration_m_s2: float = _TOOL_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the tool in a straight line at constant speed, as for glueing."""
        await self._moves.execute("move_p", [points.movep(pose_base_tcp, v=speed_m_s, a=acceleration_m_s2)], wait)

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
        await self._moves.execute("move_c", [point], wait)

    async def sequence(self, moves: Iterable[TrajectoryPoint], *, wait: bool = True) -> None:
        """Execute moves of `client.points` as one trajectory, without stops where they blend.

        ``points.movel(pose, blend_radius_m=0.02)``: from 2 cm before the pose on, the next
        move begins. The last one does not blend.
        """
        await self._moves.execute("the sequence", list(moves), wait)

    async def plan_to(self, goal: "Goal", scene: "PlanningScene", /, *, wait: bool = True, **options: Any) -> None:
        """Go to a goal around what is in the scene; options are those of `PlannedMotion.go_to`."""
        await self.planning.go_to(goal, scene, wait=wait, **options)

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

        await self._moves.send_speeds("speed_j", send, duration_s, acceleration_rad_s2, wait)

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

        await self._moves.send_speeds("speed_l", send, duration_s, acceleration_m_s2, wait)

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
        turn = turn_of(frame)
        values = six("a velocity", velocity)

        def send(state: RobotState) -> None:
            x, y, z = state.pose_base_tcp[3:] if turn is None else turn
            rotation: Pose = (0.0, 0.0, 0.0, x, y, z)
            linear = pose_trans(rotation, (*values[:3], 0.0, 0.0, 0.0))[:3]
            angular = pose_trans(rotation, (*values[3:], 0.0, 0.0, 0.0))[:3]
            self.driver.speedl((*linear, *angular), LONGEST_REAL_TIME_S)

        await self._moves.send_speeds("jog", send, math.inf, acceleration_m_s2, False)

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
        await self._moves.until_contact(velocity_base, direction_base, acceleration_m_s2, timeout_s, wait)

    async def progress(self) -> MotionProgress:
        """How far the motion that is under way has come, by the robot."""
        return await self._moves.progress()

    # motions that are under way

    @property
    def moving(self) -> bool:
        """True while a motion that was begun here is under way."""
        return self._motion.moving

    async def wait_done(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the motion that is under way, if any, and raise what went wrong.

        Raises WaitTimeoutError when it takes longer than ``timeout_s``; the motion goes on.
        """
        await self._motion.wait_done(timeout_s)

    async def wait_for(self, condition: Callable[[RobotState], bool], timeout_s: float | None = None) -> RobotState:
        """Look at each state until the condition holds for one, and return that.

        Raises WaitTimeoutError, what ends the motion that is under way, and RobotUnreachableError
        for a silent robot. The condition must be quick and must not call the robot.
        """
        return await self._motion.wait_for(condition, timeout_s)

    async def stop(self, deceleration_rad_s2: float = DECELERATION) -> None:
        """Bring the arm to rest, and return when it has; who waits for the motion gets MotionStoppedError.

        The program goes on, the next motion may follow. For motions that were begun here: a
        program of somebody else is stopped by ``driver.robot.send_script("stop program")``.
        """
        await self._motion.stop(deceleration_rad_s2)

    # contexts

    @asynccontextmanager
    async def servo_j(
        self,
        timeout_s: float = LONGEST_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """Follow joint angles, one set in every control period.

            with robot.servo_j() as follow:
                while not done:
                    state = follow(next_target(state))     # (6,) [rad]; paces the loop

        timeout_s: without a target for so long (at most 0.2 s) the robot stops the arm, and the next
        target is a LateSetpointError; the program goes on. lookahead_s (0.03 to 0.2, longer is smoother)
        and gain (100 to 2000, higher is stiffer): of servoj, None for those of the configuration. Targets
        too far away are ignored by the robot: MotionError says so. `stream` tells how it went.
        """
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_j", lambda q_rad: self.driver.servoj(q_rad, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def servo_pose(
        self,
        timeout_s: float = LONGEST_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """As servo_j with poses base to TCP (6,) [m, rotation vector]."""
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_pose", lambda pose: self.driver.servo_pose(pose, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_j(
        self, timeout_s: float = LONGEST_REAL_TIME_S, *, acceleration_rad_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """As servo_j with joint speeds (6,) [rad/s]; by default they are reached at once, so ramps are the caller's."""
        tuning = {"acceleration": acceleration_rad_s2}
        async with self._stream("velocity_j", lambda qd: self.driver.speedj(qd, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_l(
        self, timeout_s: float = LONGEST_REAL_TIME_S, *, acceleration_m_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """As velocity_j with velocities of the TCP in the base frame (6,) [m/s, rad/s]."""
        tuning = {"acceleration": acceleration_m_s2}
        async with self._stream("velocity_l", lambda xd: self.driver.speedl(xd, timeout_s), tuning) as follow:
            yield follow

    @asynccontextmanager
    async def direct_torque(self, timeout_s: float = LONGEST_REAL_TIME_S) -> AsyncIterator[Follow]:
        """As servo_j with joint torques (6,) [Nm] on top of what gravity needs; from 5.23 on.

        How much friction the robot makes up for: `URDriver.set_friction_scales` (5.25.1), `set_friction_compensation`.
        """
        async with self._stream("direct_torque", lambda torque_Nm: self.driver.torque(torque_Nm, timeout_s)) as follow:
            yield follow

    @asynccontextmanager
    async def freedrive(
        self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = (0.0,) * 6
    ) -> AsyncIterator[None]:
        """Let the arm be moved by hand, and hold it where it is left.

        axes: 1 for those (6,) that are free, of a frame given in the base frame (6,) [m, rotation vector]; fewer
        than all from 5.10 on.
        """
        async with self._motion.holding("freedrive"):
            self.driver.set_freedrive_axes(axes, frame_base)
            await self._motion.settle("freedrive")
            self.driver.start_freedrive()
            yield

    @asynccontextmanager
    async def force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        *,
        kind: int = 2,
        limits: Sequence[float] = _SLOW,
        damping: float = 0.025,
        gain_scaling: float = 0.5,
    ) -> AsyncIterator[None]:
        """Comply along some axes of a frame, while moves go on along the others.

        task_frame_base: pose in the base frame (6,) [m, rotation vector]. selection: 1 for
        axes that comply (6,). wrench: to press with (6,) [N, Nm]. kind: 1 the frame's y axis
        points to the TCP, 2 the frame as it is, 3 its x axis follows the velocity. limits: top
        speeds of complying axes [m/s, rad/s], deviations of the others [m, rad] (6,).
        damping: 0 to 1. gain_scaling: 0 to 2, e-Series only.
        """
        await self._motion.ready("force_mode")
        self.driver.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        await self._motion.settle("force_mode")
        try:
            yield
        finally:
            if self.driver.program_running:  # it ends with the program
                self.driver.end_force_mode()
        if not self.driver.program_running:
            raise await self._readiness.explanation("force_mode")
        if not self.moving:
            await self._motion.come_to_rest()

    @property
    def stream(self) -> StreamStatistics:
        """How the setpoints of the present or the last such block went out: sent, skipped, late, longest gap."""
        return self.driver.reverse.stream

    # settings

    async def set_digital_out(self, number: int, on: bool) -> None:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        await self._settings.set_digital_out(number, on)

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Mass and its centre of gravity (3,) in the flange frame; takes effect within a few control periods."""
        await self.driver.set_payload(mass_kg, cog_m)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = (0.0,) * 6,
        transition_time_s: float = 0.0,
    ) -> None:
        """As set_payload with the inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,), taking effect gradually; from 5.10 on."""
        await self.driver.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Acceleration of the base (3,) in its frame: [0, 0, 9.82] for an upright arm."""
        await self.driver.set_gravity(gravity_m_s2)

    async def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Flange to TCP (6,) [m, rotation vector]; not while a motion is under way."""
        await self._settings.set_tcp(pose_flange_tcp)

    async def set_speed_slider(self, fraction: float) -> None:
        """Scale the speed of everything by 0.01 to 1."""
        await self._settings.set_speed_slider(fraction)

    def set_watchdog(self, longest_s: float) -> None:
        """End the control program, and so stop the arm, when `kick_watchdog` is not called for so long; 0 ends that.

        Without one the arm goes on as long as this process lives, also if the caller's own loop hangs.
        """
        self.driver.pulse.watch(longest_s)

    def kick_watchdog(self) -> None:
        """Say that the caller's own program works; takes no time."""
        self.driver.pulse.kick()

    async def trigger_protective_stop(self) -> None:
        """Stop the arm as the robot would after a collision, from any motion. See `recover`."""
        await self._settings.trigger_protective_stop()

    # questions, beside any motion

    async def tcp_offset(self) -> Pose:
        """Flange to TCP (6,) [m, rotation vector], as it is in effect. From 3.6 on."""
        return cast(Pose, await self.ask("tcp_offset", Question.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured some control periods ago. From 5.4 on."""
        if steps < 0:
            raise LocalProtocolError(f"history goes back 0 periods or more, not {steps}")
        question = Question.JOINT_POSITIONS_HISTORY
        return cast(Joints, await self.ask("history", question, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has stood for a while, and is in neither force mode nor freedrive."""
        return bool((await self.ask("is_steady", Question.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self.ask("step_time", Question.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Pose of the TCP (6,) that the move under way leads to. From 5.3 on."""
        return cast(Pose, await self.ask("target_waypoint", Question.TARGET_WAYPOINT, gate="target_waypoint"))

    # for programs of the caller's own

    async def need_program(self, doing: str) -> None:
        """See that the control program runs and obeys, or raise the error that says why it does not.

        Started as by a motion: the first time, or after an end that was this machine's own fault.
        """
        await self._readiness.need_program(doing)

    async def ask(
        self,
        doing: str,
        question: Question,
        *arguments: Sequence[float] | None,
        number: int = 0,
        gate: str | None = None,
    ) -> tuple[float, ...]:
        """What the control program answers; the robot's components ask so. See `URDriver.ask`."""
        return await self._readiness.ask(doing, question, *arguments, number=number, gate=gate)

    async def free(self, doing: str) -> None:
        """See that nobody has the arm. Raises LocalProtocolError, and the failure of a motion that nobody was told."""
        await self._motion.check_free(doing)

    async def start_again(self, doing: str) -> None:
        """Start the control program after one of the caller's own."""
        await self._readiness.start(doing)
