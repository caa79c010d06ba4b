"""Tool and mounting: TCP, payload, gravity."""

import math
from collections.abc import Sequence
from typing import Any

from emulator.builtins.geometry import numbers, three, within_range
from emulator.builtins.host import ProgramHost
from emulator.robot import payloadestimate
from emulator.robot.installation import Payload
from urproto.robots.pose import pose_inv, pose_trans
from urproto.vectors import Vector3, Vector6, as_six
from urproto.versions import Series
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Any_, ListArg, Matrix, Num, PoseArg, Str, Struct

LIBRARY = Library("setup", host=True, physical=True)

# These three are far beyond any arm, and within what the equations of motion can handle.
_MAX_MASS = 1000.0  # kg, of a payload (guess)
_MAX_LEVER = 10.0  # m, of a payload's centre of gravity (guess)
_MAX_ACCELERATION = 100.0  # m/s2, of gravity and of the base (guess)
_MAX_INERTIA = 133.0  # kg m2: Script Manual, set_target_payload
_NO_INERTIA: Any = (0, 0, 0, 0, 0, 0)  # a tuple stands for the list that scripts see


@LIBRARY.builtin(work=90)
def set_tcp(host: ProgramHost, pose: PoseArg, tcp_name: Str = "") -> None:
    """Set the TCP, as a pose relative to the tool flange."""
    with within_range():
        host.machine.set_tcp(as_six(numbers(pose, 6, "set_tcp: the pose")))


@LIBRARY.builtin()
def set_gravity(host: ProgramHost, d: ListArg) -> None:
    """Set gravity as an acceleration in the base frame [m/s2]: [0, 0, 9.82] for an upright arm."""
    host.machine.installation.gravity = _acceleration(d, "set_gravity")


@LIBRARY.builtin(cb3=None, e="5.20")
def get_gravity(host: ProgramHost) -> list[float]:
    """Gravity as set_gravity takes it [m/s2]."""
    return list(host.machine.installation.gravity)


@LIBRARY.builtin(work=90)
def set_payload(host: ProgramHost, m: Num, cog: ListArg | None = None) -> None:
    """Set the payload's mass [kg] and centre of gravity from the flange [m].

    The TCP when omitted: later calls of set_tcp then change the centre of gravity as well.
    """
    centre = _xyz(host.machine.installation.tcp) if cog is None else three(cog, "set_payload: cog")
    use_payload(host, _assumed(host, checked_mass(m), centre))
    host.machine.installation.cog_follows_tcp = cog is None


@LIBRARY.builtin(work=90)
def set_payload_mass(host: ProgramHost, m: Num) -> None:
    """Set the payload's mass [kg]."""
    use_payload(host, _assumed(host, checked_mass(m), host.machine.installation.target_payload.cog))


@LIBRARY.builtin(work=90)
def set_payload_cog(host: ProgramHost, CoG: ListArg) -> None:
    """Set the payload's centre of gravity from the flange [m]."""
    use_payload(host, _assumed(host, host.machine.installation.target_payload.mass, three(CoG, "set_payload_cog: CoG")))


# Available on CB3 from the first version: the official control script names it there, in branches that never run.
@LIBRARY.builtin(cb3="3.0", e="5.10", work=200)
def set_target_payload(
    host: ProgramHost,
    m: Num,
    cog: ListArg,
    inertia: ListArg = _NO_INERTIA,
    transition_time: Num = 0,
) -> None:
    """Set the payload's mass [kg], centre of gravity [m] and inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2].

    Takes effect gradually over `transition_time` [s].
    """
    moments = checked_inertia(inertia, "set_target_payload")
    if not (math.isfinite(transition_time) and transition_time >= 0):
        raise RuntimeFault(f"set_target_payload: transition_time must be 0 or more [s], not {transition_time}")
    use_payload(host, Payload(checked_mass(m), three(cog, "set_target_payload: cog"), moments), transition_time)


@LIBRARY.builtin(cb3="3.10", e="5.0")  # Script Manual CB3 3.10
def get_target_payload(host: ProgramHost) -> float:
    """Payload mass [kg]."""
    return host.machine.installation.target_payload.mass


@LIBRARY.builtin(cb3="3.10", e="5.0")  # Script Manual CB3 3.10
def get_target_payload_cog(host: ProgramHost) -> list[float]:
    """Payload centre of gravity from the flange [m]."""
    return list(host.machine.installation.target_payload.cog)


@LIBRARY.builtin(cb3="3.15", e="5.10")
def get_target_payload_inertia(host: ProgramHost) -> list[float]:
    """Payload inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2]."""
    return list(host.machine.installation.target_payload.inertia)


