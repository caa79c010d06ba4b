"""The movement in progress: its position on the path, its time scale, whether it is held, and who waits for it."""

from dataclasses import dataclass
from enum import Enum, auto

from emulator.motion.faults import MotionFault
from emulator.motion.generator import Clock, Generator
from emulator.motion.pacing import Excess, Pacer
from emulator.motion.path_motion import PathMotion
from emulator.motion.program_time import RAMP_RAD_S2, ProgramTime
from emulator.motion.servo import JointServo
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stops import JointStop, StopOrigin, ToolStop, brake_together
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six, largest

_SAME_SCALE = 1e-9
_GOVERNED = (PathMotion, JointSpeed, ToolSpeed)  # streamed targets set their own pace


@dataclass(slots=True, eq=False)
class Move:
    """A commanded movement: its program waits until ``ready`` or ``failed``, or not at all if ``timeless``."""

    ready: bool = False  # arrived, blend begun, time over, or replaced by another movement
    failed: MotionFault | None = None
    timeless: bool = False  # a speed or target for no time: the program continues in the same control period

    @property
    def over(self) -> bool:
        """Whether its program continues."""
        return self.ready or self.failed is not None


class Holding(Enum):
    """What happens to the movement in progress."""

    RUN = auto()
    PAUSE = auto()  # stand still on the path, continue later
    STOP = auto()  # stand still on the path, then discard it


