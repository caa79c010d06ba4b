"""`AsyncRobot`: the complete interface to an arm, in one class; the neighbouring modules implement it."""

import math
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, cast

from client.calibration import geometry_of
from client.driver import URDriver, points
from client.driver.control_program import DECELERATION, SPEED_ACCELERATION
from client.driver.endpoint import MAX_REAL_TIME_S, StreamStatistics
from client.quantities import checked
from client.robot.contact import Contact, Force
from client.robot.diagnosis import Diagnosis
from client.robot.io import IO
from client.robot.kinematics import Dynamics, Kinematics
from client.robot.motion import MotionRunner
from client.robot.moves import MotionProgress, Moves, frame_rotation
from client.robot.planned import PlannedMotion
from client.robot.programs import Dashboard, Programs
from client.robot.readiness import Readiness
from client.robot.settings import Settings
from client.robot.state import MORE_OUTPUTS, OUTPUTS, RobotState
from client.robot.streaming import Follow, setpoint_stream
from urproto.compat import Self
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import Query, TrajectoryPoint
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_trans

if TYPE_CHECKING:
    from client.planning import Goal, PlanningScene

_FREE_PORTS: Final = {"reverse_port": 0, "trajectory_port": 0, "command_port": 0, "sender_port": 0}
_JOINT_SPEED: Final = 1.04  # rad/s and rad/s2, m/s and m/s2: the defaults of URScript
_JOINT_ACCELERATION: Final = 1.4
_TOOL_SPEED: Final = 0.25
_TOOL_ACCELERATION: Final = 1.2
_JOG_ACCELERATION: Final = 0.5  # m/s2, ur_rtde's default
_SLOW: Final = (0.1, 0.1, 0.1, 0.17, 0.17, 0.17)  # m/s, rad/s along compliant axes, m, rad along others; guess: slow


