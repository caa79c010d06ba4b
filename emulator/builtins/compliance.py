"""Force mode, freedrive, contact and the force/torque sensor."""

import math
from typing import Any

from emulator.builtins.geometry import numbers, three, within_range
from emulator.builtins.host import ProgramHost
from emulator.motion.reach import distance_to_singularity
from urproto.vectors import ZERO6, Vector6, as_six
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Any_, Bool, Int, Joints, ListArg, Num, Pose, PoseArg, PoseOrJoints

LIBRARY = Library("force", host=True, physical=True)

# Default arguments: a tuple stands for the list or pose that scripts see.
_ORIGIN: Any = ZERO6
_ALL_AXES: Any = (1, 1, 1, 1, 1, 1)
_NO_OFFSET: Any = (0, 0, 0)
_SINGULARITY_BOUNDS = (0.2, 0.05)  # of distance_to_singularity(): about 11 and 3 degrees of elbow or wrist (guess)
_SENSOR_INPUT = "external_force_torque"
_SENSOR_NOTE = "how the controller uses the sensor's mass is not published: readings are taken as free of its weight"
_SENSOR_MIN_HZ = 10.0  # Script Manual: the watchdog that is set with the sensor


@LIBRARY.builtin(status="partial", note="an admittance driven by the emulated contact force")
def force_mode(
    host: ProgramHost,
    task_frame: PoseArg,
    selection_vector: Joints,
    wrench: Joints,
    type_: Int,
    limits: Joints,
) -> None:
    """Comply along the axes of `task_frame` that `selection_vector` marks with 1, and exert `wrench` there.

    Stays active during other movements until end_force_mode() or the program's end. `type`: 1, the
    frame points to the TCP; 2, it is fixed; 3, it follows the motion. `limits`: the highest speeds
    [m/s, rad/s] along compliant axes, the largest deviations [m, rad] along the others.
    """
    if type_ not in (1, 2, 3):
        raise RuntimeFault(f"force_mode: type must be 1, 2 or 3, not {type_}")
    if any(axis not in (0, 1) for axis in selection_vector):
        raise RuntimeFault(f"force_mode: selection_vector must contain only 0 and 1, not {list(selection_vector)}")
    host.check_main("force_mode")
    with within_range():
        host.motion.force_control.force_mode(
            as_six(task_frame), as_six(selection_vector), as_six(wrench), type_, as_six(limits)
        )


@LIBRARY.builtin()
def end_force_mode(host: ProgramHost) -> None:
    """Leave force mode."""
    host.motion.force_control.end()


@LIBRARY.builtin(cb3="3.0", e="5.0")
def force_mode_set_damping(host: ProgramHost, damping: Num) -> None:
    """Set the damping of force mode, 0 (none) to 1 (full), from now on."""
    _check_range("force_mode_set_damping", damping, 1)
    host.motion.force_control.damping = float(damping)


# The official control script contains this name on CB3 too, where it is never called; so it has to exist there.
@LIBRARY.builtin(cb3="3.0", e="5.0")
def force_mode_set_gain_scaling(host: ProgramHost, scaling: Num) -> None:
    """Set the gain of force mode, 0 to 2, from now on."""
    _check_range("force_mode_set_gain_scaling", scaling, 2)
    host.motion.force_control.gain_scaling = float(scaling)


@LIBRARY.builtin(cb3=None, e="5.10")
def force_mode_get_damping(host: ProgramHost) -> float:
    """Damping of force mode."""
    return host.motion.force_control.damping


@LIBRARY.builtin(cb3=None, e="5.10")
def force_mode_get_gain_scaling(host: ProgramHost) -> float:
    """Gain of force mode."""
    return host.motion.force_control.gain_scaling


@LIBRARY.builtin(
    cb3=None, e="5.0", status="partial", note="an admittance driven by the emulated contact force", work=130
)
def screw_driving(host: ProgramHost, f: Num, v_limit: Num) -> None:
    """Follow a screw: push with `f` [N] along the TCP's z axis, no faster than `v_limit` [m/s].

    The other directions are stiff. Stays active until end_screw_driving() or the program's end.
    """
    if not math.isfinite(f):
        raise RuntimeFault(f"screw_driving: f must be a force [N], not {f}")
    if not (math.isfinite(v_limit) and v_limit > 0):
        raise RuntimeFault(f"screw_driving: v_limit must be greater than 0 [m/s], not {v_limit}")
    host.check_main("screw_driving")
    host.motion.force_control.screw_driving(float(f), float(v_limit))


@LIBRARY.builtin(cb3=None, e="5.0")
def end_screw_driving(host: ProgramHost) -> None:
    """Leave screw driving."""
    host.motion.force_control.end()


@LIBRARY.builtin(
    status="partial", note="the arm follows the emulated external force; the payload check always passes", work=90
)
def freedrive_mode(host: ProgramHost, freeAxes: ListArg = _ALL_AXES, feature: Any_ = _ORIGIN) -> None:
    """Let the arm be moved by hand along the axes of `feature` that `freeAxes` marks with 1.

    `feature`: a pose in the base frame, "base", or "tool" for the axes of the TCP.
    """
    if len(freeAxes) != 6 or any(axis not in (0, 1) for axis in freeAxes):
        raise RuntimeFault("freedrive_mode: freeAxes must be a list of six numbers, each 0 or 1")
    host.check_main("freedrive_mode")
    host.motion.commands.freedrive(as_six(freeAxes), _feature(feature))


