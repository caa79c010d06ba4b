"""The motion generator of one arm: it moves the target from one control period to the next."""

from emulator.motion.commands import MotionCommands
from emulator.motion.compliance import ForceControl
from emulator.motion.faults import MotionFault
from emulator.motion.movement import ActiveMovement
from emulator.motion.pacing import Excess
from emulator.motion.position_limits import PositionLimits
from emulator.motion.program_time import ProgramTime
from emulator.motion.speed import JointSpeed, ToolSpeed
from emulator.motion.stops import JointStop, StopOrigin
from emulator.motion.superposition import Superposition
from emulator.motion.target import ArmTarget
from emulator.motion.torque import DirectTorque
from emulator.robot.drives import TorqueCommand
from urproto.modes import ControlMode
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6, as_six, scaled_sub

_STEADY_S = 0.5  # Script Manual, is_steady
# User manuals of UR5 and UR3 (appendix A), category 0 stops from 183 degrees/s, stretched out with full payload: the
# base joints brake by 16 and 28 rad/s2 on average. The same value for all arms, joints and payloads is a guess.
_BRAKES_RAD_S2 = 20.0


class Motion:
    """The target of one arm, and everything that changes it. Angles rad, poses of the TCP in the base frame.

    ``commands``: the commands of programs. ``superposition``: path offsets, conveyors and frames that displace the
    path. ``force_control``: force mode and freedrive, which add compliance. ``movement``: the movement in progress.
    ``target``: the resulting target of the arm.
    """

    def __init__(self, model: RobotModel, period_s: float, q: Joints) -> None:
        self.model = model
        self.period_s = period_s
        self.hard_transitions = True  # set_safety_mode_transition_hardness; the value before it is called is a guess
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
        """Target speeds [rad/s]: displacement in the last period over the period, exactly 0 at rest."""
        return self.target.qd

    @property
    def qdd(self) -> Joints:
        """Target accelerations [rad/s2]."""
        return self.target.qdd

    @property
    def program_q(self) -> Joints:
        """Joint angles for a program that continues now [rad]: those at the end of the timed speed it waited for.

        They are up to half a control period away from `q`; without a timed speed, they are `q`.
        """
        generator = self.movement.generator
        if self.deviating or self.time.pace <= 0.0 or not isinstance(generator, JointSpeed | ToolSpeed):
            return self.target.q
        try:
            return generator.joints_at_end(self.target.q)
        except MotionFault:
            return self.target.q  # the tool is at the end of its reach

    @property
    def path_q(self) -> Joints:
        """Joint angles on the path itself, without any displacement [rad]."""
        return self.movement.q if self.superposition.active else self.target.q

    @property
    def path_qd(self) -> Joints:
        """The speed of path_q [rad/s]."""
        return self.movement.qd if self.superposition.active else self.target.qd

    @property
    def tcp_offset(self) -> Pose:
        """Flange to TCP. A movement in progress keeps the TCP it started with."""
        return self.target.reach.tcp_offset

    @tcp_offset.setter
    def tcp_offset(self, offset: Pose) -> None:
        self.target.use_tcp(offset)

    @property
    def target_waypoint(self) -> Pose:
        """Target of the movement in progress; without one, or after a stop ended it, the present pose on the path."""
        goal = self.movement.goal
        return goal if goal is not None else self.target.reach.pose(self.path_q)

    @property
    def limiter_share(self) -> float:
        """Fraction of a path's speed that the joints' limits permit: less than 1 where a path is too fast.

        1 in streamed movements, whose sender sets the pace: drivers slow down by this value (guess).
        """
        return self.movement.share

    @property
    def deviating(self) -> bool:
        """Whether the arm deviates from its movement: the path is displaced, or the arm is compliant."""
        return self.superposition.active or self.force_control.active

    @property
    def idle(self) -> bool:
        """Whether nothing moves the arm and it stands still."""
        return self.movement.generator is None and not self.deviating and self.target.qd == ZERO6

    @property
    def steady(self) -> bool:
        """is_steady(): the arm has stood still for a while and is not compliant; a movement may be paused."""
        standing = self.target.standing_s >= _STEADY_S and (self.movement.generator is None or self.paused)
        return standing and not self.force_control.active

    @property
    def time(self) -> ProgramTime:
        return self.movement.time

    @property
    def paused(self) -> bool:
        """Whether `pause` or a protective stop holds the arm until `resume` (it may still be slowing down)."""
        return self.movement.paused

    @property
    def slowing(self) -> bool:
        """Whether the program's time still passes, although a pause or protective stop slows it down with the arm."""
        return self.movement.slowing

    @property
    def braking(self) -> bool:
        return self.movement.braking

    @property
    def torque(self) -> TorqueCommand | None:
        """Torques commanded by a program in this period; None while the arm follows its target."""
        generator = self.movement.generator
        return generator.acting if isinstance(generator, DirectTorque) else None

    @property
    def control_mode(self) -> ControlMode:
        """TORQUE while torques are commanded; else TEACH in freedrive, FORCE in force mode, POSITION otherwise."""
        return ControlMode.TORQUE if self.torque is not None else self.force_control.mode

    # settings

    def govern(self, excess: Excess) -> None:
        """Let a limit slow down movements along a path: ``excess`` returns by how much a step would exceed it."""
        self.movement.excess = excess

    def limit_positions(self, low: Joints, high: Joints) -> None:
        """Set the position limits of the joints [rad]."""
        self._limits.use(low, high)

    def set_position(self, q: Joints) -> None:
        """Set the arm's joint angles. Raises ValueError while it moves, or outside the position limits."""
        position = as_six(q)
        if not self.idle:
            raise ValueError("the arm is moving: stop it before setting its position")
        fault = self._limits.outside(position)
        if fault is not None:
            raise ValueError(fault.text)
        self._stand_at(position)

    def stand_at(self, q: Joints) -> None:
        """Set the target to where the brakes hold the arm. Targets of an interrupted movement stay as they are."""
        if q != self.target.q and self.idle:
            self._stand_at(q)

    def _stand_at(self, q: Joints) -> None:
        self.target.put(q)
        self.movement.stand(q)

    # one control period

    def advance(self, fraction: float) -> MotionFault | None:
        """Advance one control period, with the speed slider at ``fraction`` (0..1).

        Returns the fault that ended the movement in this period; the arm is then already braking.
        """
        self.movement.start_period(self.target.qd, self.target.qdd)
        fault = self.commands.take_refusal()
        if fault is None:
            if self.movement.over and not self.deviating and self.target.rest():
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
        """Calculate the next target: each stage works on the result of the previous one.

        A movement does not depend on what displaces its path or pushes the tool, so it comes first. A push moves the
        arm off the displaced path, so force control comes last. Position limits apply to the arm and not to its path,
        so they are checked on the result. Until then, everything is only proposed: a MotionFault of any stage leaves
        the target where it was, and the arm can brake from there within the same period.
        """
        movement, superposition, force_control = self.movement, self.superposition, self.force_control
        before = start = movement.q
        path = target = movement.propose(fraction)
        if superposition.active:
            start, target = superposition.advance(path)
        if force_control.active:
            alone = movement.generator is None and not superposition.active
            pushed = not movement.stopping
            target = force_control.advance(start, target, pace=self.time.pace, pushed=pushed, alone=alone)
        if not movement.unconditional:
            self._limits.check(target, self.target.q)
        standing = movement.commit()
        if not self.deviating:  # possibly only since this period: force mode that has come to rest is over
            self.target.advance(target, standing=standing)
            movement.put(target, self.target.qd)
            return
        standing = force_control.commit() and standing
        if superposition.active:
            standing = target == self.target.q  # a conveyor moves a standing path along
        self.target.advance(target, standing=standing)
        movement.put(path, scaled_sub(path, before, 1.0 / self.period_s))

    def _fail(self, fault: MotionFault) -> None:
        """End everything that moved the arm, because none of it is reliable now: each joint brakes on its own."""
        self.fault = fault
        self.superposition.lose(fault)
        self.force_control.drop()
        self.movement.fail(fault)
        arm = self.target
        self.movement.brake(self._limits.brake(arm.q, arm.qd), arm.q, arm.qd)

    # stopping

    def pause(self) -> None:
        """Slow down to a standstill on the path, until `resume`."""
        self.movement.pause()

    def resume(self) -> None:
        """Continue after `pause` or `protective_stop`."""
        self.movement.resume()

    def protective_stop(self) -> None:
        """Stop on the path as quickly as the joints' acceleration limit allows, until `resume`."""
        self.movement.protective_stop()

    def safeguard_stop(self) -> None:
        """Stop like a protective stop, or as gently as a pause if transitions are soft."""
        if self.hard_transitions:
            self.protective_stop()
        else:
            self.pause()

    def mode_changed(self) -> None:
        """Reduced mode begins or ends: unless transitions are soft, the speed adapts as quickly as the joints can."""
        if self.hard_transitions:
            self.movement.use_fastest_ramp()

    def program_stopped(self) -> None:
        """The program has ended: end force mode, freedrive and path displacements, and bring the arm to rest."""
        self.superposition.program_stopped()
        self.force_control.end()
        self.commands.stop()

    def engage_brakes(self) -> None:
        """Power is removed (stop category 0): the brakes bring each joint to rest, and all movements are discarded."""
        arm = self.target
        if arm.qd == ZERO6:
            self.halt()
            return
        self._discard_all()
        durations = (abs(speed) / _BRAKES_RAD_S2 for speed in arm.qd)
        self.movement.brake(JointStop(arm.q, arm.qd, as_six(durations), StopOrigin.BRAKES), arm.q, arm.qd)

    def halt(self) -> None:
        """Power is off: stand still immediately and discard all movements."""
        self._discard_all()
        self.target.halt()
        self.movement.put(self.target.q, ZERO6)

    def _discard_all(self) -> None:
        self.movement.discard()
        self.superposition.clear()
        self.force_control.drop()
        self.commands.take_refusal()
