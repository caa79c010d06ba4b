"""The movements a program can ask for, one method each.

Every method returns a `Move`; the program waits until it is ready. A command that cannot be begun (target out of reach,
outside the joint limits, not a number) gives a failed Move, and the next `advance` reports the fault and stops the arm.
"""

from collections.abc import Callable, Sequence
from math import isfinite

from emulator.motion.blends import Coast, Leaving, blend_into, overlap
from emulator.motion.compliance import Compliance, Task
from emulator.motion.faults import MotionFault, bad_setpoint
from emulator.motion.legs import TOOL_LIMITS, ArcLeg, JointLeg, Leg, LineLeg, ToolLeg, circle_through
from emulator.motion.path_motion import PathMotion
from emulator.motion.profile import Limits
from emulator.motion.servo import JointServo, ToolServo
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stepping import DisplacingStepper, Move
from emulator.motion.stops import ToolStop
from emulator.motion.superposition import OffsetSettings
from emulator.motion.torque import DirectTorque, TorqueResponse
from emulator.motion.vectors import ZERO, Joints, all_finite, as_six, largest, norm3, scaled
from emulator.robot.drives import TorqueCommand
from urproto.modes import ControlMode
from urproto.robots.pose import Pose

_HANDOVER_RAD_S2 = 10.0  # leading joint, when a movement of another kind takes over from an arm in motion (guess)
_TURN_ACCELERATION_MAX = TOOL_LIMITS.acceleration / 0.25  # rad/s2, at the equivalent radius (guess)
# A tool path at least this long is a direction, followed as far as the arm reaches: PolyScope's Direction nodes end
# 1000 m away and are stopped before. From which length on this is so is a guess.
_DIRECTION_M = 100.0


