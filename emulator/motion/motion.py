"""The motion generator of one arm: what takes its target from one control period to the next."""

from emulator.motion.commands import MotionCommands
from emulator.motion.compliance import ForceControl
from emulator.motion.faults import MotionFault
from emulator.motion.movement import ActiveMovement
from emulator.motion.pacing import Excess
from emulator.motion.position_limits import PositionLimits
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stops import JointStop, StopOrigin
from emulator.motion.superposition import Superposition
from emulator.motion.target import ArmTarget
from emulator.motion.torque import DirectTorque
from emulator.robot.drives import TorqueCommand
from urproto.modes import ControlMode
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six, scaled, sub

_STEADY_S = 0.5  # Script Manual, is_steady
# User manuals of UR5 and UR3 (appendix A), category 0 stops from 183 degrees/s, stretched out with full payload: their
# bases brake by 16 and 28 rad/s2 on average. One size for all arms and joints, whatever they carry, is a guess
_BRAKES_RAD_S2 = 20.0


class Motion:
    """The target of one arm, and all that changes it. Angles rad, poses of the TCP in the base frame.

    ``commands``: what a program asks for. ``superposition``: path offsets, conveyors and frames that displace the path.
    ``force_control``: force mode and freedrive, which give way beside it. ``movement``: the movement in progress.
    ``target``: where all of that has taken the arm.
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.model = model
        self.period_s = period_s
        self.hard_transitions = True  # set_safety_mode_transition_hardness; what holds before it is called is a guess
        self.fault: MotionFault | None = None  # the last one
        self._limits = PositionLimits(model, period_s)
        self.target = ArmTarget(model, period_s, q)
        self.movement = ActiveMovement(model, period_s, q)
        self.superposition = Superposition(self.target, self.movement)
        self.force_control = ForceControl(self.target, self._limits)
        self.commands = MotionCommands(self.target, self._limits, self.movement, self.superposition, self.force_control)

    # state

    @property
    def q(self) -> Joints:
        """Target angles [rad]."""
        return self.target.q

    @property
    def qd(self) -> Joints:
        """Target speeds [rad/s]: the way of the last period over the period, exactly 0 at rest."""
        return self.target.qd

    @property
    def qdd(self) -> Joints:
        """Target accelerations [rad/s2]."""
        return self.target.qdd

    @property
    def program_q(self) -> Joints:
        """Where the arm is for a program that goes on now [rad]: where the timed speed ends that it has waited for.

        That is up to half a control period from `q`; anywhere else it is `q`.
        """
        generator = self.movement.generator
        if self.beside or self.paused or not isinstance(generator, JointSpeed | ToolSpeed):
            return self.target.q
        try:
            return generator.joints_at_end(self.target.q)
        except MotionFault:
            return self.target.q  # a tool at the end of its reach

    @property
    def path_q(self) -> Joints:
        """Where the arm would be without what displaces the path [rad]."""
        return self.movement.q if self.superposition.active else self.target.q

    @property
    def path_qd(self) -> Joints:
        """The speed of path_q [rad/s]."""
        return self.movement.qd if self.superposition.active else self.target.qd

    @property
    def tcp_offset(self) -> Pose:
        """Flange to TCP. A movement in progress keeps the one it began with."""
        return self.target.reach.tcp_offset

    @tcp_offset.setter
    def tcp_offset(self, offset: Pose) -> None:
        self.target.use_tcp(offset)

    @property
    def target_waypoint(self) -> Pose:
        """Where the movement in progress goes; without one, or when a stop has ended it, where the path is."""
        goal = self.movement.goal
        return goal if goal is not None else self.target.reach.pose(self.path_q)

    @property
    def limiter_share(self) -> float:
        """What the joints' limits leave of a path's speed: less than 1 where it is too much for them.

        1 in streamed movements, whose sender sets the pace: drivers slow down by it (guess).
        """
        return self.movement.share

    @property
    def beside(self) -> bool:
        """The arm is not where its movement is: the path is displaced, or the arm gives way."""
        return self.superposition.active or self.force_control.active

    @property
    def idle(self) -> bool:
        """Nothing moves the arm, and it stands."""
        return self.movement.generator is None and not self.beside and self.target.qd == ZERO6

    @property
    def steady(self) -> bool:
        """As is_steady(): the arm has stood for a while and is not compliant. True also while a movement is paused."""
        standing = self.target.standing_s >= _STEADY_S and (self.movement.generator is None or self.paused)
        return standing and not self.force_control.active

    @property
    def paused(self) -> bool:
        """Held by `pause` or a protective stop until `resume` (the arm may still be slowing down)."""
        return self.movement.paused

    @property
    def braking(self) -> bool:
        """The brakes are bringing the arm to rest."""
        return self.movement.braking

    @property
    def torque(self) -> TorqueCommand | None:
        """The torques that a program commands in this period; None when the arm is to follow its target."""
        generator = self.movement.generator
        return generator.acting if isinstance(generator, DirectTorque) else None

    @property
    def control_mode(self) -> ControlMode:
        """TORQUE while torques are commanded; else TEACH in freedrive, FORCE in force mode, POSITION otherwise."""
        return ControlMode.TORQUE if self.torque is not None else self.force_control.mode

    # settings

    def govern(self, excess: Excess) -> None:
        """Let movements along a path be slowed down: ``excess`` tells how much too fast a step would be."""
        self.movement.excess = excess

    def limit_positions(self, low: Joints, high: Joints) -> None:
        """Where the joints may go from now on [rad]."""
        self._limits.use(low, high)

    def set_position(self, q: Joints) -> None:
        """Put the arm elsewhere. Raises ValueError while it moves, or outside the position limits."""
        position = as_six(q)
        if not self.idle:
            raise ValueError("the arm is moving: stop it before setting its position")
        fault = self._limits.outside(position)
        if fault is not None:
            raise ValueError(fault.text)
        self._stand_at(position)

    def stand_at(self, q: Joints) -> None:
        """The brakes hold the arm here. Targets of an interrupted movement stay where they are."""
        if q != self.target.q and self.idle:
            self._stand_at(q)

    def _stand_at(self, q: Joints) -> None:
        self.target.put(q)
        self.movement.stand(q)

    # one control period

    def advance(self, fraction: float) -> MotionFault | None:
        """One control period with the program's time running at ``fraction`` (0..1).

        Returns the fault that ended the movement in this period; the arm is then already braking.
        """
        fault = self.commands.take_refusal()
        if fault is None:
            if self.movement.over and not self.beside and self.target.rest():
                return None
            try:
                self._step(fraction)
                return None
            except MotionFault as error:
                fault = error
        self._fail(fault)
        self._step(fraction)
        return fault

    def _step(self, fraction: float) -> None:
        """From the movement to the target, each part with what the one before makes of it.

        A movement knows neither what displaces its path nor what pushes the tool, so it comes first; a push moves the
        arm off the displaced path, so force control comes last. Position limits are those of the arm and not of its
        path, so they judge the result. Everything is proposed until then: what raises a MotionFault on the way leaves
        the target where it was, and the arm can brake from there in this very period.
        """
        movement, superposition, force_control = self.movement, self.superposition, self.force_control
        before = start = movement.q
        path = target = movement.propose(fraction)
        if superposition.active:
            start, target = superposition.advance(path)
        if force_control.active:
            alone = movement.generator is None and not superposition.active
            target = force_control.advance(start, target, running=movement.running, alone=alone)
        if not movement.unconditional:
            self._limits.check(target, self.target.q)
        standing = movement.commit()
        if not self.beside:  # perhaps since now: force mode that has come to rest is over
            self.target.advance(target, standing=standing)
            movement.put(target, self.target.qd)
            return
        standing = force_control.commit() and standing
        if superposition.active:
            standing = target == self.target.q  # a conveyor takes a standing path along
        self.target.advance(target, standing=standing)
        movement.put(path, scaled(sub(path, before), 1.0 / self.period_s))

    def _fail(self, fault: MotionFault) -> None:
        """Nothing of what moved the arm can be relied on: every joint brakes for itself, from where it is."""
        self.fault = fault
        self.superposition.lose(fault)
        self.force_control.drop()
        self.movement.fail(fault)
        arm = self.target
        self.movement.brake(self._limits.brake(arm.q, arm.qd), arm.q, arm.qd)

    # stopping

    def pause(self) -> None:
        """Slow to a standstill on the path; `resume` goes on."""
        self.movement.pause()

    def resume(self) -> None:
        """Go on after `pause` or `protective_stop`."""
        self.movement.resume()

    def protective_stop(self) -> None:
        """Stop on the path as quickly as the joints' acceleration limit allows; `resume` goes on."""
        self.movement.protective_stop()

    def safeguard_stop(self) -> None:
        """As a protective stop, or as gently as a pause when transitions are soft."""
        if self.hard_transitions:
            self.protective_stop()
        else:
            self.pause()

    def mode_changed(self) -> None:
        """Reduced mode begins or ends: the speed follows as quickly as the joints can, unless transitions are soft."""
        if self.hard_transitions:
            self.movement.quicken()

    def stop(self, decel: float | None = None) -> None:
        """Stop on the path, the leading joint slowing by ``decel`` [rad/s2], and end the movement."""
        self.commands.stop(decel)

    def program_stopped(self) -> None:
        """The program is over: no more force mode or freedrive, nothing on the path, and the arm comes to rest."""
        self.superposition.program_stopped()
        self.force_control.end()
        self.stop()

    def engage_brakes(self) -> None:
        """Power is removed (stop category 0): brakes bring each joint to rest, and everything is forgotten."""
        arm = self.target
        if arm.qd == ZERO6:
            self.halt()
            return
        self._forget()
        durations = (abs(speed) / _BRAKES_RAD_S2 for speed in arm.qd)
        self.movement.brake(JointStop(arm.q, arm.qd, as_six(durations), StopOrigin.BRAKES), arm.q, arm.qd)

    def halt(self) -> None:
        """Power is gone: stand still at once and forget everything."""
        self._forget()
        self.target.halt()
        self.movement.put(self.target.q, ZERO6)

    def _forget(self) -> None:
        self.movement.forget()
        self.superposition.clear()
        self.force_control.drop()
        self.commands.take_refusal()
