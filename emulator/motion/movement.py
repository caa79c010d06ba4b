"""The movement in progress: where its path is, who waits for it, how fast its time runs, and whether it is held."""

from dataclasses import dataclass
from enum import Enum, auto

from emulator.motion.faults import MotionFault
from emulator.motion.generator import Generator
from emulator.motion.pacing import RAMP_RAD_S2, Excess, Pacer
from emulator.motion.path_motion import PathMotion
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
    """A movement that was asked for: its program waits until ``ready`` or ``failed``."""

    ready: bool = False  # arrived, blend begun, time over, or taken over by another movement
    failed: MotionFault | None = None


class Holding(Enum):
    """What becomes of the movement in progress."""

    RUN = auto()
    PAUSE = auto()  # stand still on the path, go on later
    STOP = auto()  # stand still on the path, then forget it


class ActiveMovement:
    """The movement in progress, if there is one, and its path.

    ``q``, ``qd``: where the path is and how fast it goes on [rad, rad/s]. That is where the arm is told to be unless
    the path is displaced or the arm gives way. ``generator``: None while nothing is in progress. ``ramp``: by which
    the leading joint changes its speed for a pause, a stop, or the speed slider [rad/s2].
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.q: Joints = as_six(q)
        self.qd: Joints = ZERO6
        self.generator: Generator | None = None
        self.ramp = RAMP_RAD_S2
        self.excess: Excess | None = None  # how much too fast a step would be for the safety system's limits
        self._period_s = period_s
        self._qdd_max = model.qdd_max
        self._pacer = Pacer(model, period_s)
        self._holding = Holding.RUN
        self._waiting: Move | None = None
        self._goal: Generator | None = None  # whose goal is that of the path, also after it has arrived
        self._proposed: Generator | None = None  # what moves in this period

    # what is known of it

    @property
    def running(self) -> bool:
        """Neither paused nor being stopped."""
        return self._holding is Holding.RUN

    @property
    def paused(self) -> bool:
        """To stand still on its path until `resume`; it may still be slowing down."""
        return self._holding is Holding.PAUSE

    @property
    def stopping(self) -> bool:
        """Slowing down on its path, after which it is forgotten."""
        return self._holding is Holding.STOP

    @property
    def over(self) -> bool:
        """None is in progress, and nothing is left of the last one."""
        return self.generator is None and self._holding is not Holding.STOP

    @property
    def unconditional(self) -> bool:
        """A fault or the brakes stop the arm. Position limits must not end that: nothing stops it any quicker."""
        return isinstance(self.generator, JointStop) and self.generator.origin is not StopOrigin.COMMAND

    @property
    def braking(self) -> bool:
        """The brakes bring the arm to rest."""
        return isinstance(self.generator, JointStop) and self.generator.origin is StopOrigin.BRAKES

    @property
    def goal(self) -> Pose | None:
        """TCP pose that the path leads to, or led to last; None when there was none since the arm was put here."""
        return None if self._goal is None else self._goal.goal()

    @property
    def share(self) -> float:
        """What the joints' limits leave of a path's speed; 1 for all else, whose sender sets the pace."""
        return self._pacer.share if isinstance(self.generator, PathMotion) else 1.0

    # beginning and ending

    def begin(self, generator: Generator, q: Joints, qd: Joints) -> Move:
        """Make this the movement in progress, from here; whoever waited for the one before waits no longer.

        A stream that goes on with its own generator goes on from its own state: its path is not moved.
        """
        self._end_waiting()
        if self.stopping:
            self._holding = Holding.RUN
        if generator is not self.generator:
            self.put(q, qd)
            self.generator = generator
            self._goal = generator if generator.goal() is not None else None
        if self.paused:
            self._hasten()  # what a program says in the period in which it is stopped must not soften that
        self._waiting = Move()
        return self._waiting

    def take_over(self, speed_rad_s: float) -> None:
        """A movement of another kind begins while the leading joint has this speed: that is not to be ramped up."""
        self._pacer.reset(speed_rad_s)

    def put(self, q: Joints, qd: Joints) -> None:
        """The path is here now."""
        self.q, self.qd = q, qd

    def stand(self, q: Joints) -> None:
        """The arm has been put here, so nothing leads anywhere any more."""
        self.put(q, ZERO6)
        self._goal = None

    def fail(self, fault: MotionFault) -> None:
        """Give it up: its program hears of the fault."""
        if self._waiting is not None:
            self._waiting.failed = fault
            self._waiting = None
        self._drop()

    def forget(self) -> None:
        """Give it up, pause or not; its program goes on."""
        self._drop()
        self._holding = Holding.RUN

    def brake(self, stop: JointStop, q: Joints, qd: Joints) -> None:
        """This stop alone moves the arm, from here; nobody waits for it."""
        self.put(q, qd)
        self.generator = stop

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
        """Slow to a standstill on the path; `resume` goes on."""
        self._holding, self.ramp = Holding.PAUSE, RAMP_RAD_S2

    def resume(self) -> None:
        """Go on after `pause` or `protective_stop`."""
        self._holding, self.ramp = Holding.RUN, RAMP_RAD_S2

    def protective_stop(self) -> None:
        """As `pause`, but as quickly as the joints' acceleration limit allows."""
        self._holding, self.ramp = Holding.PAUSE, min(self._qdd_max)
        self._hasten()

    def stop(self, deceleration: float, *, along_path: bool) -> None:
        """Come to rest, the leading joint by this [rad/s2], and be forgotten.

        On the path, or where that no longer leads on from here, all joints together. Whoever waits for the movement
        waits until the arm stands.
        """
        self.ramp = deceleration
        if not along_path:
            self.generator = brake_together(self.q, self.qd, deceleration)
        self._holding = Holding.STOP if self.generator is not None else Holding.RUN
        self._hasten()

    def quicken(self) -> None:
        """Let the speed change as quickly as the joints can until it is the wanted one."""
        if self.running:
            self.ramp = min(self._qdd_max)

    def _hasten(self) -> None:
        """A gentle stop of the program's becomes as quick as the one now asked for; who waits for it still does.

        Stops run by the clock and not in stretched time, so holding them would do nothing.
        """
        stop = self.generator
        if not isinstance(stop, JointStop | ToolStop) or self.unconditional:
            return
        if largest(self.qd) < stop.remaining_s * self.ramp:
            self.generator = brake_together(self.q, self.qd, self.ramp)

    # one control period

    def propose(self, fraction: float) -> Joints:
        """Where the path goes on to in this period, the program's time running at ``fraction`` (0..1).

        Nothing has changed until `commit`, so that whatever finds fault with the proposal can still end the movement
        where it is. Raises MotionFault.
        """
        generator = self.generator
        target = None if generator is None else self._proposal(generator, fraction if self.running else 0.0)
        self._proposed = None if target is None else generator
        return self.q if target is None else target

    def commit(self) -> bool:
        """The last proposal came true. True when nothing goes on: the movement is over, is held, or there is none."""
        moved = self._proposed
        if moved is None:
            if self.stopping:  # it stands on its path
                self._drop()
            return True
        moved.commit()
        if self._waiting is not None and moved.ready:
            self._waiting.ready = True
        over = moved.done
        if over:
            self._drop()
        return over

    def _proposal(self, generator: Generator, running: float) -> Joints | None:
        if not generator.scaled:
            return generator.propose(self._period_s, self.q)
        if isinstance(generator, JointServo) and self.running:
            generator.slider(running)
        excess = self.excess if isinstance(generator, _GOVERNED) else None
        target = self._pacer.advance(generator, self.q, self.qd, running, self.ramp, excess)
        if self.running and abs(self._pacer.scale - running) < _SAME_SCALE:
            self.ramp = RAMP_RAD_S2  # what had to be quick is done; the slider is moved gently again
        return target