class Motion(DisplacingStepper):
    """Motion generator of one arm. Joint vectors (6,) base to wrist 3 [rad]; poses base to TCP [m, rotation vector]."""

    @property
    def limiter_share(self) -> float:
        """What the joints' limits leave of a path's speed: less than 1 where it is too much for them.

        1 in streamed movements, whose sender sets the pace: drivers slow down by it (guess).
        """
        return self._pacer.share if isinstance(self._generator, PathMotion) else 1.0

    # moves along a path

    def movej(self, q: Sequence[float], *, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Move:
        """Joint line to q; ``a`` and ``v`` of the leading joint [rad/s2, rad/s]; t > 0 [s] overrides both; r [m]."""
        fault = _not_usable("movej", (*q, t, r), a, v, t) or self._limits.outside(as_six(q))
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(q)
        return self._follow(lambda start: JointLeg(self._reach, start, goal, Limits(v, a), t), r)

    def movel(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Move:
        """Straight tool path; a and v of the TCP [m/s2, m/s]; t > 0 [s] overrides both; blend radius r [m]."""
        return self._line("movel", pose, a, v, t, r, process=False)

    def movep(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Move:
        """As movel, with corners between two movep rounded by arcs at constant tool speed."""
        return self._line("movep", pose, a, v, 0.0, r, process=True)

    def movec(
        self,
        via: Sequence[float],
        to: Sequence[float],
        *,
        a: float = 1.2,
        v: float = 0.25,
        r: float = 0.0,
        mode: int = 0,
    ) -> Move:
        """Circular tool path over ``via``; mode 1 keeps the orientation relative to the arc."""
        fault = _not_usable("movec", (*via, *to, r), a, v)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(to)

        def leg(start: Joints) -> Leg:
            here = self._reach.pose(start)
            circle = circle_through(here[:3], as_six(via)[:3], goal[:3])
            if circle is None:
                return LineLeg(self._reach, start, goal, Limits(v, a))
            return ArcLeg(self._reach, start, circle, goal, Limits(v, a), fixed=mode == 1)

        return self._follow(leg, r)

    def _line(self, name: str, pose: Sequence[float], a: float, v: float, t: float, r: float, *, process: bool) -> Move:
        fault = _not_usable(name, (*pose, t, r), a, v, t)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(pose)
        return self._follow(lambda start: LineLeg(self._reach, start, goal, Limits(v, a), t, process=process), r)

    def _follow(self, make_leg: Callable[[Joints], Leg], radius_m: float) -> Move:
        """Begin a leg: from rest, by blending with the leg before, or by taking over from an arm in motion.

        A waypoint whose blend overlaps the one before is skipped: the leg before goes on, and the next move may blend
        with that.
        """
        before, radius_m = self._generator, max(radius_m, 0.0)
        end = None
        try:
            if isinstance(before, PathMotion) and self._blendable:
                end = before.leg_end(self._start()[0])
            leaving = self._coast() if end is None else end
            leg = self._planned(make_leg, leaving)
        except MotionFault as fault:
            return self._refuse(fault)
        corner_m = before.radius_m if isinstance(before, PathMotion) and end is not None else None
        warning = overlap(leg, radius_m, corner_m or 0.0)
        if warning is not None:
            self._warnings.append(warning)
            if warning.skips:
                return Move(ready=True)
        blend = None if leaving is None else blend_into(leaving, leg, corner_m)
        if end is None:
            self._take_over()
        return self._install(PathMotion(leg, radius_m, blend))

    def _planned(self, make_leg: Callable[[Joints], Leg], leaving: Leaving | None) -> Leg:
        """The leg from where the motion before ends. Raises MotionFault when the tool cannot get to its goal."""
        leg = make_leg(self._start()[0] if leaving is None else leaving.corner)
        if self.wrench_limit is not None:
            self.wrench_limit.slow(leg, self.tcp_offset)
        if isinstance(leg, ToolLeg) and leg.length < _DIRECTION_M:
            self._reachable(leg.goal())
        return leg

    def _coast(self) -> Coast | None:
        """From the present speed to rest within the position limits; None at rest."""
        q, qd = self._start()
        fastest = largest(qd)
        if fastest == 0.0:
            return None
        duration = min(fastest / _HANDOVER_RAD_S2, *self._limits.longest_stop(q, qd))
        return Coast(q, qd, duration) if duration > 0.0 else None

    def abort(self) -> None:
        """End a movej or movel: stop on the path, or with a blend radius let the next move blend in from here.

        Nothing else can be aborted (Script Manual), and nothing happens while the arm is paused (guess).
        """
        movement = self._generator
        if not isinstance(movement, PathMotion) or self.paused or self.stopping:
            return
        leg = movement.leg
        movej_or_movel = isinstance(leg, JointLeg) or (isinstance(leg, LineLeg) and not leg.process)
        if movej_or_movel and not movement.abort():
            self.stop()

    # streaming

    def servoj(self, q: Sequence[float], *, t: float, lookahead_time: float = 0.1, gain: float = 300.0) -> Move:
        """Follow q for t seconds of the program's time (one period at least), then keep heading for it."""
        numbers = (*q, t, lookahead_time, gain)
        fault = bad_setpoint("servoj's target") if not all_finite(numbers) else self._limits.outside(as_six(q))
        if fault is not None:
            return self._refuse(fault)
        servo = self._generator
        if not (isinstance(servo, JointServo) and self._streaming):
            servo = JointServo(self._reach, *self._start())
            self._take_over()
        servo.command(as_six(q), t, lookahead_time, gain)
        return self._install(servo)

    def servoc(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Move:
        """Head for the pose at tool speed v; ready within r of it."""
        fault = _not_usable("servoc", (*pose, r), a, v)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(pose)
        try:
            self._reachable(goal)
        except MotionFault as unreachable:
            return self._refuse(unreachable)
        servo = self._generator
        if not (isinstance(servo, ToolServo) and self._streaming and servo.reach is self._reach):
            servo = ToolServo(self._reach, *self._start())
            self._take_over()
        servo.command(goal, Limits(min(v, TOOL_LIMITS.speed), min(a, TOOL_LIMITS.acceleration)), r)
        return self._install(servo)

    def speedj(self, qd: Sequence[float], *, a: float, t: float | None = None) -> Move:
        """Accelerate to joint speeds and hold them; ready after t, or without t at that speed."""
        fault = _not_finite("speedj", qd, a, t)
        if fault is not None:
            return self._refuse(fault)
        wanted = as_six(qd)
        excess = max(abs(speed) / most for speed, most in zip(wanted, self.model.qd_max, strict=True))
        if excess > 1.0:
            wanted = scaled(wanted, 1.0 / excess)
        speed = self._generator
        if not (isinstance(speed, JointSpeed) and self._streaming):
            speed = JointSpeed(*self._start())
            self._take_over()
        speed.command(wanted, min(a, *self.model.qdd_max), t)
        return self._install(speed)

    def speedl(self, xd: Sequence[float], *, a: float, a_rot: float | None = None, t: float | None = None) -> Move:
        """Accelerate to a tool velocity in the base frame [m/s, rad/s] and hold it; a_rot defaults to a."""
        turn_a = a if a_rot is None else a_rot
        fault = _not_finite("speedl", xd, a + turn_a, t)
        if fault is not None:
            return self._refuse(fault)
        wanted = as_six(xd)
        excess = norm3(*wanted[:3]) / TOOL_LIMITS.speed
        if excess > 1.0:
            wanted = scaled(wanted, 1.0 / excess)
        speed = self._generator
        if not (isinstance(speed, ToolSpeed) and self._streaming and speed.reach is self._reach):
            speed = ToolSpeed(self._reach, *self._start())
            self._take_over()
        speed.command(wanted, min(a, TOOL_LIMITS.acceleration), min(turn_a, _TURN_ACCELERATION_MAX), t)
        return self._install(speed)

    @property
    def _streaming(self) -> bool:
        """A stream may go on from its own state; after force mode the arm is elsewhere."""
        return self._compliance is None or not self._compliance.released

    def direct_torque(self, command: TorqueCommand, respond: TorqueResponse) -> Move:
        """Let torques move the arm for one control period; ``respond`` tells where they take it."""
        if not all_finite((*command.torque, *command.viscous_scale, *command.coulomb_scale)):
            return self._refuse(bad_setpoint("direct_torque's torque"))
        generator = self._generator
        if not (isinstance(generator, DirectTorque) and self._streaming):
            generator = DirectTorque(self._start()[1], respond, lambda: self._ramp)
            self._take_over()
        generator.command(command)
        return self._install(generator)

    @property
    def torque(self) -> TorqueCommand | None:
        """The torques that a program commands in this period; None when the arm is to follow its target."""
        return self._generator.acting if isinstance(self._generator, DirectTorque) else None

    @property
    def control_mode(self) -> ControlMode:
        """TORQUE while torques are commanded; else TEACH in freedrive, FORCE in force mode, POSITION otherwise."""
        return ControlMode.TORQUE if self.torque is not None else super().control_mode

    # stops of a program

    def stopj(self, a: float) -> Move:
        """Slow all joints to rest together, the leading one by ``a`` [rad/s2]; ready at rest."""
        if not (isfinite(a) and a > 0.0):
            return self._refuse(bad_setpoint("stopj's deceleration"))
        return self._stop_joints(a)

    def stopl(self, a: float, a_rot: float | None = None) -> Move:
        """Slow the tool to rest by ``a`` [m/s2] and ``a_rot`` [rad/s2], which defaults to a."""
        turn_a = a if a_rot is None else a_rot
        if not (isfinite(a + turn_a) and a > 0.0 and turn_a > 0.0):
            return self._refuse(bad_setpoint("stopl's deceleration"))
        a, turn_a = min(a, TOOL_LIMITS.acceleration), min(turn_a, _TURN_ACCELERATION_MAX)
        return self._install(ToolStop(self._reach, *self._start(), a, turn_a))

    def program_stopped(self) -> None:
        """The program is over: no more force mode or freedrive, nothing on the path, and the arm comes to rest."""
        self.offset_settings, self.displacement_lost = OffsetSettings(), None
        self.end_force_mode()
        self.stop()

    # compliance

    def start_force_mode(
        self,
        task_frame: Sequence[float],
        selection: Sequence[float],
        wrench: Sequence[float],
        type: int,  # noqa: A002 - the name of the script function's parameter
        limits: Sequence[float],
    ) -> None:
        """Comply in the selected directions of task_frame (in the base frame), beside any other movement.

        ``limits`` are speeds [m/s, rad/s] in compliant directions. Raises ValueError for an unknown type.
        """
        if not all_finite((*task_frame, *selection, *wrench, *limits)):
            raise ValueError("force mode needs finite numbers")
        self._comply(Task.force(as_six(task_frame), selection, wrench, type, limits))

    def screw_driving(self, force_N: float, speed_m_s: float) -> None:
        """Push along the tool's own z axis, no faster than ``speed_m_s``, beside any other movement."""
        self._comply(Task.screw(force_N, speed_m_s))

    def end_force_mode(self) -> None:
        """Comply no more; the arm comes to rest where it is. Also ends freedrive."""
        if self._compliance is not None:
            self._compliance.release()

    def freedrive(self, free_axes: Sequence[float] = (1,) * 6, feature: Pose | None = ZERO) -> None:
        """Let the external wrench move the tool along the free axes of a frame given in the base frame.

        None is the tool's own frame.
        """
        if self._generator is not None:
            self.stopj(_HANDOVER_RAD_S2)
        self._comply(Task.free(None if feature is None else as_six(feature), free_axes))

    def end_freedrive(self) -> None:
        """As end_force_mode."""
        self.end_force_mode()

    def _comply(self, task: Task) -> None:
        if self._compliance is None:
            self._compliance = Compliance(self._reach, self.q, scaled(self.qd, self.period_s), task)
            self._nominal, self._nominal_qd = self._start()
        else:
            self._compliance.comply(task)


def _not_usable(name: str, numbers: Sequence[float], a: float, v: float, t: float = 0.0) -> MotionFault | None:
    """A fault unless the numbers are finite and speed and acceleration (where no time is given) positive."""
    if not all_finite((*numbers, a, v)):
        return bad_setpoint(f"{name}'s target")
    if t <= 0.0 and (a <= 0.0 or v <= 0.0):
        return bad_setpoint(f"{name}'s acceleration or speed")
    return None


def _not_finite(name: str, speeds: Sequence[float], a: float, t: float | None) -> MotionFault | None:
    return None if all_finite((*speeds, a, t or 0.0)) else bad_setpoint(f"{name}'s speed")