@checked
class AsyncRobot:
    """A robot for asyncio programs; use it with ``async with``. Options are those of `client.driver.DriverConfig`.

    The driver listens on free ports unless you give its ports, for example because of a firewall.

    **Moves** end by themselves. Joint angles are (6,) [rad], base to wrist 3; poses are base to TCP (6,) [m, rotation
    vector]. With ``wait=False`` a call returns as soon as the motion has begun; see `wait_done`, `moving`, `wait_for`
    and `stop`. The next motion replaces such a motion: the arm slows down and continues from there. While another
    caller waits for a motion, starting a second one raises LocalProtocolError.

    **Contexts** (`servo_j` to `force_mode`) last as long as their block. Only one is possible at a time, and leaving it
    brings the arm to rest.

    Moves and contexts start the control program if it has not been started, and restart it if it ended because this
    machine was late. If it ended for any other reason, only `make_ready` starts it again: it may have been stopped on
    purpose. They raise OutOfReachError before anything moves, for the first target out of reach; ProtectiveStopError,
    and SafetyStopError with the cause that the robot reports; MotionStoppedError and ProgramEndedError; RobotRefused in
    a mode in which the arm cannot move; RobotUnreachableError.

    **Settings** work with and without the control program, and during a motion. They raise LocalProtocolError for
    invalid values, and RobotRefused if no effect is seen.

    Kinematics, dynamics, contact, force, planning, I/O, other programs and the dashboard are components, listed below.
    """

    driver: URDriver
    """The driver below this class, for everything that this class does not offer."""
    kinematics: Kinematics
    """Forward and inverse kinematics, computed by the controller."""
    dynamics: Dynamics
    """Mass matrix and torques, computed by the controller."""
    contact: Contact
    """Tool contact detection."""
    force: Force
    """The force/torque sensor, and parameters of the active force mode."""
    planning: PlannedMotion
    """Motions planned around obstacles."""
    io: IO
    """Analog signals, tool voltage and registers."""
    programs: Programs
    """Programs other than the control program."""
    dashboard: Dashboard
    """The robot's dashboard."""

    def __init__(self, host: str, **options: Any) -> None:
        defaults = {"outputs_if_any": MORE_OUTPUTS, **(_FREE_PORTS if options.get("headless", True) else {})}
        outputs = tuple(dict.fromkeys((*OUTPUTS, *options.pop("outputs", ()))))
        self.driver = URDriver(host, **(defaults | options), outputs=outputs)
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
        """Connect. The arm does not move, and a program that is running on the robot continues."""
        await self.driver.__aenter__()
        self._diagnosis.watch()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the arm and disconnect.

        Raises the failure of a motion that has not been reported to a caller yet, unless the block itself failed.
        """
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
        """The newest state, whatever its age (``state.age_s``)."""
        return RobotState.of(self.driver.state)

    @property
    def _fresh(self) -> RobotState:
        return RobotState.of(self.driver.robot.feed.fresh())

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3. Raises StaleStateError if they are older than ``max_age_s``."""
        return self._fresh.q_rad

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]. Raises StaleStateError if it is older than ``max_age_s``."""
        return self._fresh.pose_base_tcp

    def digital_in(self, number: int) -> bool:
        """Level of a digital input: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return self._fresh.digital_in(number)

    def digital_out(self, number: int) -> bool:
        """Level of a digital output, numbered like the inputs."""
        return self._fresh.digital_out(number)

    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """TCP pose in the base frame (6,) at these joint angles (6,) [rad], from the geometry that this arm reports.

        Raises RobotRefused if the robot has not reported its geometry yet, or if its geometry is unknown.
        """
        link = self.driver.robot
        arm, state = link.configuration, link.primary_state
        geometry = None if arm is None else geometry_of(arm, link.calibration)
        if geometry is None or state is None or state.cartesian is None:
            raise RobotRefused(
                "its geometry", "it has not reported a known one", "let the robot compute it: get_forward_kin()"
            )
        return geometry.forward(q_rad, state.cartesian.tcp_offset)

    # readiness

    async def make_ready(self, *, program: bool = True) -> None:
        """Power the arm on, release its brakes and start the control program, as far as that is still to be done.

        program: False leaves the control program alone. The arm moves slightly as its brakes are released. Raises
        SafetyStopError while a safety stop is in effect, and RobotRefused if the robot refuses.
        """
        await self._readiness.make_ready(program=program)

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        Call it only when you know why the arm stopped and that it may move. Raises RobotRefused if the stop recurs
        immediately, and SafetyStopError for any other kind of stop.
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
        """Move all joints at the same time to joint angles, or to a pose.

        A pose is reached by the inverse kinematics solution nearest to ``near_q_rad``, by default to the present joint
        angles. Speed and acceleration apply to the joint with the longest distance; a duration above 0 replaces both.
        """
        speeds = {"v": speed_rad_s, "a": acceleration_rad_s2, "duration_s": duration_s}
        if (q_rad is None) == (pose_base_tcp is None):
            raise LocalProtocolError("move_j takes either joint angles or a pose: give one of them")
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
        """Move the TCP in a straight line; a duration above 0 replaces speed and acceleration."""
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
        """Move the TCP in a straight line at constant speed, for processes such as gluing."""
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
        """Move the TCP on the circular arc through ``via_base_tcp``.

        The orientation is interpolated towards the target's, or with ``fixed_orientation`` stays fixed relative to the
        arc.
        """
        point = points.movec(
            via_base_tcp, pose_base_tcp, v=speed_m_s, a=acceleration_m_s2, fixed_orientation=fixed_orientation
        )
        await self._moves.execute("move_c", [point], wait)

    async def sequence(self, moves: Iterable[TrajectoryPoint], *, wait: bool = True) -> None:
        """Execute moves of `client.points` as one trajectory, without stopping where they blend.

        With ``points.movel(pose, blend_radius_m=0.02)`` the next move begins 2 cm before the pose. The last move must
        not blend.
        """
        await self._moves.execute("the sequence", moves, wait)

    async def plan_to(self, goal: "Goal", scene: "PlanningScene", /, *, wait: bool = True, **options: Any) -> None:
        """Move to a goal on a collision-free path in the scene; options are those of `PlannedMotion.go_to`."""
        await self.planning.go_to(goal, scene, wait=wait, **options)

    async def speed_j(
        self,
        qd_rad_s: Sequence[float],
        duration_s: float,
        *,
        acceleration_rad_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the joints at speeds (6,) [rad/s] for ``duration_s``, then come to rest.

        A call that replaces a previous one continues from its speeds, without a stop in between.
        """
        send = partial(self.driver.speedj, qd_rad_s)
        await self._moves.send_speeds("speed_j", lambda _: send(), duration_s, acceleration_rad_s2, wait)

    async def speed_l(
        self,
        velocity_base: Sequence[float],
        duration_s: float,
        *,
        acceleration_m_s2: float = SPEED_ACCELERATION,
        wait: bool = True,
    ) -> None:
        """Move the TCP at a velocity in the base frame (6,) [m/s, rad/s] for ``duration_s``, then come to rest."""
        send = partial(self.driver.speedl, velocity_base)
        await self._moves.send_speeds("speed_l", lambda _: send(), duration_s, acceleration_m_s2, wait)

    async def jog(
        self,
        velocity: Sequence[float],
        *,
        frame: str | Sequence[float] = "base",
        acceleration_m_s2: float = _JOG_ACCELERATION,
    ) -> None:
        """Move the TCP at a velocity (6,) [m/s, rad/s] until `stop` or the next motion; returns immediately.

        frame: axes of the velocity: "base", "tool" (the TCP's axes, which turn with it), or those of a pose in the base
        frame (6,). Call it again to change the velocity: there is no stop in between.
        """
        turn = frame_rotation(frame)

        def send(state: RobotState) -> None:
            x, y, z = state.pose_base_tcp[3:] if turn is None else turn
            rotation: Pose = (0.0, 0.0, 0.0, x, y, z)
            linear = pose_trans(rotation, (*velocity[:3], 0.0, 0.0, 0.0))[:3]
            angular = pose_trans(rotation, (*velocity[3:], 0.0, 0.0, 0.0))[:3]
            self.driver.speedl((*linear, *angular), MAX_REAL_TIME_S)

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
        """Move the TCP at a velocity (6,) [m/s, rad/s] until the tool touches something; PolyScope 5.4 or newer.

        The arm then stops, returns to where the contact began, and rests. direction_base: direction in which contact
        counts (6,), in the base frame; only the first three numbers are used, and all zeros stand for the direction of
        motion. Raises MotionError if there is no contact within ``timeout_s``, by the robot's clock.
        """
        await self._moves.until_contact(velocity_base, direction_base, acceleration_m_s2, timeout_s, wait)

    async def progress(self) -> MotionProgress:
        """Progress of the motion under way, as the robot reports it."""
        return await self._moves.progress()

    # the motion under way

    @property
    def moving(self) -> bool:
        """True while a motion started by this object is under way."""
        return self._motion.moving

    async def wait_done(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the motion under way, if any, and raise its error.

        Raises WaitTimeoutError if it takes longer than ``timeout_s``; the motion continues.
        """
        await self._motion.wait_done(timeout_s)

    async def wait_for(self, condition: Callable[[RobotState], bool], timeout_s: float | None = None) -> RobotState:
        """Check every state until the condition is true for one of them, and return that state.

        Raises WaitTimeoutError, the error that ends the motion under way, and RobotUnreachableError if the robot stops
        sending states. The condition must be quick and must not call the robot.
        """
        return await self._motion.wait_for(condition, timeout_s)

    async def stop(self, deceleration_rad_s2: float = DECELERATION) -> None:
        """Bring the arm to rest, and return when it is; a caller waiting for the motion gets MotionStoppedError.

        The control program continues and accepts the next motion. This stops motions that were started by this object;
        to stop another program, use ``driver.robot.send_script("stop program")``.
        """
        await self._motion.stop(deceleration_rad_s2)

    # contexts

    @asynccontextmanager
    async def servo_j(
        self,
        timeout_s: float = MAX_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """Follow a stream of joint angles, one setpoint in every control period.

            with robot.servo_j() as follow:
                while not done:
                    state = follow(next_target(state))     # (6,) [rad]; paces the loop

        timeout_s: without a setpoint for this long (at most 0.2 s) the robot stops the arm, and the next setpoint
        raises LateSetpointError; the control program continues. lookahead_s (0.03 to 0.2, longer is smoother) and gain
        (100 to 2000, higher is stiffer): parameters of servoj; None takes those of the configuration. The robot ignores
        setpoints that are too far away, which raises MotionError. `stream` has statistics.
        """
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_j", self.driver.servoj, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def servo_pose(
        self,
        timeout_s: float = MAX_REAL_TIME_S,
        *,
        lookahead_s: float | None = None,
        gain: float | None = None,
    ) -> AsyncIterator[Follow]:
        """Like `servo_j`, with poses base to TCP (6,) [m, rotation vector]."""
        tuning = {"lookahead_s": lookahead_s, "gain": gain}
        async with self._stream("servo_pose", self.driver.servo_pose, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_j(
        self, timeout_s: float = MAX_REAL_TIME_S, *, acceleration_rad_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """Like `servo_j`, with joint speeds (6,) [rad/s].

        With the default acceleration, speeds are reached almost instantly: the caller provides the ramps.
        """
        tuning = {"acceleration": acceleration_rad_s2}
        async with self._stream("velocity_j", self.driver.speedj, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def velocity_l(
        self, timeout_s: float = MAX_REAL_TIME_S, *, acceleration_m_s2: float = SPEED_ACCELERATION
    ) -> AsyncIterator[Follow]:
        """Like `velocity_j`, with TCP velocities in the base frame (6,) [m/s, rad/s]."""
        tuning = {"acceleration": acceleration_m_s2}
        async with self._stream("velocity_l", self.driver.speedl, timeout_s, tuning) as follow:
            yield follow

    @asynccontextmanager
    async def direct_torque(self, timeout_s: float = MAX_REAL_TIME_S) -> AsyncIterator[Follow]:
        """Like `servo_j`, with joint torques (6,) [Nm] in addition to gravity compensation; PolyScope 5.23 or newer.

        `URDriver.set_friction_scales` (5.25.1) and `set_friction_compensation` set how much friction the robot
        compensates.
        """
        async with self._stream("direct_torque", self.driver.torque, timeout_s) as follow:
            yield follow

    @asynccontextmanager
    async def freedrive(
        self, axes: Sequence[int] = (1,) * 6, frame_base: Sequence[float] = (0.0,) * 6
    ) -> AsyncIterator[None]:
        """Let a person guide the arm by hand; the arm holds the position in which it is left.

        axes: 1 for each free axis (6,). frame_base: the frame of these axes, as a pose in the base frame (6,) [m,
        rotation vector]. Freeing only some axes requires PolyScope 5.10 or newer.
        """
        async with self._motion.exclusive("freedrive"):
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
        """Be compliant along some axes of a frame, while moves continue along the others.

        task_frame_base: the frame, as a pose in the base frame (6,) [m, rotation vector]. selection: 1 for each
        compliant axis (6,). wrench: applied to the environment (6,) [N, Nm]. kind: 1 turns the frame's y axis towards
        the TCP, 2 takes the frame as it is, 3 aligns its x axis with the velocity. limits (6,): maximum speeds of
        compliant axes [m/s, rad/s], maximum deviations of the others [m, rad]. damping: 0 to 1. gain_scaling: 0 to 2,
        e-Series only.
        """
        await self._motion.ready("force_mode")
        self.driver.start_force_mode(
            task_frame_base, selection, wrench, kind, limits, damping=damping, gain_scaling=gain_scaling
        )
        await self._motion.settle("force_mode")
        try:
            yield
        finally:
            if self.driver.program_running:  # force mode ends with the program
                self.driver.end_force_mode()
        if not self.driver.program_running:
            raise await self._readiness.end_error("force_mode")
        if not self.moving:
            await self._motion.come_to_rest()

    @property
    def stream(self) -> StreamStatistics:
        """Statistics of the current or last setpoint stream: sent, skipped and late setpoints, longest gap."""
        return self.driver.reverse.stream

    # settings

    async def set_digital_out(self, number: int, on: bool) -> None:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        await self._settings.set_digital_out(number, on)

    async def set_payload(self, mass_kg: float, cog_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Set the payload's mass and its centre of gravity (3,) [m] in the flange frame, within a few periods."""
        await self.driver.set_payload(mass_kg, cog_m)

    async def set_target_payload(
        self,
        mass_kg: float,
        cog_m: Sequence[float],
        inertia_kg_m2: Sequence[float] = (0.0,) * 6,
        transition_time_s: float = 0.0,
    ) -> None:
        """Like `set_payload`, with inertia and a gradual transition; PolyScope 5.10 or newer.

        inertia_kg_m2: Ixx, Iyy, Izz, Ixy, Ixz, Iyz (6,).
        """
        await self.driver.set_target_payload(mass_kg, cog_m, inertia_kg_m2, transition_time_s)

    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None:
        """Set the acceleration of the base (3,) [m/s2] in the base frame: [0, 0, 9.82] for an upright arm."""
        await self.driver.set_gravity(gravity_m_s2)

    async def set_tcp(self, pose_flange_tcp: Sequence[float]) -> None:
        """Set the TCP as a pose in the flange frame (6,) [m, rotation vector]; not possible during a motion."""
        await self._settings.set_tcp(pose_flange_tcp)

    async def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider, 0.01 to 1, which scales the speed of every motion."""
        await self._settings.set_speed_slider(fraction)

    def set_watchdog(self, longest_s: float) -> None:
        """End the control program, and so stop the arm, if `kick_watchdog` is not called for ``longest_s``; 0 is off.

        Without a watchdog the arm keeps moving as long as this process lives, even if the caller's own loop hangs.
        """
        self.driver.keep_alive.watch(longest_s)

    def kick_watchdog(self) -> None:
        """Report that the caller's own program is alive; takes no time."""
        self.driver.keep_alive.kick()

    async def trigger_protective_stop(self) -> None:
        """Put the robot into a protective stop, as after a collision, from any motion. See `recover`."""
        await self._settings.trigger_protective_stop()

    # queries, possible during any motion

    async def tcp_offset(self) -> Pose:
        """The active TCP as a pose in the flange frame (6,) [m, rotation vector]; PolyScope 3.6 or newer."""
        return cast(Pose, await self.query("tcp_offset", Query.TCP_OFFSET, gate="tcp_offset"))

    async def history(self, steps: int) -> Joints:
        """Joint angles (6,) [rad] as measured ``steps`` control periods ago; PolyScope 5.4 or newer."""
        return cast(Joints, await self.query("history", Query.JOINT_POSITIONS_HISTORY, number=steps, gate="contact"))

    async def is_steady(self) -> bool:
        """Whether the arm has been at rest for a while, and is in neither force mode nor freedrive."""
        return bool((await self.query("is_steady", Query.STEADY))[0])

    async def step_time(self) -> float:
        """The control period [s]."""
        return (await self.query("step_time", Query.STEP_TIME))[0]

    async def target_waypoint(self) -> Pose:
        """Target TCP pose (6,) [m, rotation vector] of the move under way; PolyScope 5.3 or newer."""
        return cast(Pose, await self.query("target_waypoint", Query.TARGET_WAYPOINT, gate="target_waypoint"))

    # for custom control programs

    async def require_program(self, operation: str) -> None:
        """Make sure that the control program runs, starting it as a motion would; raises why it does not."""
        await self._readiness.require_program(operation)

    async def query(
        self,
        operation: str,
        query: Query,
        *arguments: Sequence[float] | None,
        number: int = 0,
        gate: str | None = None,
    ) -> tuple[float, ...]:
        """Query the control program and return its answer; see `URDriver.query`."""
        return await self._readiness.query(operation, query, *arguments, number=number, gate=gate)

    async def check_free(self, operation: str) -> None:
        """Raise LocalProtocolError while a motion or context uses the arm, or the unreported failure of a motion."""
        await self._motion.check_free(operation)

    async def restart_program(self, operation: str) -> None:
        """Start the control program again, after a program of the caller has run."""
        await self._readiness.start(operation)
