"""Settings of the motion controller: limits, stops, holding torque."""

import math

from emulator.builtins.geometry import numbers
from emulator.builtins.host import ProgramHost
from emulator.motion.wrench_limit import WrenchLimit
from urproto.vectors import as_six
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Num, PoseArg

LIBRARY = Library("tuning", host=True, physical=True)

_MIN_JERK_GAIN = 0.01  # Script Manual


# Script Manual CB3 3.15.4, and not yet that of 3.10; that 3.11 has it is a guess.
@LIBRARY.builtin(cb3="3.11", e="5.0")
def pause_on_error_code(host: ProgramHost, code: Int, argument: Int | None = None) -> None:
    """Pause the program when error `code` is reported, instead of a protective stop, until the program ends.

    Without `argument`, the code counts with any argument.
    """
    host.programs.pause_codes.add((code, argument))


@LIBRARY.builtin(cb3="3.1", e="5.0", note="0 until it is called (a guess)")
def set_safety_mode_transition_hardness(host: ProgramHost, type_: Int) -> None:
    """Set how the arm slows down for reduced mode and safeguard stops: 0 hard, as fast as it can; 1 soft."""
    if type_ not in (0, 1):
        raise RuntimeFault(f"set_safety_mode_transition_hardness: type must be 0 (hard) or 1 (soft), not {type_}")
    host.motion.hard_transitions = type_ == 0


@LIBRARY.builtin(cb3=None, e="5.10", status="partial", note="stored; an ideal arm holds its position against any force")
def high_holding_torque_enable(host: ProgramHost) -> None:
    """Hold the arm with more torque at standstill, which is the default."""
    host.programs.high_holding_torque = True


@LIBRARY.builtin(cb3=None, e="5.10", status="partial", note="stored; an ideal arm holds its position against any force")
def high_holding_torque_disable(host: ProgramHost) -> None:
    """Hold the arm with no more torque at standstill than needed."""
    host.programs.high_holding_torque = False


@LIBRARY.builtin(
    cb3=None,
    e="5.19",
    status="partial",
    note="applies to movej, movel, movep, movec and optimove; not to blends, stops and streamed setpoints",
    work=130,
)
def tool_wrench_limit_set(
    host: ProgramHost,
    frame_offset: PoseArg,
    Fx: Num | None = None,
    Fy: Num | None = None,
    Fz: Num | None = None,
    Mx: Num | None = None,
    My: Num | None = None,
    Mz: Num | None = None,
) -> None:
    """Limit the forces [N] and torques [Nm] by which movements accelerate the payload.

    They are those in a frame given relative to the flange. Movements that need more become slower;
    an omitted axis has no limit. Applies to movements that begin from now on.
    """
    limits = (Fx, Fy, Fz, Mx, My, Mz)
    for limit in limits:
        if limit is not None and not (math.isfinite(limit) and limit > 0):
            raise RuntimeFault(f"tool_wrench_limit_set: a limit must be greater than 0, not {limit}")
    frame = as_six(numbers(frame_offset, 6, "tool_wrench_limit_set: frame_offset"))
    installation = host.machine.installation
    host.motion.commands.wrench_limit = WrenchLimit.of(frame, limits, lambda: installation.payload)


@LIBRARY.builtin(cb3=None, e="5.19")
def tool_wrench_limit_disable(host: ProgramHost) -> None:
    """Remove the limit on the tool wrench."""
    host.motion.commands.wrench_limit = None


@LIBRARY.builtin(cb3=None, e="5.20", status="partial", note="stored and returned; no speed profile here limits jerk")
def jerk_gain_scaling_set(host: ProgramHost, gain: Num) -> None:
    """Set the scale of the jerk of jerk-limited movements, 0.01 to 1."""
    if not _MIN_JERK_GAIN <= gain <= 1:
        raise RuntimeFault(f"jerk_gain_scaling_set: gain must be {_MIN_JERK_GAIN} to 1, not {gain}")
    host.programs.jerk_gain_scaling = float(gain)


@LIBRARY.builtin(cb3=None, e="5.20", status="partial", note="returns what was set")
def jerk_gain_scaling_get(host: ProgramHost) -> float:
    """The scale of the jerk, 1 unless set."""
    return host.programs.jerk_gain_scaling
