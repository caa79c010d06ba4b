"""One control period at a time: from the movement in progress to the target joint configuration.

Rules, in order: an unscaled movement (a stop) runs by the clock; a scaled one runs at the speed fraction, or slows to a
standstill on its path while paused; path offsets, tracked frames and conveyors displace it; force mode and freedrive
add to that; the result must leave every joint a way to brake before its position limit. Whatever breaks a rule is a
MotionFault: the movement is dropped and each joint brakes at its acceleration limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

from emulator.motion.compliance import Compliance, Pushing
from emulator.motion.contact import Contact
from emulator.motion.faults import MotionFault, MotionWarning
from emulator.motion.frame_tracking import FrameTracking
from emulator.motion.pacing import RAMP_RAD_S2, Excess, Pacer
from emulator.motion.path_motion import Generator, PathMotion
from emulator.motion.position_limits import PositionLimits
from emulator.motion.reach import Reach
from emulator.motion.servo import JointServo
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stops import JointStop, ToolStop, brake_together
from emulator.motion.superposition import Kind, OffsetFrame, OffsetSettings, PathOffset, Source, Superposition
from emulator.motion.vectors import ZERO, Joints, as_six, largest, scaled, sub
from emulator.motion.wrenchlimit import WrenchLimit
from urproto.modes import ControlMode
from urproto.robots.calibrated import kinematics_of
from urproto.robots.model import RobotModel
from urproto.robots.pose import Pose

_SAME_SCALE = 1e-9
_STEADY_S = 0.5  # Script Manual, is_steady
_GOVERNED = (PathMotion, JointSpeed, ToolSpeed)  # streamed targets set their own pace
_BRAKE_DAMPING = 0.25  # of force mode and freedrive once they end or pause: standing within 0.5 s (guess)


@dataclass(slots=True, eq=False)
class Move:
    """A movement that was asked for: its program waits until ``ready`` or ``failed``."""

    ready: bool = False  # arrived, blend begun, time over, or taken over by another movement
    failed: MotionFault | None = None


class Holding(Enum):
    """What becomes of the movement in progress."""

    RUN = auto()
    PAUSE = auto()  # stand still on the path, go on later
    STOP = auto()  # stand still on the path, then forget it


class Stepper:
    """Target state of the arm and the movement that changes it. Angles rad, poses of the TCP in the base frame."""

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.model = model
        self.period_s = period_s
        self.q: Joints = as_six(q)
        self.qd: Joints = ZERO
        self.qdd: Joints = ZERO
        self.external_wrench: Joints = ZERO  # on the tool at the TCP, base frame [N, Nm]; set by the controller
        self.contacts: tuple[Contact, ...] = ()  # whose forces are part of that; set by the world
        self.actual_q: Joints | None = None  # where the arm is, when it is not where it was told; set by the controller
        self.force_damping = 0.005  # force_mode_set_damping; default of the Script Manual
        self.force_gain_scaling = 1.0  # force_mode_set_gain_scaling
        self.offset_settings = OffsetSettings()  # of path offsets
        self.hard_transitions = True  # set_safety_mode_transition_hardness; what holds before it is called is a guess
        self.wrench_limit: WrenchLimit | None = None  # tool_wrench_limit_set
        self.fault: MotionFault | None = None  # the last one
        self._warnings: list[MotionWarning] = []
        self.displacement_lost: MotionFault | None = None  # the one that ended what was added to the path
        self._limits = PositionLimits(model, period_s)
        self._kinematics = kinematics_of(model)
        self._reach = Reach(model, self._kinematics, ZERO)
        self._pacer = Pacer(model, period_s)
        self._excess: Excess | None = None
        self._generator: Generator | None = None
        self._move: Move | None = None
        self._nominal: Joints = self.q  # where the movement is, without what force mode and the like add
        self._nominal_qd: Joints = ZERO
        self._added: Superposition | None = None  # what displaces the path
        self._compliance: Compliance | None = None
        self._mode = Holding.RUN
        self._ramp = RAMP_RAD_S2
        self._refusal: MotionFault | None = None
        self._emergency: Generator | None = None  # braking after a fault: within the position limits by construction
        self._brakes: Generator | None = None
        self._goal: Generator | None = None
        self._stood_s = _STEADY_S  # for so long, at least

    # state

    @property
    def tcp_offset(self) -> Pose:
        """Flange to TCP. A movement in progress keeps the one it began with."""
        return self._reach.tcp_offset

    @tcp_offset.setter
    def tcp_offset(self, offset: Pose) -> None:
        if as_six(offset) != self._reach.tcp_offset:
            self._reach = Reach(self.model, self._kinematics, as_six(offset))

    @property
    def target_waypoint(self) -> Pose:
        """Where the movement in progress goes; without one, or when a stop has ended it, where the path is."""
        goal = self._goal.goal() if self._goal is not None else None
        return goal if goal is not None else self._reach.pose(self.path_q)

    @property
    def program_q(self) -> Joints:
        """Where the arm is for a program that goes on now [rad]: where the timed speed ends that it has waited for.

        That is up to half a control period from `q`; anywhere else it is `q`.
        """
        generator = self._generator
        if self._beside or self.paused or not isinstance(generator, JointSpeed | ToolSpeed):
            return self.q
        try:
            return generator.joints_at_end(self.q)
        except MotionFault:
            return self.q  # a tool at the end of its reach

    @property
    def path_q(self) -> Joints:
        """Where the arm would be without what displaces the path [rad]."""
        return self.q if self._added is None else self._nominal

    @property
    def path_qd(self) -> Joints:
        """The speed of path_q [rad/s]."""
        return self.qd if self._added is None else self._nominal_qd

    @property
    def idle(self) -> bool:
        """Nothing moves the arm, and it stands."""
        return self._generator is None and self._compliance is None and self._added is None and self.qd == ZERO

    @property
    def steady(self) -> bool:
        """As is_steady(): the arm has stood for a while and is not compliant. True also while a movement is paused."""
        standing = self._stood_s >= _STEADY_S and (self._generator is None or self.paused)
        return standing and self._compliance is None

    @property
    def paused(self) -> bool:
        """Held by `pause` or a protective stop until `resume` (the arm may still be slowing down)."""
        return self._mode is Holding.PAUSE

    @property
    def stopping(self) -> bool:
        """Slowing down on the path, after which the movement is forgotten."""
        return self._mode is Holding.STOP

    @property
    def scale(self) -> float:
        """How fast the movement's own time runs just now, 1 = as planned."""
        return self._pacer.scale

    @property
    def control_mode(self) -> ControlMode:
        """TEACH in freedrive, FORCE in force mode, POSITION otherwise."""
        if self._compliance is None or self._compliance.released:
            return ControlMode.POSITION
        return ControlMode.TEACH if self._compliance.task.freedrive else ControlMode.FORCE

    @property
    def force_frame(self) -> Pose:
        """The task frame of force mode in the base frame; zero without force mode."""
        return self._compliance.task.frame if self.control_mode is ControlMode.FORCE and self._compliance else ZERO

    def govern(self, excess: Excess) -> None:
        """Let movements along a path be slowed down: ``excess`` tells how much too fast a step would be."""
        self._excess = excess

    def limit_positions(self, low: Joints, high: Joints) -> None:
        """Where the joints may go from now on [rad]."""
        self._limits.low, self._limits.high = low, high

    def take_warnings(self) -> tuple[MotionWarning, ...]:
        """What was wrong with the commands since the last call, though the arm moves."""
        if not self._warnings:
            return ()
        warnings = tuple(self._warnings)
        self._warnings.clear()
        return warnings

    def set_position(self, q: Joints) -> None:
        """Put the arm elsewhere. Raises ValueError while it moves, or outside the position limits."""
        position = as_six(q)
        if not self.idle:
            raise ValueError("the arm is moving: stop it before setting its position")
        fault = self._limits.outside(position)
        if fault is not None:
            raise ValueError(fault.text)
        self.q = self._nominal = position
        self._goal = None

    def stand_at(self, q: Joints) -> None:
        """The brakes hold the arm here. Targets of an interrupted movement stay where they are."""
        if q != self.q and self.idle:
            self.q = self._nominal = q
            self._goal = None

    # one control period

    def advance(self, fraction: float) -> MotionFault | None:
        """One control period with the program's time running at ``fraction`` (0..1).

        Returns the fault that ended the movement in this period; the arm is then already braking.
        """
        fault, self._refusal = self._refusal, None
        if fault is None:
            try:
                self._publish(*self._next(fraction))
                return None
            except MotionFault as error:
                fault = error
        self._fail(fault)
        self._publish(*self._next(fraction))
        return fault

    def _next(self, fraction: float) -> tuple[Joints, bool]:
        """The next configuration, and whether the arm then stands."""
        running = fraction if self._mode is Holding.RUN else 0.0
        generator = self._generator
        nominal = self._proposal(generator, running) if generator is not None else None
        before, path = self._nominal, self._nominal if nominal is None else nominal
        here, target = before, path
        if self._added is not None:
            here, target = self._displaced(self._added, path)
        if self._compliance is not None:
            target = self._complied(self._compliance, here, target)
        if generator is None or generator is not self._emergency:
            self._limits.check(target, self.q)
        standing = True
        if generator is not None and nominal is not None:
            generator.commit()
            standing = self._account(generator)
        elif self._mode is Holding.STOP:
            self._drop()
        if self._compliance is None and self._added is None:
            self._nominal = target
            return target, standing
        if self._compliance is not None:
            self._compliance.commit()
            standing = standing and self._compliance.standing()
        self._nominal_qd = scaled(sub(path, before), 1.0 / self.period_s)
        self._nominal = path
        return target, standing if self._added is None else target == self.q

    @property
    def _beside(self) -> bool:
        """The arm is not where its movement is: something is added to that."""
        return self._compliance is not None or self._added is not None

    def _displaced(self, added: Superposition, path: Joints) -> tuple[Joints, Joints]:
        """Where its sources take the path, before and after this period."""
        before = added.q
        return before, added.advance(self._reach, path, None if self._mode is Holding.RUN else self._ramp)

    def _proposal(self, generator: Generator, running: float) -> Joints | None:
        if not generator.scaled:
            return generator.propose(self.period_s, self._nominal)
        if isinstance(generator, JointServo) and self._mode is Holding.RUN:
            generator.slider(running)
        speed = self._nominal_qd if self._beside else self.qd
        excess = self._excess if isinstance(generator, _GOVERNED) else None
        target = self._pacer.advance(generator, self._nominal, speed, running, self._ramp, excess)
        if self._mode is Holding.RUN and abs(self._pacer.scale - running) < _SAME_SCALE:
            self._ramp = RAMP_RAD_S2
        return target

    def _account(self, generator: Generator) -> bool:
        """Tell the waiting program; True when the movement is over."""
        if self._move is not None and generator.ready:
            self._move.ready = True
        if generator.done:
            self._drop()
            return True
        return False

    def _drop(self) -> None:
        self._generator = None
        if self._move is not None:
            self._move.ready = True
        self._move = None
        if self._mode is Holding.STOP:
            self._mode = Holding.RUN

    def _complied(self, compliance: Compliance, before: Joints, nominal: Joints) -> Joints:
        """What force mode or freedrive makes of the movement's way in this period."""
        if compliance.released and compliance.standing() and self._generator is None and self._added is None:
            self._compliance = None
            return self.q
        if self.actual_q is not None and self.actual_q != self.q:
            compliance.check(self.actual_q)
        try:
            target = self._yielded(compliance, (before, nominal))
            self._limits.check(target, self.q)
        except MotionFault:
            if nominal != before:
                raise
            compliance.halt()  # the end of the work space: it yields no further
            return self.q
        return target

    def _yielded(self, compliance: Compliance, path: tuple[Joints, Joints]) -> Joints:
        """Where it gives way to in this period; while the movement is held, nothing pushes."""
        if self._mode is not Holding.RUN:
            damping = max(self.force_damping, _BRAKE_DAMPING)
            return compliance.step(self.period_s, self.q, path, Pushing(ZERO, ()), damping, 0.0)
        pushing = Pushing(self.external_wrench, self.contacts)
        damping = max(self.force_damping, _BRAKE_DAMPING) if compliance.released else self.force_damping
        return compliance.step(self.period_s, self.q, path, pushing, damping, self.force_gain_scaling)

    def _fail(self, fault: MotionFault) -> None:
        self.fault = fault
        if self._added is not None:
            self.displacement_lost = fault
        if self._move is not None:
            self._move.failed = fault
            self._move = None
        self._drop()
        self._compliance = self._added = None
        self._nominal = self.q
        self._generator = self._emergency = self._limits.brake(self.q, self.qd)

    def _publish(self, q: Joints, standing: bool) -> None:
        qd = ZERO if standing else scaled(sub(q, self.q), 1.0 / self.period_s)
        self.qdd = scaled(sub(qd, self.qd), 1.0 / self.period_s)
        self.q, self.qd = q, qd
        self._stood_s = self._stood_s + self.period_s if qd == ZERO else 0.0

    # for the commands

    def _install(self, generator: Generator) -> Move:
        """Make this the movement in progress; whoever waited for the one before waits no longer."""
        if self._move is not None:
            self._move.ready = True
        if self._mode is Holding.STOP:
            self._mode = Holding.RUN
        start = self._start()
        if self._compliance is not None and self._compliance.released and self._added is None:
            self._compliance = None
        if generator is not self._generator:
            self._nominal, self._nominal_qd = start
            self._generator = generator
            self._goal = generator if generator.goal() is not None else None
        self._move = Move()
        return self._move

    def _start(self) -> tuple[Joints, Joints]:
        """Where a new movement starts, and how fast: like the arm, or on the path when that is displaced."""
        if self._added is None:
            return self.q, self.qd
        if self._compliance is not None and self._compliance.released:
            self._rejoin(self._added)
        return self._nominal, self._nominal_qd

    def _rejoin(self, added: Superposition) -> None:
        """Take what force mode left behind as part of the path, so that the next movement can take it back."""
        try:
            self._nominal = added.path_for(self._reach, self.q, self._nominal)
        except MotionFault:
            return  # no path leads here: it stays beside
        self._compliance, added.q, added.qd = None, self.q, self.qd

    def _stop_joints(self, a: float) -> Move:
        """All joints slow to rest together, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._install(brake_together(*self._start(), min(a, *self.model.qdd_max)))

    def _let_go(self) -> None:
        """Displace the path no more: it is where it has been taken."""
        if self._added is not None:
            self._nominal, self._nominal_qd = self._added.q, self._added.qd
            self._added = None

    @property
    def _blendable(self) -> bool:
        """The movement in progress is where its generator says, and on its way."""
        return self._compliance is None and not self.stopping

    def _take_over(self) -> None:
        """A movement of another kind starts from the arm's present speed."""
        self._pacer.reset(largest(self._start()[1]))

    def _refuse(self, fault: MotionFault) -> Move:
        """A command that cannot be begun: it fails now, and the arm stops protectively in the next period."""
        self._refusal = fault
        return Move(failed=fault)

    def _reachable(self, pose_base_tcp: Pose) -> None:
        """Raise MotionFault when no joint configuration has this pose."""
        self._reach.joints(pose_base_tcp, self.q)


