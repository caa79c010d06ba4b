"""Force mode and freedrive: the tool is compliant in selected directions of a frame.

In a compliant direction, the tool behaves like a mass with viscous friction that is pushed by the commanded force plus
the external one; in the others, it follows the movement in progress. In a singular configuration, for example with a
stretched arm, the tool cannot follow every push. It then yields as far as its joints allow, and stops if that would
make it deviate in a direction that is not compliant. Mass and friction are guesses: a real controller's force loop is
not documented.

The loop is in equilibrium when commanded and external force cancel, whatever the mass, friction and gain: pressing on
an object with 10 N results in 10 N.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import exp
from typing import NamedTuple

from emulator.motion.contact import Contact, Response, solve, without
from emulator.motion.faults import MotionFault, near_singularity, off_the_path
from emulator.motion.pacing import within_speed
from emulator.motion.position_limits import PositionLimits
from emulator.motion.reach import Reach
from emulator.motion.target import ArmTarget
from urproto.modes import ControlMode
from urproto.robots.model import Joints
from urproto.robots.pose import Pose, axes_of, pose_add, pose_sub
from urproto.vectors import (
    ZERO6,
    Axes,
    Vector3,
    add,
    all_finite,
    as_six,
    cross,
    dot,
    into6,
    lerp,
    norm3,
    out_of,
    out_of6,
    scaled,
    sub,
    unit,
)

_MASS = 20.0  # kg, and kg m2 for rotation: gives time constants around 0.1 s (guess)
_INERTIA = 1.0
_FRICTION = (200.0, 1800.0)  # N s/m at damping 0, and how much full damping adds (guess)
_TURN_FRICTION = (10.0, 90.0)  # Nm s/rad
_TOOL, _FIXED = 0, 2  # kinds of task frame
_REST = 1e-6  # m/s, rad/s: a slower tool counts as at rest (guess)
_STILL = 1e-9  # m per period: a shorter motion has no direction to align a frame with
_SLACK = 1e-4  # m, rad: permitted deviation of a singular arm in directions that are not compliant (guess)
_FREEDRIVE_LIMITS: Joints = (1.0, 1.0, 1.0, 3.0, 3.0, 3.0)  # m/s, rad/s (guess)
_SUDDEN = 5.0  # times a joint's acceleration limit: only a singular arm or a hard contact demands more (guess)
_MOTION = 3  # kind of task frame
_STIFF = (False,) * 6
_BRAKE_DAMPING = 0.25  # of force mode and freedrive when they end: at rest within 0.5 s (guess)


@dataclass(frozen=True, slots=True)
class Task:
    """A compliance task: ``frame`` in the base frame, six flags, wrench [N, Nm] and speed limits in that frame.

    ``kind`` as in force_mode: 1 turns y towards the frame's origin, 2 uses the frame as it is, 3 turns x along the
    tool's velocity and complies only once the tool has moved (user manual, "Motion"). 0 uses the tool's own axes,
    whatever the frame.
    """

    frame: Pose
    compliant: tuple[bool, ...]
    wrench: Joints
    kind: int
    limits: Joints
    freedrive: bool = False

    @classmethod
    def force(
        cls, frame: Pose, selection: Sequence[float], wrench: Sequence[float], kind: int, limits: Sequence[float]
    ) -> "Task":
        """Create a task from force_mode's arguments. Raises ValueError for a type other than 1, 2, 3."""
        if kind not in (1, 2, 3):
            raise ValueError(f"force_mode: type must be 1, 2 or 3, not {kind}")
        return cls(frame, tuple(flag != 0 for flag in selection), as_six(wrench), kind, as_six(limits))

    @classmethod
    def screw(cls, force_N: float, speed_m_s: float) -> "Task":
        """Screw driving: along the tool's z axis."""
        along_z = (False, False, True, False, False, False)
        return cls(ZERO6, along_z, (0.0, 0.0, force_N, 0.0, 0.0, 0.0), _TOOL, (0.0, 0.0, speed_m_s, 0.0, 0.0, 0.0))

    @classmethod
    def free(cls, frame: Pose | None, free_axes: Sequence[float]) -> "Task":
        """Freedrive: only external forces count. None stands for the tool's own frame."""
        free, kind = tuple(flag != 0 for flag in free_axes), _TOOL if frame is None else _FIXED
        return cls(frame or ZERO6, free, ZERO6, kind, _FREEDRIVE_LIMITS, freedrive=True)


