"""Movements of the arm. A call takes as long as its movement, or as the part of it before a blend."""

from collections.abc import Sequence

from emulator.builtins.geometry import arm_pose, joints_for, nearest_angle, numbers, pose_for, within_range
from emulator.builtins.host import Frames, ProgramHost
from emulator.robot.drives import COULOMB_SHARE, VISCOUS_SHARE, TorqueCommand
from emulator.snapshot import plausible
from urproto.vectors import ZERO6, Vector6, as_six
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Any_, Bool, Int, Joints, Num, Pose, PoseOrJoints, Struct, Value

LIBRARY = Library("motion", host=True, physical=True)

_MIN_VALUE = 1e-100  # a smaller number counts as 0, because its square underflows to 0
_TOOL_SPEED_M_S = 3.0  # guess: the top tool speed that clients accept
_TOOL_ACCELERATION_M_S2 = 15.0  # guess
_ORIGIN = ZERO6


@LIBRARY.builtin()
def movej(host: ProgramHost, q: PoseOrJoints, a: Num = 1.4, v: Num = 1.05, t: Num = 0, r: Num = 0) -> Frames[None]:
    """Move linearly in joint space to joint angles [rad], or to a TCP pose by inverse kinematics.

    `a` [rad/s2] and `v` [rad/s] of the leading joint, or the time `t` [s] instead; with a blend
    radius `r` [m], the call returns where the blend into the next movement begins. A pose out of
    reach ends the program with an error.
    """
    goal = joints_for(host, q)
    _check_profile("movej", a, v, t, r)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movej(goal, a=a, v=v, t=t, r=r))


@LIBRARY.builtin()
def movel(host: ProgramHost, pose: PoseOrJoints, a: Num = 1.2, v: Num = 0.25, t: Num = 0, r: Num = 0) -> Frames[None]:
    """Move the tool on a straight line to a TCP pose, or to the pose of joint angles.

    `a` [m/s2], `v` [m/s], or the time `t` [s]; blend radius `r` [m]. A pose out of reach causes a
    protective stop.
    """
    goal = pose_for(host, pose)
    _check_profile("movel", a, v, t, r)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movel(goal, a=a, v=v, t=t, r=r))


@LIBRARY.builtin()
def movep(host: ProgramHost, pose: PoseOrJoints, a: Num = 1.2, v: Num = 0.25, r: Num = 0) -> Frames[None]:
    """Process move: constant tool speed `v` [m/s] on straight lines with circular blends of radius `r` [m]."""
    goal = pose_for(host, pose)
    _check_profile("movep", a, v, 0, r)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movep(goal, a=a, v=v, r=r))


@LIBRARY.builtin()
def movec(
    host: ProgramHost,
    pose_via: PoseOrJoints,
    pose_to: PoseOrJoints,
    a: Num = 1.2,
    v: Num = 0.25,
    r: Num = 0,
    mode: Int = 0,
) -> Frames[None]:
    """Move the tool on the arc through `pose_via` to `pose_to`.

    `a` [m/s2], `v` [m/s], blend radius `r` [m]. `mode` 0: the orientation is interpolated linearly to
    that of `pose_to`; 1: it stays constant relative to the arc's tangent.
    """
    via, to = pose_for(host, pose_via), pose_for(host, pose_to)
    if mode not in (0, 1):
        raise RuntimeFault(f"movec: mode must be 0 (unconstrained) or 1 (fixed orientation), not {mode}")
    _check_profile("movec", a, v, 0, r)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movec(via, to, a=a, v=v, r=r, mode=mode))


@LIBRARY.builtin(
    cb3=None, e="5.19", status="partial", note="a trapezoidal profile with a and v as fractions of the limits"
)
def optimovej(host: ProgramHost, goal: Any_, a: Num = 0.3, v: Num = 0.3, r: Num = 0) -> Frames[None]:
    """Joint move with `a` and `v` as fractions (0 to 1) of the arm's limits.

    `goal`: joint angles, a pose, struct(pose=..., frame=...) for a pose in a frame of the world model, or the name
    of a frame, to which the TCP moves.
    """
    q = joints_for(host, _goal(host, "optimovej", goal))
    _check_fractions("optimovej", a, v)
    _check_not_negative("optimovej", r=r)
    model = host.machine.model
    speed, acceleration = v * min(model.qd_max), a * min(model.qdd_max)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movej(q, a=acceleration, v=speed, t=0, r=r))