_BRAKE_SHARE = 1.5  # of the highest acceleration is what the brakes slow a joint by (guess)


class StoppingStepper(Stepper):
    """A stepper whose movement can be held and ended."""

    def pause(self) -> None:
        """Slow to a standstill on the path; `resume` goes on."""
        self._mode, self._ramp = Holding.PAUSE, RAMP_RAD_S2

    def resume(self) -> None:
        """Go on after `pause` or `protective_stop`."""
        self._mode, self._ramp = Holding.RUN, RAMP_RAD_S2

    def safeguard_stop(self) -> None:
        """As a protective stop, or as gently as a pause when transitions are soft."""
        if self.hard_transitions:
            self.protective_stop()
        else:
            self.pause()

    def engage_brakes(self) -> None:
        """Power is removed (stop category 0): brakes bring each joint to rest, and everything is forgotten."""
        qd, qdd = self.qd, self.qdd
        self.halt()
        if qd != ZERO:
            self.qd, self.qdd = qd, qdd
            durations = (abs(speed) / (_BRAKE_SHARE * a) for speed, a in zip(self.qd, self.model.qdd_max, strict=True))
            self._generator = self._emergency = self._brakes = JointStop(self.q, self.qd, as_six(durations))

    @property
    def braking(self) -> bool:
        """The brakes are bringing the arm to rest."""
        return self._brakes is not None and self._generator is self._brakes

    def mode_changed(self) -> None:
        """Reduced mode begins or ends: the speed follows as quickly as the joints can, unless transitions are soft."""
        if self.hard_transitions and self._mode is Holding.RUN:
            self._ramp = min(self.model.qdd_max)

    def protective_stop(self) -> None:
        """Stop on the path as quickly as the joints' acceleration limit allows; `resume` goes on."""
        self._mode, self._ramp = Holding.PAUSE, min(self.model.qdd_max)
        self._hasten()

    def stop(self, decel: float | None = None) -> None:
        """Stop on the path, the leading joint slowing by ``decel`` [rad/s2], and end the movement."""
        self._ramp = RAMP_RAD_S2 if decel is None else decel
        if self._added is not None:
            self._let_go()
            self._generator = brake_together(self._nominal, self._nominal_qd, self._ramp)
        self._mode = Holding.STOP if self._generator is not None else Holding.RUN
        self._hasten()

    def _hasten(self) -> None:
        """A gentle stop of the program's becomes as quick as the one now asked for; who waits for it still does."""
        stop = self._generator
        if not isinstance(stop, JointStop | ToolStop) or stop is self._emergency:
            return
        speed = self._nominal_qd if self._beside else self.qd
        if largest(speed) < stop.remaining_s * self._ramp:
            self._generator = brake_together(self._nominal, speed, self._ramp)

    def halt(self) -> None:
        """Power is gone: stand still at once and forget everything."""
        self._drop()
        self._compliance = self._refusal = self._added = None
        self._nominal, self._nominal_qd = self.q, ZERO
        self.qd = self.qdd = ZERO
        self._mode = Holding.RUN