# Script Manual CB3 3.15.4; the first versions are guesses.
@LIBRARY.builtin(cb3="3.15", e="5.10", status="partial", note="the arm follows the emulated external force", work=90)
def freedrive_mode_no_incorrect_payload_check(host: ProgramHost) -> None:
    """freedrive_mode() without checking the payload first."""
    freedrive_mode(host)


@LIBRARY.builtin()
def end_freedrive_mode(host: ProgramHost) -> None:
    """Leave freedrive."""
    host.motion.force_control.end()


@LIBRARY.builtin(cb3="3.10", e="5.0", note="the two thresholds are guesses")
def get_freedrive_status(host: ProgramHost) -> int:
    """0 normal, 1 close to a singularity, 2 too close for constrained freedrive."""
    distance = distance_to_singularity(host.machine.model.dh, host.motion.q)
    return sum(distance < bound for bound in _SINGULARITY_BOUNDS)


@LIBRARY.builtin(status="partial", note="the arm follows the emulated external force", work=90)
def teach_mode(host: ProgramHost) -> None:
    """Old name of freedrive_mode()."""
    freedrive_mode(host)


@LIBRARY.builtin()
def end_teach_mode(host: ProgramHost) -> None:
    """Leave freedrive."""
    host.motion.force_control.end()


@LIBRARY.builtin(
    cb3="3.0",
    e="5.0",
    status="partial",
    note="a force above 20 N, or the threshold, counts as contact; the controller's own rule is not known",
)
def tool_contact(host: ProgramHost, direction: PoseOrJoints = _ORIGIN, force_threshold: Num = 0.0) -> int:
    """Number of control periods since just before the tool made contact along `direction`; 0 without contact.

    `direction`: six numbers in the base frame, of which the first three count; zeros there stand for any
    direction. `force_threshold` [N]: the force that counts as contact (5.25 manual); 0 for the default.
    """
    if not 0 <= force_threshold < math.inf:
        raise RuntimeFault(f"tool_contact: force_threshold must be 0 or more, not {force_threshold}")
    return host.programs.history.contact_steps(direction, force_threshold)


@LIBRARY.builtin(cb3="3.0", e="5.0")
def zero_ftsensor(host: ProgramHost) -> None:
    """Zero the force/torque readings: the present wrench counts as zero."""
    host.arm.zero_force()


@LIBRARY.builtin(cb3="3.0", e="5.0", status="partial", note=_SENSOR_NOTE, work=60)
def ft_rtde_input_enable(
    host: ProgramHost,
    enable: Bool,
    sensor_mass: Num = 0.0,
    sensor_measuring_offset: ListArg = _NO_OFFSET,
    sensor_cog: ListArg = _NO_OFFSET,
) -> None:
    """Take the wrench at the flange from the RTDE input external_force_torque.

    `sensor_mass` [kg], `sensor_measuring_offset` and `sensor_cog` from the flange [m]. Unless the program
    has set a watchdog itself, it pauses when the input is written less often than 10 Hz.
    """
    sensor = host.machine.ft_input
    sensor.measuring_offset = three(sensor_measuring_offset, "sensor_measuring_offset")
    sensor.sensor_cog = three(sensor_cog, "sensor_cog")
    sensor.sensor_mass = float(sensor_mass)
    sensor.enabled = enable
    watchdogs = host.programs.watchdogs
    if not enable:
        watchdogs.remove(_SENSOR_INPUT)
    elif not watchdogs:
        host.watch(_SENSOR_INPUT, _SENSOR_MIN_HZ, "pause")


@LIBRARY.builtin(cb3="3.3", e="5.0", status="partial", note=_SENSOR_NOTE, work=90)
def enable_external_ft_sensor(
    host: ProgramHost,
    enable: Bool,
    sensor_mass: Num = 0.0,
    sensor_measuring_offset: ListArg = _NO_OFFSET,
    sensor_cog: ListArg = _NO_OFFSET,
) -> None:
    """Old name of ft_rtde_input_enable()."""
    ft_rtde_input_enable(host, enable, sensor_mass, sensor_measuring_offset, sensor_cog)


def _feature(feature: Any) -> Vector6 | None:
    """The feature as a pose in the base frame; None stands for the tool's own frame."""
    if feature == "tool":
        return None
    if feature == "base" or feature is _ORIGIN:
        return as_six(_ORIGIN)
    if not isinstance(feature, Pose):
        raise RuntimeFault('freedrive_mode: feature must be a pose, "base" or "tool"')
    return as_six(numbers(feature, 6, "freedrive_mode: feature"))


def _check_range(name: str, value: float, most: float) -> None:
    if not 0 <= value <= most:
        raise RuntimeFault(f"{name}: the value must be 0 to {most}, not {value}")