@LIBRARY.builtin(
    cb3=None, e="5.19", status="partial", note="a trapezoidal profile with a and v as fractions of the limits"
)
def optimovel(host: ProgramHost, goal: Any_, a: Num = 0.3, v: Num = 0.3, r: Num = 0) -> Frames[None]:
    """Straight tool move with `a` and `v` as fractions (0 to 1) of the arm's limits; `goal` as in optimovej()."""
    pose = pose_for(host, _goal(host, "optimovel", goal))
    _check_fractions("optimovel", a, v)
    _check_not_negative("optimovel", r=r)
    speed, acceleration = v * _TOOL_SPEED_M_S, a * _TOOL_ACCELERATION_M_S2
    with host.motion_control() as motion:
        yield from host.until_ready(motion.movel(pose, a=acceleration, v=speed, t=0, r=r))


def _goal(host: ProgramHost, name: str, goal: Value) -> list[float]:
    """Joint angles or a pose, from any goal that optimovej and optimovel accept."""
    if isinstance(goal, str):
        return _in_frame(host, _ORIGIN, goal)
    if isinstance(goal, Struct) and set(goal.members) == {"pose", "frame"}:
        pose, frame = goal.members["pose"], goal.members["frame"]
        if isinstance(pose, Pose) and isinstance(frame, str):
            return _in_frame(host, as_six(numbers(pose, 6, f"{name}: pose")), frame)
    if isinstance(goal, list):
        return list(numbers(goal, 6, f"{name}: goal")) if not isinstance(goal, Pose) else goal
    raise RuntimeFault(f"{name}: goal must be joint angles, a pose, struct(pose=p[...], frame=name), or a frame's name")


def _in_frame(host: ProgramHost, pose: Vector6, frame: str) -> Pose:
    """A pose given in a frame, in base coordinates; for a frame that a tracked one carries, as when tracking began."""
    world, tracked = host.machine.world_model, host.motion.superposition.tracked_frame
    with within_range():
        there = world.convert(pose, frame, "base", arm_pose(host))
        if tracked is not None and world.carries(tracked.name, frame):
            there = tracked.at_the_start(there)
    return Pose(there)


@LIBRARY.builtin()
def servoj(
    host: ProgramHost,
    q: Joints,
    a: Num = 0,
    v: Num = 0,
    t: Num | None = None,
    lookahead_time: Num = 0.1,
    gain: Num = 300,
) -> Frames[None]:
    """Servo to joint angles [rad] that a program updates continuously; blocks for `t` [s], by default one period.

    With `t` = 0, it does not block: a loop without a wait then causes a protective stop.

    `lookahead_time` [s] smooths, `gain` sets the stiffness; `a` and `v` are ignored. End with stopj().
    """
    _check_not_negative("servoj", t=0 if t is None else t)
    with host.motion_control() as motion:
        duration = host.period_s if t is None else t
        yield from host.until_ready(motion.servoj(as_six(q), t=duration, lookahead_time=lookahead_time, gain=gain))


@LIBRARY.builtin()
def servoc(host: ProgramHost, pose: PoseOrJoints, a: Num = 1.2, v: Num = 0.25, r: Num = 0) -> Frames[None]:
    """Servo the tool along circular blends towards a TCP pose; `a` [m/s2], `v` [m/s], `r` [m]."""
    goal = pose_for(host, pose)
    _check_profile("servoc", a, v, 0, r)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.servoc(goal, a=a, v=v, r=r))


@LIBRARY.builtin(aliases={"t": ("t", "t_min")})
def speedj(host: ProgramHost, qd: Joints, a: Num = 1.4, t: Num | None = None) -> Frames[None]:
    """Accelerate the joints with `a` [rad/s2] to the speeds `qd` [rad/s] and hold them.

    Returns after `t` [s]; without `t`, when the speed is reached. If that is at once, a loop without a wait causes a
    protective stop.
    """
    _check_not_negative("speedj", a=a)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.speedj(as_six(qd), a=a, t=t))


@LIBRARY.builtin(aliases={"t": ("t", "t_min")})
def speedl(
    host: ProgramHost, xd: PoseOrJoints, a: Num = 1.2, t: Num | None = None, aRot: Num | None = None
) -> Frames[None]:
    """Accelerate the tool to the velocity `xd` (base frame, m/s and rad/s) and hold it.

    `a` [m/s2] and `aRot` [rad/s2], which is `a` when omitted. Returns as speedj() does.
    """
    turn_a = a if aRot is None else aRot
    _check_not_negative("speedl", a=a, aRot=turn_a)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.speedl(as_six(xd), a=a, a_rot=turn_a, t=t))


@LIBRARY.builtin()
def stopj(host: ProgramHost, a: Num = 2.0) -> Frames[None]:
    """Bring the joints to rest with `a` [rad/s2]."""
    _check_positive("stopj", a=a)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.stopj(a))


@LIBRARY.builtin()
def stopl(host: ProgramHost, a: Num = 2.0, aRot: Num | None = None) -> Frames[None]:
    """Bring the tool to rest along its path with `a` [m/s2] and `aRot` [rad/s2]."""
    _check_positive("stopl", a=a)
    with host.motion_control() as motion:
        yield from host.until_ready(motion.stopl(a, a if aRot is None else aRot))