class DisplacingStepper(StoppingStepper):
    """A stepper whose path can be displaced."""

    def enable_path_offset(self) -> None:
        """Begin to apply an offset, zero at first. Does nothing when that is so already."""
        if self._path_offset is None:
            self._displace(Kind.PATH_OFFSET, PathOffset(self.offset_settings))

    def set_path_offset(self, offset: Sequence[float], frame: OffsetFrame) -> None:
        """The offset to apply from now on [m, rotation vector]; without effect unless enabled (guess)."""
        if self._path_offset is not None:
            self._path_offset.set(as_six(offset), frame)

    def path_offset(self, frame: OffsetFrame) -> Pose:
        """The offset applied just now, as one of this frame; zero unless enabled."""
        return ZERO if self._path_offset is None else self._path_offset.get(frame)

    def disable_path_offset(self, a: float) -> Move:
        """Add no offset any more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.PATH_OFFSET, a)

    def track(self, conveyor: Source) -> None:
        """Take the path along with a conveyor. Raises ValueError while one is tracked."""
        if self._added is not None and Kind.CONVEYOR in self._added.sources:
            raise ValueError("a conveyor is tracked already: call stop_conveyor_tracking() first")
        self._displace(Kind.CONVEYOR, conveyor)

    def stop_tracking(self, a: float) -> Move:
        """Take the path along no more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.CONVEYOR, a)

    def track_frame(self, frame: FrameTracking) -> None:
        """Take the path along with a frame. Raises ValueError while one is tracked."""
        if self.tracked_frame is not None:
            raise ValueError("a frame is tracked already: call frame_tracking_disable() first")
        self._displace(Kind.FRAME, frame)

    def stop_tracking_frame(self, a: float) -> Move:
        """Take the path along no more and stop all joints, the leading one by ``a`` [rad/s2]; ready at rest."""
        return self._end_source(Kind.FRAME, a)

    @property
    def tracked_frame(self) -> FrameTracking | None:
        """The frame that the path is taken along with."""
        source = None if self._added is None else self._added.sources.get(Kind.FRAME)
        return source if isinstance(source, FrameTracking) else None

    @property
    def _path_offset(self) -> PathOffset | None:
        source = None if self._added is None else self._added.sources.get(Kind.PATH_OFFSET)
        return source if isinstance(source, PathOffset) else None

    def _displace(self, kind: Kind, source: Source) -> None:
        if self._added is None:
            if self._compliance is None:
                self._nominal, self._nominal_qd = self.q, self.qd
            self._added = Superposition(self.period_s, self._nominal, self._nominal_qd)
        self._added.add(kind, source)

    def _end_source(self, kind: Kind, a: float) -> Move:
        """Where the source took the path to becomes the path; from there all joints stop."""
        added = self._added
        if added is not None and added.sources.pop(kind, None) is not None:
            try:
                self._without(added)
            except MotionFault as fault:
                return self._refuse(fault)
        return self._stop_joints(a)

    def _without(self, added: Superposition) -> None:
        if added.sources:
            self._nominal = added.path_for(self._reach, added.q, self._nominal)
        else:
            self._let_go()
