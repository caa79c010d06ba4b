"""The movements that a program can command, one method each.

Every method returns a `Move`; the program waits until it is ready. A command that cannot start (target out of reach,
outside the joint limits, not a number) returns a failed Move, and the next period reports the fault and stops the arm.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import isfinite

from emulator.motion.blends import Coast, Leaving, blend_into, overlap
from emulator.motion.compliance import ForceControl
from emulator.motion.faults import MotionFault, MotionWarning, bad_setpoint, singular_start
from emulator.motion.generator import Generator
from emulator.motion.legs import TOOL_LIMITS, ArcLeg, JointLeg, Leg, LineLeg, ToolLeg, circle_through
from emulator.motion.movement import ActiveMovement, Move
from emulator.motion.path_motion import PathMotion
from emulator.motion.position_limits import PositionLimits
from emulator.motion.profile import Limits
from emulator.motion.program_time import RAMP_RAD_S2
from emulator.motion.reach import singularity
from emulator.motion.servo import JointServo, ToolServo
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stops import ToolStop, brake_together
from emulator.motion.superposition import Kind, Superposition
from emulator.motion.target import ArmTarget
from emulator.motion.torque import DirectTorque, TorqueResponse
from emulator.motion.wrench_limit import WrenchLimit
from emulator.robot.drives import TorqueCommand
from urproto.robots.model import Joints
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, all_finite, as_six, largest, lerp, norm3, scaled

_HANDOVER_RAD_S2 = 10.0  # leading joint, when a movement of another kind takes over from an arm in motion (guess)
_TURN_ACCELERATION_MAX = TOOL_LIMITS.acceleration / 0.25  # rad/s2, at the equivalent radius (guess)
# A tool path of at least this length is a direction, followed as far as the arm reaches: PolyScope's Direction nodes
# end 1000 m away and are stopped on the way. The threshold is a guess.
_DIRECTION_M = 100.0


class MotionCommands:
    """Motion commands. Joint vectors (6,) base to wrist 3 [rad]; poses base to TCP [m, rotation vector].

    Commands arrive between two periods. They plan a movement and make it the movement in progress; nothing moves
    before the next period. ``wrench_limit``: the limit set by tool_wrench_limit_set, or None.
    """

    def __init__(
        self,
        target: ArmTarget,
        limits: PositionLimits,
        movement: ActiveMovement,
        superposition: Superposition,
        force_control: ForceControl,
    ) -> None:
        self.wrench_limit: WrenchLimit | None = None
        self._target, self._limits = target, limits
        self._movement = movement
        self._superposition, self._force_control = superposition, force_control
        self._refusal: MotionFault | None = None
        self._warnings: list[MotionWarning] = []

    # moves along a path

    def movej(self, q: Sequence[float], *, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Move:
        """Joint line to q; ``a`` and ``v`` of the leading joint [rad/s2, rad/s]; t > 0 [s] overrides both; r [m]."""
        fault = _not_usable("movej", (*q, t, r), a, v, t) or self._limits.outside(as_six(q))
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(q)
        return self._follow(lambda start: JointLeg(self._target.reach, start, goal, Limits(v, a), t), r)

    def movel(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> Move:
        """Straight tool path; a and v of the TCP [m/s2, m/s]; t > 0 [s] overrides both; blend radius r [m]."""
        return self._line("movel", pose, a, v, t, r, process=False)

    def movep(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Move:
        """Like movel, with corners between two movep rounded by arcs at constant tool speed."""
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
        """Circular tool path through ``via``; mode 1 keeps the orientation relative to the arc."""
        fault = _not_usable("movec", (*via, *to, r), a, v)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(to)

        def leg(start: Joints) -> Leg:
            here = self._target.reach.pose(start)
            circle = circle_through(here[:3], as_six(via)[:3], goal[:3])
            if circle is None:
                return LineLeg(self._target.reach, start, goal, Limits(v, a))
            return ArcLeg(self._target.reach, start, circle, goal, Limits(v, a), fixed=mode == 1)

        return self._follow(leg, r)

    def _line(self, name: str, pose: Sequence[float], a: float, v: float, t: float, r: float, *, process: bool) -> Move:
        fault = _not_usable(name, (*pose, t, r), a, v, t)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(pose)
        return self._follow(lambda start: LineLeg(self._target.reach, start, goal, Limits(v, a), t, process=process), r)

    def _follow(self, make_leg: Callable[[Joints], Leg], radius_m: float) -> Move:
        """Start a leg: from rest, by blending with the previous leg, or by taking over from an arm in motion.

        A waypoint whose blend overlaps the previous one is skipped: the previous leg continues, and the next move may
        blend with it.
        """
        before, radius_m = self._movement.generator, max(radius_m, 0.0)
        end = None
        # Everything that can fail comes before any change of state: a refused move must not affect the previous one
        # until the arm stops in the next period.
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
            self._take_over()  # a blend, in contrast, continues at the time scale of the previous leg
        return self._begin(PathMotion(leg, radius_m, blend))

    def _planned(self, make_leg: Callable[[Joints], Leg], leaving: Leaving | None) -> Leg:
        """Plan the leg from where the previous motion ends. Raises MotionFault if the tool cannot follow it."""
        start = self._start()[0] if leaving is None else leaving.corner
        leg = make_leg(start)
        if isinstance(leg, ToolLeg) and leg.length and leaving is None:
            stuck = singularity(self._target.model.dh, start)
            if stuck is not None:
                raise singular_start(stuck)
        if self.wrench_limit is not None:
            self.wrench_limit.slow(leg, self._target.reach.tcp_offset)
        if isinstance(leg, ToolLeg) and leg.length < _DIRECTION_M:
            self._reachable(leg.goal())
        return leg

    def _coast(self) -> Coast | None:
        """Motion from the present speed to rest within the position limits; None at rest."""
        q, qd = self._start()
        fastest = largest(qd)
        if fastest == 0.0:
            return None
        duration = min(fastest / _HANDOVER_RAD_S2, *self._limits.longest_stop(q, qd))
        return Coast(q, qd, duration) if duration > 0.0 else None

    def abort(self) -> None:
        """End a movej or movel: stop on the path or, if it has a blend radius, let the next move blend in from here.

        No other movement can be aborted (Script Manual), and a paused one is left alone (guess).
        """
        movement = self._movement.generator
        if not isinstance(movement, PathMotion) or self._movement.paused or self._movement.stopping:
            return
        leg = movement.leg
        movej_or_movel = isinstance(leg, JointLeg) or (isinstance(leg, LineLeg) and not leg.process)
        if movej_or_movel and not movement.abort():
            self.stop()

    def stop(self, decel: float | None = None) -> None:
        """Stop on the path, the leading joint slowing by ``decel`` [rad/s2], and end the movement.

        If the path is displaced, it no longer continues from where the arm is: all joints slow down together then.
        """
        displaced = self._superposition.active
        self._superposition.release()
        self._force_control.slow_down(self._movement.time.pace)
        self._movement.stop(RAMP_RAD_S2 if decel is None else decel, along_path=not displaced)

    # streaming

    def servoj(self, q: Sequence[float], *, t: float, lookahead_time: float = 0.1, gain: float = 300.0) -> Move:
        """Follow q for t seconds of program time, then keep moving towards it."""
        numbers, target = (*q, t, lookahead_time, gain), as_six(q)
        fault = bad_setpoint("servoj's target") if not all_finite(numbers) else self._limits.outside(target)
        if fault is not None:
            return self._refuse(fault)
        servo = self._movement.generator
        if not (isinstance(servo, JointServo) and self._streaming):
            servo = JointServo(self._target.reach, *self._start())
            self._take_over()
        servo.command(target, t, lookahead_time, gain)
        return self._begin(servo, timeless=t <= 0.0)

    def servoc(self, pose: Sequence[float], *, a: float = 1.2, v: float = 0.25, r: float = 0.0) -> Move:
        """Move towards the pose at tool speed v; ready within r of it."""
        fault = _not_usable("servoc", (*pose, r), a, v)
        if fault is not None:
            return self._refuse(fault)
        goal = as_six(pose)
        try:
            self._reachable(goal)
        except MotionFault as unreachable:
            return self._refuse(unreachable)
        servo = self._movement.generator
        if not (isinstance(servo, ToolServo) and self._streaming and servo.reach is self._target.reach):
            servo = ToolServo(self._target.reach, *self._start())
            self._take_over()
        servo.command(goal, Limits(min(v, TOOL_LIMITS.speed), min(a, TOOL_LIMITS.acceleration)), r)
        return self._begin(servo)

    def speedj(self, qd: Sequence[float], *, a: float, t: float | None = None) -> Move:
        """Accelerate to joint speeds and hold them; ready after t or, without t, once they are reached.

        For t = 0, or when the arm holds these speeds already, the program does not wait.
        """
        fault = _not_finite("speedj", qd, a, t)
        if fault is not None:
            return self._refuse(fault)
        wanted = as_six(qd)
        excess = max(abs(speed) / most for speed, most in zip(wanted, self._target.model.qd_max, strict=True))
        if excess > 1.0:
            wanted = scaled(wanted, 1.0 / excess)
        speed = self._movement.generator
        if not (isinstance(speed, JointSpeed) and self._streaming):
            speed = JointSpeed(*self._start())
            self._take_over()
        speed.command(wanted, min(a, *self._target.model.qdd_max), t)
        return self._begin(speed, timeless=speed.timeless)

    def speedl(self, xd: Sequence[float], *, a: float, a_rot: float | None = None, t: float | None = None) -> Move:
        """Accelerate to a tool velocity in the base frame [m/s, rad/s] and hold it; a_rot defaults to a.

        Ready as with speedj.
        """
        turn_a = a if a_rot is None else a_rot
        fault = _not_finite("speedl", xd, a + turn_a, t)
        if fault is not None:
            return self._refuse(fault)
        wanted = as_six(xd)
        excess = norm3(*wanted[:3]) / TOOL_LIMITS.speed
        if excess > 1.0:
            wanted = scaled(wanted, 1.0 / excess)
        speed = self._movement.generator
        if not (isinstance(speed, ToolSpeed) and self._streaming and speed.reach is self._target.reach):
            speed = ToolSpeed(self._target.reach, *self._start())
            self._take_over()
        speed.command(wanted, min(a, TOOL_LIMITS.acceleration), min(turn_a, _TURN_ACCELERATION_MAX), t)
        return self._begin(speed, timeless=speed.timeless)

    @property
    def _blendable(self) -> bool:
        """Whether a blend is possible: the arm is where its generator says, and the movement is not being stopped."""
        return not (self._force_control.active or self._movement.stopping)

    @property
    def _streaming(self) -> bool:
        """Whether a stream may continue from its own state: after force mode, the arm is elsewhere."""
        return not self._force_control.released

    def direct_torque(self, command: TorqueCommand, respond: TorqueResponse) -> Move:
        """Let torques move the arm for one control period; ``respond`` calculates where it moves."""
        if not all_finite((*command.torque, *command.viscous_scale, *command.coulomb_scale)):
            return self._refuse(bad_setpoint("direct_torque's torque"))
        generator = self._movement.generator
        if not (isinstance(generator, DirectTorque) and self._streaming):
            generator = DirectTorque(self._here()[1], respond, lambda: self._movement.ramp)
            self._take_over()
        generator.command(command)
        return self._begin(generator)

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
        (q, qd, late_s), reach, held = self._leaving(), self._target.reach, self._held_speed
        start = (reach.pose(q), reach.twist(q, qd) if qd != ZERO6 else ZERO6)
        if isinstance(held, ToolSpeed) and held.reach is reach:
            start = (held.end.place, scaled(held.end.speed, self._movement.scale))
        return self._begin(ToolStop(reach, self._target.period_s, start, qd, (a, turn_a), late_s))

    # freedrive, and the end of path offsets and tracking

    def freedrive(self, free_axes: Sequence[float] = (1,) * 6, feature: Pose | None = ZERO6) -> None:
        """Stop, and let the external wrench move the tool along the free axes of a frame given in the base frame.

        None stands for the tool's own frame. Active until `ForceControl.end`.
        """
        if self._movement.generator is not None:
            self.stopj(_HANDOVER_RAD_S2)
        self._force_control.freedrive(free_axes, feature)

    def disable_path_offset(self, a: float) -> Move:
        """End the path offset and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.PATH_OFFSET, a)

    def stop_tracking(self, a: float) -> Move:
        """End conveyor tracking and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.CONVEYOR, a)

    def stop_tracking_frame(self, a: float) -> Move:
        """End frame tracking and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.FRAME, a)

    def _end_source(self, kind: Kind, a: float) -> Move:
        """Make the displaced path the path itself; from there, all joints stop."""
        try:
            self._superposition.end(kind)
        except MotionFault as fault:
            return self._refuse(fault)
        return self._stop_joints(a)

    # reports

    def take_refusal(self) -> MotionFault | None:
        """Reason why a command since the last call could not start, or None."""
        refusal, self._refusal = self._refusal, None
        return refusal

    def take_warnings(self) -> tuple[MotionWarning, ...]:
        """Warnings about the commands since the last call, which the arm executes nevertheless."""
        if not self._warnings:
            return ()
        warnings = tuple(self._warnings)
        self._warnings.clear()
        return warnings

    # beginning a movement

    def _start(self) -> tuple[Joints, Joints]:
        """Position and speed at which a new movement starts, the speed in the program's time."""
        (q, qd), pace = self._here(), self._movement.time.pace
        return (q, scaled(qd, 1.0 / pace)) if 0.0 < pace < 1.0 else (q, qd)

    def _leaving(self) -> tuple[Joints, Joints, float]:
        """Where a stop begins: position, speed in the program's time, and how long ago that was [s].

        A speed that was commanded for a time ends exactly then; other stops begin when the frame was due.
        """
        (q, qd), held = self._start(), self._held_speed
        if isinstance(held, JointSpeed):
            qd = scaled(held.end.speed, self._movement.scale)
        if held is not None and held.late_s is not None:
            with suppress(MotionFault):  # at the end of the tool's reach, the stop begins here
                return held.joints_at_end(q), qd, held.late_s / self._movement.scale
        late_s = self._movement.time.late_s
        return lerp(q, qd, -late_s), qd, late_s

    @property
    def _held_speed(self) -> JointSpeed | ToolSpeed | None:
        """The speed that the arm holds, unless it deviates from it."""
        deviating = self._superposition.active or self._force_control.active
        return None if deviating else self._movement.held_speed

    def _here(self) -> tuple[Joints, Joints]:
        """Present position and actual speed: the arm's or, if the path is displaced, the path's.

        A deviation left by force mode would remain next to a displaced path for ever, so it first becomes part of it.
        """
        if not self._superposition.active:
            return self._target.q, self._target.qd
        if self._force_control.released and self._superposition.rejoin():
            self._force_control.drop()
        return self._movement.q, self._movement.qd

    def _begin(self, generator: Generator, *, timeless: bool = False) -> Move:
        """Make this the movement in progress; the wait for the previous one ends."""
        start = self._here()
        if self._force_control.released and not self._superposition.active:
            self._force_control.drop()  # the movement starts where force mode has left the arm
        return self._movement.begin(generator, *start, timeless=timeless)

    def _take_over(self) -> None:
        """Start a movement of another kind from the arm's present speed."""
        self._movement.take_over(largest(self._start()[1]))

    def _stop_joints(self, a: float) -> Move:
        q, qd, late_s = self._leaving()
        return self._begin(brake_together(q, qd, min(a, *self._target.model.qdd_max), late_s))

    def _refuse(self, fault: MotionFault) -> Move:
        """Fail a command that cannot start; the next period causes a protective stop."""
        self._refusal = fault
        return Move(failed=fault)

    def _reachable(self, pose_base_tcp: Pose) -> None:
        """Raise MotionFault if no joint configuration has this pose."""
        self._target.reach.joints(pose_base_tcp, self._target.q)


def _not_usable(name: str, numbers: Sequence[float], a: float, v: float, t: float = 0.0) -> MotionFault | None:
    """A fault unless all numbers are finite and, without a given time, speed and acceleration are positive."""
    if not all_finite((*numbers, a, v)):
        return bad_setpoint(f"{name}'s target")
    if t <= 0.0 and (a <= 0.0 or v <= 0.0):
        return bad_setpoint(f"{name}'s acceleration or speed")
    return None


def _not_finite(name: str, speeds: Sequence[float], a: float, t: float | None) -> MotionFault | None:
    return None if all_finite((*speeds, a, t or 0.0)) else bad_setpoint(f"{name}'s speed")