class ExternalLoad(NamedTuple):
    """External wrench on the tool at its TCP, base frame [N, Nm]; it includes the present forces of ``contacts``."""

    wrench: Joints = ZERO6
    contacts: tuple[Contact, ...] = ()


@dataclass(frozen=True, slots=True)
class _Loop:
    """The force loop in one period: friction and the factor by which it reduces a speed, axis by axis; gain."""

    dt: float
    friction: Joints
    decay: Joints
    gain: float

    @staticmethod
    @lru_cache(maxsize=8)  # nearly every period has the values of the previous one
    def of(dt: float, damping: float, gain: float) -> "_Loop":
        """Loop for a period of dt seconds; ``damping`` from 0 to 1."""
        linear, turning = _FRICTION[0] + _FRICTION[1] * damping, _TURN_FRICTION[0] + _TURN_FRICTION[1] * damping
        moving, spinning = exp(-dt * linear / _MASS), exp(-dt * turning / _INERTIA)
        return _Loop(dt, (linear,) * 3 + (turning,) * 3, (moving,) * 3 + (spinning,) * 3, gain)


class Compliance:
    """Turns movements of the nominal arm into movements of the compliant one."""

    def __init__(self, reach: Reach, period_s: float, q: Joints, moved: Joints, task: Task) -> None:
        """``moved``: the joints' displacement in the last period [rad]."""
        self.reach = reach
        self._period = period_s
        self.task = task
        self.released = False
        self._pose = reach.pose(q)
        self._speed = ZERO6  # of the compliant motion alone, in the task frame and the program's time
        self._was_compliant: tuple[bool, ...] = (False,) * 6  # directions of the last step
        self._last_step = moved
        self._heading: Vector3 | None = None  # x axis of a task frame of kind 3
        self._frame_axes = axes_of(task.frame)
        self._next = (self._pose, ZERO6, ZERO6)
        self._path = (q, self._pose)  # the nominal arm's last configuration, as joints and as a pose

    def standing(self) -> bool:
        """Whether the compliant motion is at rest."""
        return self._speed == ZERO6

    def halt(self) -> None:
        """Discard the last step: stay in place, and lose the speed in compliant directions."""
        self._next = (self._pose, ZERO6, ZERO6)

    def hold(self) -> None:
        """Propose to stay in place for a period in which the program's time stands still."""
        self._next = (self._pose, self._speed, ZERO6)

    def slow_down(self, share: float) -> None:
        """Continue at this share of the speed in compliant directions."""
        self._speed = scaled(self._speed, share)

    def comply(self, task: Task) -> None:
        """Start another task, also after a release."""
        if task.kind != self.task.kind:
            self._heading = None
        self.task, self.released = task, False
        self._frame_axes = axes_of(task.frame)

    def release(self) -> None:
        """End compliance; the remaining speed decays."""
        self.released = True
        kind = _TOOL if self.task.kind == _TOOL else _FIXED
        self.task = Task(self.task.frame, (False,) * 6, ZERO6, kind, self.task.limits)

    def check(self, actual_q: Joints) -> None:
        """Raise MotionFault if the arm deviates more than force mode's limits of the stiff axes allow.

        ``actual_q``: where the arm actually is after the last step.
        """
        task = self.task
        if task.freedrive or task.kind == _TOOL or self.released:
            return
        axes, limits = self._axes(ZERO6), zip(self._compliant, task.limits, strict=True)
        off = into6(axes, pose_sub(self.reach.pose(actual_q), self._pose))
        for i, (deviation, (gives_way, limit)) in enumerate(zip(off, limits, strict=True)):
            if not gives_way and abs(deviation) > abs(limit) + _SLACK:
                raise off_the_path(i, abs(deviation), abs(limit))

    def step(
        self, dt: float, q: Joints, nominal: tuple[Joints, Joints], external: ExternalLoad, damping: float, gain: float
    ) -> Joints:
        """Propose the joints after a period, while the nominal arm moves from the first to the second of ``nominal``.

        ``dt``: how much of the program's time passes in this period [s]. Raises MotionFault if the arm cannot follow.
        """
        before, after = nominal
        shift = ZERO6 if before == after else self._shift(before, after)
        axes = self._axes(shift)
        wanted = into6(axes, shift)
        compliant = self._compliant
        loop, given = _Loop.of(dt, damping, gain), scaled(wanted, 1.0 / dt)
        own = self._accelerated(loop, self._continuous_speed(given), axes, external, given)
        a, b, c, d, e, f = [0.0 if gives_way else way for gives_way, way in zip(compliant, wanted, strict=True)]
        moved = lerp((a, b, c, d, e, f), own, dt)
        self._next = (self._pose, own, ZERO6)
        if moved == ZERO6:
            return q
        pose = pose_add(out_of6(axes, moved), self._pose)
        target = self._exact_joints(pose, q, alone=before == after, touching=bool(external.contacts))
        if target is None:
            target, pose, own = self._yield_at_singularity(dt, axes, (pose, own), q, touching=bool(external.contacts))
        self._next = (pose, own, sub(target, q))
        return target

    def _shift(self, before: Joints, after: Joints) -> Joints:
        """Displacement of the nominal arm's tool, in the base frame."""
        known, pose = self._path
        start = pose if before == known else self.reach.pose(before)
        self._path = (after, self.reach.pose(after))
        return pose_sub(self._path[1], start)

    def _exact_joints(self, pose: Pose, q: Joints, *, alone: bool, touching: bool) -> Joints | None:
        """Joints for this pose. Without a simultaneous movement: None if they cannot get there, or only with a jerk."""
        model, dt = self.reach.model, self._period
        try:
            target = self.reach.joints(pose, q)
            step = sub(target, q)
            if not within_speed(step, model.qd_max, dt):
                raise near_singularity()
        except MotionFault:
            if alone:
                return None
            raise
        hardest = self._peak_change(step)
        if alone:
            return target if hardest <= dt * dt else None
        if hardest > _SUDDEN * dt * dt and not touching:
            raise near_singularity()
        return target

    def _peak_change(self, step: Joints) -> float:
        """Largest change of a joint's speed, as a fraction of its acceleration limit, times dt squared."""
        changes = zip(step, self._last_step, self.reach.model.qdd_max, strict=True)
        return max([abs(now - last) / most for now, last, most in changes])

    def _yield_at_singularity(
        self, dt: float, axes: Axes, wanted: tuple[Pose, Joints], q: Joints, *, touching: bool
    ) -> tuple[Joints, Pose, Joints]:
        """Move towards the pose as far as a singular arm can; compliant directions lose the rest, and its speed."""
        pose, own = wanted
        step = self.reach.step_towards(pose, q)
        sudden = self._peak_change(step) / (_SUDDEN * self._period**2)
        if sudden > 1.0 and not touching:
            step = lerp(self._last_step, sub(step, self._last_step), 1.0 / sudden)
        reach_of_period = scaled(self.reach.model.qd_max, self._period)
        excess = max(abs(move) / most for move, most in zip(step, reach_of_period, strict=True))
        target = lerp(q, step, 1.0 / max(1.0, excess))
        missed = into6(axes, pose_sub(self.reach.pose(target), pose))
        free = [compliant or speed != 0.0 for compliant, speed in zip(self._compliant, own, strict=True)]
        if any(abs(miss) > _SLACK for miss, may in zip(missed, free, strict=True) if not may):
            raise near_singularity()
        lost = as_six(miss if may else 0.0 for miss, may in zip(missed, free, strict=True))
        return target, pose_add(out_of6(axes, lost), pose), as_six(map(_slowed, own, lerp(own, lost, 1.0 / dt)))

    def commit(self) -> None:
        """The last step has been executed."""
        self._pose, self._speed, self._last_step = self._next
        self._was_compliant = self._compliant

    @property
    def _compliant(self) -> tuple[bool, ...]:
        """The directions that are compliant in this period. A frame of kind 3 has none before the first motion."""
        waiting = self.task.kind == _MOTION and self._heading is None
        return _STIFF if waiting else self.task.compliant

    def _continuous_speed(self, wanted: Joints) -> Joints:
        """Compliant speed, corrected to keep the tool's speed continuous when a direction becomes stiff or compliant.

        ``wanted``: speed of the movement in progress, task frame.
        """
        if self._compliant == self._was_compliant:
            return self._speed
        changes = (now - before for now, before in zip(self._compliant, self._was_compliant, strict=True))
        return as_six(own + change * speed for own, change, speed in zip(self._speed, changes, wanted, strict=True))

    def _accelerated(self, loop: _Loop, before: Joints, axes: Axes, external: ExternalLoad, given: Joints) -> Joints:
        """Compliant speed after the period, given mass, friction, contacts and the task's speed limits.

        ``before``: the compliant speed now, ``given``: speed of the movement in progress, both in the task frame.
        """
        compliant = self._compliant
        net = self.task.wrench
        if external.wrench != ZERO6:
            net = add(net, into6(axes, external.wrench))
        free = self._free_speed(loop, before, net)
        if not external.contacts or compliant == _STIFF:
            return free
        inert = as_six(c / (1.0 - decay) for c, decay in zip(loop.friction, loop.decay, strict=True))
        kept = as_six(r * decay * speed for r, decay, speed in zip(inert, loop.decay, before, strict=True))
        others = as_six(0.0 if compliant[i] else given[i] + free[i] for i in range(6))
        bounds = as_six(max(abs(self.task.limits[i]), abs(before[i]) * loop.decay[i]) for i in range(6))
        response = Response(compliant, inert, kept, others, bounds, loop.gain)
        rest = lerp(net, into6(axes, without(ZERO6, external.contacts)), 1.0)
        alone = self._free_speed(loop, before, rest)
        start = as_six(alone[i] if compliant[i] else others[i] for i in range(6))
        speed = solve(loop.dt, axes, response, rest, external.contacts, start)
        return as_six(speed[i] if compliant[i] else free[i] for i in range(6))

    def _free_speed(self, loop: _Loop, before: Joints, net: Joints) -> Joints:
        """Exact response of mass and friction to a constant force, bounded by the task's speed limits."""
        speeds = []
        directions = zip(self._compliant, self.task.limits, net, before, loop.friction, loop.decay, strict=True)
        for gives_way, limit, force, speed, friction, decay in directions:
            bound = abs(limit)
            final = max(-bound, min(bound, loop.gain * force / friction)) if gives_way else 0.0
            now = final + (speed - final) * decay
            speeds.append(0.0 if abs(now) < _REST and abs(final) < _REST else now)
        x, y, z, rx, ry, rz = speeds
        return (x, y, z, rx, ry, rz)

    def _axes(self, shift: Joints) -> Axes:
        """The task frame's axes in the base frame."""
        x, y, z = axes_of(self._pose) if self.task.kind == _TOOL else self._frame_axes
        if self.task.kind == 1:
            origin, tool = self.task.frame, self._pose
            y = unit((origin[0] - tool[0], origin[1] - tool[1], origin[2] - tool[2]), y)
            x = unit(cross(y, z), x)
            return x, y, cross(x, y)
        if self.task.kind == _MOTION:
            along = out_of((x, y, z), (dot(shift, x), dot(shift, y), 0.0))
            if norm3(*along) > _STILL:
                self._heading = unit(along, self._heading or x)
            x = self._heading or x
            return x, cross(z, x), z
        return x, y, z