class ActiveMovement:
    """The movement in progress, if there is one, and its path.

    ``q``, ``qd``: position and speed on the path [rad, rad/s]. They are the arm's target unless the path is displaced
    or the arm is compliant. ``generator``: None while nothing is in progress. ``time``: the program's time, in which it
    takes place. ``ramp``: acceleration of the leading joint for a pause, a stop, or the speed slider [rad/s2].
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.q: Joints = as_six(q)
        self.qd: Joints = ZERO6
        self.generator: Generator | None = None
        self.time = ProgramTime(period_s)
        self.ramp = RAMP_RAD_S2
        self.excess: Excess | None = None  # by how much a step would exceed the safety system's limits
        self._period_s = period_s
        self._qdd_max = model.qdd_max
        self._pacer = Pacer(model, period_s)
        self._holding = Holding.RUN
        self._waiting: Move | None = None
        self._goal: Generator | None = None  # its goal is that of the path, even after arrival
        self._proposed: Generator | None = None  # the generator that moves in this period

    # state

    @property
    def running(self) -> bool:
        """Whether it is neither paused nor being stopped."""
        return self._holding is Holding.RUN

    @property
    def paused(self) -> bool:
        """Whether it is held on its path until `resume`; it may still be slowing down."""
        return self._holding is Holding.PAUSE

    @property
    def stopping(self) -> bool:
        """Whether it is slowing down on its path, to be discarded afterwards."""
        return self._holding is Holding.STOP

    @property
    def slowing(self) -> bool:
        """Whether the program's time still passes, although a pause slows it down."""
        return self.paused and self.time.pace > 0.0

    @property
    def over(self) -> bool:
        """Whether no movement is in progress and no stop of the last one either."""
        return self.generator is None and self._holding is not Holding.STOP

    @property
    def unconditional(self) -> bool:
        """Whether a fault or the brakes stop the arm. Position limits must not end that: nothing stops it faster."""
        return isinstance(self.generator, JointStop) and self.generator.origin is not StopOrigin.COMMAND

    @property
    def braking(self) -> bool:
        """Whether the brakes bring the arm to rest."""
        return isinstance(self.generator, JointStop) and self.generator.origin is StopOrigin.BRAKES

    @property
    def goal(self) -> Pose | None:
        """Target TCP pose of the path, or of the last one; None if there was none since the arm was placed here."""
        return None if self._goal is None else self._goal.goal()

    @property
    def share(self) -> float:
        """Fraction of a path's speed that the joints' limits permit; 1 for other movements, paced by their sender."""
        return self._pacer.share if isinstance(self.generator, PathMotion) else 1.0

    @property
    def held_speed(self) -> JointSpeed | ToolSpeed | None:
        """The speed that is held, unless it stands still."""
        generator = self.generator
        return generator if isinstance(generator, JointSpeed | ToolSpeed) and self.scale > 0.0 else None

    @property
    def scale(self) -> float:
        """The movement's own time in the program's time."""
        return self._pacer.scale

    # beginning and ending

    def begin(self, generator: Generator, q: Joints, qd: Joints, *, timeless: bool = False) -> Move:
        """Make this the movement in progress, from here; the wait for the previous one ends.

        A stream that continues with its own generator continues from its own state: its path is not moved.
        """
        self._end_waiting()
        if self.stopping:
            self._holding = Holding.RUN
        if generator is not self.generator:
            self.put(q, qd)
            self.generator = generator
            self._goal = generator if generator.goal() is not None else None
        self._freeze_held_time()
        self._waiting = Move(timeless=timeless)
        return self._waiting

    def take_over(self, speed_rad_s: float) -> None:
        """A movement of another kind starts while the leading joint has this speed, from which it is not ramped up."""
        self._pacer.reset(speed_rad_s)

    def put(self, q: Joints, qd: Joints) -> None:
        """Set the position and speed of the path."""
        self.q, self.qd = q, qd

    def stand(self, q: Joints) -> None:
        """The arm has been placed here: the path has no goal any more."""
        self.put(q, ZERO6)
        self._goal = None

    def fail(self, fault: MotionFault) -> None:
        """End the movement with a fault, which its program receives."""
        if self._waiting is not None:
            self._waiting.failed = fault
            self._waiting = None
        self._drop()

    def discard(self) -> None:
        """Discard the movement and any pause; its program continues."""
        self._drop()
        self.time.freeze()
        self._holding = Holding.RUN

    def brake(self, stop: JointStop, q: Joints, qd: Joints) -> None:
        """Let this stop alone move the arm, from here; nothing waits for it."""
        self.put(q, qd)
        self.generator = stop
        self._freeze_held_time()

    def _drop(self) -> None:
        self.generator = None
        self._end_waiting()
        if self.stopping:
            self._holding = Holding.RUN

    def _end_waiting(self) -> None:
        if self._waiting is not None:
            self._waiting.ready = True
            self._waiting = None

    # holding

    def pause(self) -> None:
        self._hold(RAMP_RAD_S2)

    def resume(self) -> None:
        self._holding, self.ramp = Holding.RUN, RAMP_RAD_S2

    def protective_stop(self) -> None:
        """Like `pause`, but as quickly as the joints' acceleration limit allows."""
        self._hold(min(self._qdd_max))

    def _hold(self, ramp: float) -> None:
        self._holding, self.ramp = Holding.PAUSE, ramp
        self._freeze_held_time()

    def _freeze_held_time(self) -> None:
        """Nothing of the program may happen while something else brings the arm to rest, or torques can no longer."""
        if self.paused and self.generator is not None and self.generator.clock is Clock.REAL:
            self.time.freeze()

    def stop(self, deceleration: float, *, along_path: bool) -> None:
        """Bring the movement to rest, the leading joint by this [rad/s2], and discard it.

        The arm stops on the path or, if the path no longer continues from here, with all joints together. A wait for
        the movement ends when the arm stands still.
        """
        self.ramp = deceleration
        if not along_path or self._stops_too_late():
            self.generator = brake_together(self.q, self.qd, deceleration)
        self._pacer.slow_down(self.time.pace)
        self.time.run_on()
        self._holding = Holding.STOP if self.generator is not None else Holding.RUN

    def use_fastest_ramp(self) -> None:
        """Let the speed change as quickly as the joints can until it has reached its commanded value."""
        if self.running:
            self.ramp = min(self._qdd_max)

    def _stops_too_late(self) -> bool:
        """Whether a stop of the program is held by a pause, or gentler than the one now requested."""
        stop = self.generator
        if not isinstance(stop, JointStop | ToolStop) or self.unconditional:
            return False
        return self.time.pace < 1.0 or largest(self.qd) < stop.remaining_s * self.ramp

    # one control period

    def start_period(self, qd: Joints, qdd: Joints) -> None:
        """Let the program's time pass; the arm had these speeds and accelerations in the last period."""
        self.time.advance(qd, qdd, held=self.paused, ramp=self.ramp if self.paused else RAMP_RAD_S2)

    def propose(self, fraction: float) -> Joints:
        """Propose the next position on the path, with the speed slider at ``fraction`` (0..1).

        Nothing changes until `commit`, so that a check that rejects the proposal can still end the movement where it
        is. Raises MotionFault.
        """
        generator = self.generator
        target = None if generator is None else self._proposal(generator, 0.0 if self.stopping else fraction)
        self._proposed = None if target is None else generator
        return self.q if target is None else target

    def commit(self) -> bool:
        """The last proposal has been executed. Returns True if nothing moves on: movement over, held, or none."""
        moved = self._proposed
        if moved is None:
            if self.stopping:  # it has come to rest on its path
                self._drop()
            return True
        moved.commit()
        if self._waiting is not None and moved.ready and not self._waiting.ready:
            self._waiting.ready = True
            if not self._waiting.timeless:
                self.time.call()
        over = moved.done
        if over:
            self._drop()
        return over

    def _proposal(self, generator: Generator, fraction: float) -> Joints | None:
        if generator.clock is Clock.REAL:
            return generator.propose(self._period_s, self.q)
        pace = self.time.pace
        if pace <= 0.0:
            return None
        if generator.clock is Clock.PROGRAM:
            return generator.propose(pace * self._period_s, self.q)
        if isinstance(generator, JointServo) and self.running:
            generator.slider(fraction)
        excess = self.excess if isinstance(generator, _GOVERNED) else None
        target = self._pacer.advance(generator, self.q, self.qd, fraction, self.ramp, excess, pace)
        if self.running and abs(self._pacer.scale - fraction) < _SAME_SCALE:
            self.ramp = RAMP_RAD_S2  # the quick change is complete; the slider acts gently again
        return target