@LIBRARY.builtin(cb3=None, e="5.20")
def set_base_acceleration(host: ProgramHost, a: ListArg) -> None:
    """Set the linear acceleration of the base, as on a rail or a lift, in the base frame [m/s2].

    It acts on arm and payload in addition to gravity until it is set again.
    """
    host.machine.installation.base_acceleration = _acceleration(a, "set_base_acceleration")


@LIBRARY.builtin(cb3=None, e="5.20")
def get_base_acceleration(host: ProgramHost) -> list[float]:
    """Linear acceleration of the base as set_base_acceleration takes it [m/s2]."""
    return list(host.machine.installation.base_acceleration)


@LIBRARY.builtin(cb3=None, e="5.20")
def estimate_payload(host: ProgramHost, poses: Any_, wrenches: Any_) -> Struct:
    """Estimate a payload's mass [kg] and centre of gravity from the flange [m]: a struct of `mass` and `cog`.

    `poses`: at least four TCP poses in clearly different orientations. `wrenches`: the wrench that the payload's
    weight exerts on the flange in each pose, in base axes, as get_tcp_force() returns it.
    """
    back = pose_inv(host.machine.installation.tcp)
    flanges = [pose_trans(pose, back) for pose in _sixes(poses, "poses")]
    loads = _sixes(wrenches, "wrenches")
    with within_range():
        mass, cog = payloadestimate.estimate_payload(flanges, loads, host.machine.installation.gravity)
    return Struct({"mass": mass, "cog": list(cog)})


def _sixes(values: object, what: str) -> list[Vector6]:
    """Poses or lists of six numbers; URScript turns lists of lists into matrices."""
    rows = values.rows if isinstance(values, Matrix) else values
    if not isinstance(rows, list | tuple) or not all(isinstance(row, list | tuple) for row in rows):
        raise RuntimeFault(f"estimate_payload: {what} must be a list of poses or of lists of six numbers")
    return [as_six(numbers(row, 6, f"estimate_payload: each element of {what}")) for row in rows]


def _acceleration(vector: ListArg, name: str) -> Vector3:
    found = three(vector, f"{name}: the vector")
    if math.hypot(*found) > _MAX_ACCELERATION:
        raise RuntimeFault(f"{name}: the vector must be at most {_MAX_ACCELERATION:g} m/s2 long, not {list(found)}")
    return found


def _assumed(host: ProgramHost, mass: float, cog: Vector3) -> Payload:
    """Payload without a given inertia: a sphere on e-Series, as the Script Manual says; CB3 reports zeros.

    Source of the zeros: the ROS 2 driver compares the inertia that RTDE reports with the one it has set, which on CB3
    is none.
    """
    return Payload(mass, cog) if host.machine.version.series is Series.CB3 else Payload.of(mass, cog)


def use_payload(host: ProgramHost, payload: Payload, transition_s: float = 0.0) -> None:
    """Set the payload and zero the force/torque readings, as the Script Manual says.

    A mass beyond the arm's rating is accepted: real arms were seen to accept one, and then to rise on their own when it
    was not mounted. The pendant accepted at most twice the rating.
    """
    if math.hypot(*payload.cog) > _MAX_LEVER:
        where = list(payload.cog)
        raise RuntimeFault(f"the centre of gravity must be within {_MAX_LEVER:g} m of the flange, not at {where}")
    model = host.machine.model
    if payload.mass > model.payload_max_kg:
        host.note_once(
            f"the program has set a payload of {payload.mass:g} kg, but the {model.title} is rated for "
            f"{model.payload_max_kg:g} kg: a real arm would have less reach and speed than this one"
        )
    host.machine.installation.set_payload(payload, transition_s)
    host.arm.zero_force()


def checked_mass(m: float) -> float:
    """A payload's mass [kg]; RuntimeFault if it is negative, not a number or implausibly large."""
    if not 0 <= m <= _MAX_MASS:
        raise RuntimeFault(f"the payload mass must be 0 to {_MAX_MASS:g} [kg], not {m:g}")
    return float(m)


def checked_inertia(inertia: Sequence[float], name: str) -> Vector6:
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2]; RuntimeFault that names the built-in ``name`` if they are invalid."""
    moments = as_six(numbers(inertia, 6, f"{name}: inertia"))
    if min(moments[:3]) < 0:
        raise RuntimeFault(f"{name}: Ixx, Iyy and Izz must be 0 or more: {list(moments)}")
    if max(map(abs, moments)) > _MAX_INERTIA:
        raise RuntimeFault(f"{name}: no moment may exceed {_MAX_INERTIA} kg m2: {list(moments)}")
    return moments


def _xyz(pose: Sequence[float]) -> Vector3:
    return (pose[0], pose[1], pose[2])