def _slowed(speed: float, left: float) -> float:
    """Reduce a speed without increasing or reversing it: otherwise an arm that corrects itself would never stop."""
    return max(0.0, min(speed, left)) if speed >= 0.0 else min(0.0, max(speed, left))


class ForceControl:
    """Force mode, screw driving and freedrive, one at a time: the arm is compliant in addition to other movements.

    ``damping``, ``gain_scaling``: force_mode_set_damping and force_mode_set_gain_scaling. ``contacts``: those between
    tool and world, whose forces are part of the external wrench.
    """

    def __init__(self, target: ArmTarget, limits: PositionLimits) -> None:
        self.damping = 0.005  # default of the Script Manual
        self.gain_scaling = 1.0
        self.contacts: tuple[Contact, ...] = ()
        self._external_wrench: Joints = ZERO6
        self._actual_q: Joints | None = None  # None: at its target
        self._target, self._limits = target, limits
        self._compliance: Compliance | None = None

    @property
    def active(self) -> bool:
        """Whether the arm is compliant, or has not come to rest since."""
        return self._compliance is not None

    @property
    def released(self) -> bool:
        """Whether compliance has ended but its displacement from the path remains."""
        return self._compliance is not None and self._compliance.released

    @property
    def mode(self) -> ControlMode:
        """TEACH in freedrive, FORCE in force mode and screw driving, POSITION otherwise."""
        if self._compliance is None or self._compliance.released:
            return ControlMode.POSITION
        return ControlMode.TEACH if self._compliance.task.freedrive else ControlMode.FORCE

    @property
    def frame(self) -> Pose:
        """The task frame in the base frame; zero without force mode."""
        compliance = self._compliance
        return compliance.task.frame if compliance is not None and self.mode is ControlMode.FORCE else ZERO6

    def set_external_wrench(self, external_wrench: Joints, actual_q: Joints | None = None) -> None:
        """Set the external wrench at the TCP, base frame [N, Nm], and where the arm is if not at its target [rad]."""
        self._external_wrench, self._actual_q = external_wrench, actual_q

    # commands of a program

    def force_mode(
        self,
        task_frame: Sequence[float],
        selection: Sequence[float],
        wrench: Sequence[float],
        type: int,  # noqa: A002 - the name of the script function's parameter
        limits: Sequence[float],
    ) -> None:
        """Comply in the selected directions of task_frame (in the base frame), during any other movement.

        ``limits`` are speeds [m/s, rad/s] in compliant directions. Raises ValueError for an unknown type.
        """
        if not all_finite((*task_frame, *selection, *wrench, *limits)):
            raise ValueError("force_mode: all numbers must be finite")
        self._comply(Task.force(as_six(task_frame), selection, wrench, type, limits))

    def screw_driving(self, force_N: float, speed_m_s: float) -> None:
        """Push along the tool's own z axis, no faster than ``speed_m_s``, during any other movement."""
        self._comply(Task.screw(force_N, speed_m_s))

    def freedrive(self, free_axes: Sequence[float], feature: Pose | None) -> None:
        """Let the external wrench move the tool along the free axes of a frame given in the base frame.

        None stands for the tool's own frame. Movements continue meanwhile: `MotionCommands.freedrive` stops them.
        """
        self._comply(Task.free(None if feature is None else as_six(feature), free_axes))

    def end(self) -> None:
        """End compliance; the arm comes to rest where it is."""
        if self._compliance is not None:
            self._compliance.release()

    def slow_down(self, share: float) -> None:
        if self._compliance is not None:
            self._compliance.slow_down(share)

    def drop(self) -> None:
        """End compliance immediately; the arm counts as being on its path."""
        self._compliance = None

    def _comply(self, task: Task) -> None:
        if self._compliance is None:
            arm = self._target
            self._compliance = Compliance(arm.reach, arm.period_s, arm.q, scaled(arm.qd, arm.period_s), task)
        else:
            self._compliance.comply(task)

    # one control period

    def advance(self, before: Joints, after: Joints, *, pace: float, pushed: bool, alone: bool) -> Joints:
        """Propose the compliant arm's joints, while the path advances from ``before`` to ``after``.

        ``pace``: periods of the program's time in this control period. ``pushed``: whether anything pushes the arm; not
        while the movement is being stopped. ``alone``: nothing else moves the arm, so compliance that has ended and
        come to rest is removed. Raises MotionFault.
        """
        compliance, here = self._compliance, self._target.q
        if compliance is None:
            return after
        if alone and compliance.released and compliance.standing():
            self._compliance = None
            return here
        if self._actual_q is not None and self._actual_q != here:
            compliance.check(self._actual_q)
        if pace <= 0.0 and after == before:
            compliance.hold()
            return here
        try:
            target = self._compliant_joints(compliance, (before, after), pace, pushed=pushed)
            self._limits.check(target, here)
        except MotionFault:
            if after != before:
                raise
            # Only a push demands this: the end of the workspace acts like a wall for a hand, and is not a fault.
            compliance.halt()
            return here
        return target

    def commit(self) -> bool:
        """The last proposal has been executed. Returns whether the compliant motion is at rest."""
        if self._compliance is None:
            return True
        self._compliance.commit()
        return self._compliance.standing()

    def _compliant_joints(
        self, compliance: Compliance, path: tuple[Joints, Joints], pace: float, *, pushed: bool
    ) -> Joints:
        period_s, q = self._target.period_s, self._target.q
        if not pushed or pace <= 0.0:
            damping = max(self.damping, _BRAKE_DAMPING)
            return compliance.step(period_s, q, path, ExternalLoad(ZERO6, ()), damping, 0.0)
        load = ExternalLoad(self._external_wrench, self.contacts)
        damping = max(self.damping, _BRAKE_DAMPING) if compliance.released else self.damping
        return compliance.step(pace * period_s, q, path, load, damping, self.gain_scaling)