@LIBRARY.builtin(
    cb3=None,
    e="5.23",
    x="10.10",  # Script Manual 5.25.1: released in 5.23 and 10.10
    status="partial",
    note="moves a dynamic arm (--arm dynamic); an ideal one does not move, as in URSim",
)
def direct_torque(
    host: ProgramHost,
    torques: Joints,
    friction_comp: Bool = True,
    viscous_scale: Joints | None = None,
    coulomb_scale: Joints | None = None,
) -> Frames[None]:
    """Command joint torques [Nm] in addition to gravity compensation, for one control period.

    With `friction_comp`, the joints compensate their friction by these fractions (0 to 1) of each kind.
    """
    if host.arm.drives is None:
        host.note_once("direct_torque does not move an ideal arm, as in URSim: start the emulator with --arm dynamic")
    viscous = _friction_scale("viscous_scale", viscous_scale, VISCOUS_SHARE)
    coulomb = _friction_scale("coulomb_scale", coulomb_scale, COULOMB_SHARE)
    shares = (viscous, coulomb) if friction_comp else ()
    with host.motion_control() as motion:
        yield from host.until_ready(
            motion.direct_torque(TorqueCommand(as_six(torques), *shares), host.arm.torque_response)
        )


def _friction_scale(name: str, given: Sequence[float] | None, usual: Vector6) -> Vector6:
    if given is None:
        return usual
    if not all(0.0 <= share <= 1.0 for share in given):
        raise RuntimeFault(f"direct_torque: each {name} must be from 0 to 1, not {list(given)}")
    return as_six(given)


@LIBRARY.builtin(work=130)
def set_pos(host: ProgramHost, q: Joints) -> None:
    """Set the joint angles [rad] of the simulated arm without a movement; only while it stands still."""
    if not host.motion.idle:
        raise RuntimeFault("set_pos: the arm is moving; stop it first")
    with host.motion_control(), within_range():
        host.motion.set_position(as_six(q))


@LIBRARY.builtin(cb3="3.1", e="5.0")
def reset_revolution_counter(host: ProgramHost, qNear: Joints | None = None) -> None:
    """Reset the turns of an unlimited wrist 3: its angle becomes the equivalent one nearest to `qNear` or 0.

    Does nothing on an arm whose wrist 3 is limited.
    """
    if not host.machine.model.wrist3_unlimited:
        return
    if not host.motion.idle:
        raise RuntimeFault("reset_revolution_counter: the arm is moving; stop it first")
    near = 0.0 if qNear is None else qNear[5]
    if not plausible(near):
        raise RuntimeFault(f"reset_revolution_counter: wrist 3 cannot be near {near:g} rad")
    with host.motion_control(), within_range():
        motion = host.motion
        motion.set_position((*motion.q[:5], nearest_angle(motion.q[5], near)))


# Settings that have no effect on this motion generator, but that PolyScope writes into programs.


@LIBRARY.builtin(cb3="3.1", e="5.0", note="the ideal arm never deviates from its path")
def position_deviation_warning(host: ProgramHost, enabled: Bool, threshold: Num = 0.8) -> None:
    """Log warnings when the arm gets close to the deviation limit; `threshold` 0 to 1 of the limit."""
    if not 0 <= threshold <= 1:
        raise RuntimeFault(f"position_deviation_warning: threshold must be 0 to 1, not {threshold}")


@LIBRARY.builtin(cb3=None, e="5.19", status="partial", note="stored and returned; there is one motion implementation")
def motion_version_set(host: ProgramHost, version: Int) -> None:
    """Select the motion implementation."""
    host.programs.motion_version = version


@LIBRARY.builtin(cb3=None, e="5.19", status="partial", note="returns what was set")
def motion_version_get(host: ProgramHost) -> int:
    """The selected motion implementation."""
    return host.programs.motion_version


def _check_profile(name: str, a: float, v: float, t: float, r: float) -> None:
    _check_not_negative(name, r=r)
    if t <= 0:
        _check_positive(name, a=a, v=v)


def _check_positive(name: str, **values: float) -> None:
    for key, value in values.items():
        if not value >= _MIN_VALUE:
            raise RuntimeFault(f"{name}: {key} must be greater than 0, not {value}")


def _check_not_negative(name: str, **values: float) -> None:
    for key, value in values.items():
        if value < 0:
            raise RuntimeFault(f"{name}: {key} must be 0 or more, not {value}")


def _check_fractions(name: str, a: float, v: float) -> None:
    for key, value in (("a", a), ("v", v)):
        if not 0 < value <= 1:
            raise RuntimeFault(f"{name}: {key} must be greater than 0 and at most 1, not {value}")
