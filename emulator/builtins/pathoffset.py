"""Path offsets: a Cartesian offset added to the robot's movements, which a program can change at any time."""

from emulator.builtins.geometry import numbers
from emulator.builtins.host import Frames, ProgramHost
from emulator.motion.superposition import OffsetFrame
from urproto.vectors import as_six
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Num, Pose, PoseOrJoints

LIBRARY = Library("path offset", host=True, physical=True)

_SINCE = "5.6"  # vendor's support article "Modify robot trajectory by overlaying custom motion"


@LIBRARY.builtin(cb3=None, e=_SINCE)
def path_offset_enable(host: ProgramHost) -> None:
    """Start adding an offset to all movements, zero until path_offset_set() changes it.

    Active during movements and at rest, until path_offset_disable() or the program's end.
    """
    host.check_main("path_offset_enable")
    host.motion.superposition.enable_path_offset()


@LIBRARY.builtin(cb3=None, e=_SINCE)
def path_offset_disable(host: ProgramHost, a: Num = 20) -> Frames[None]:
    """Stop all joints with `a` [rad/s2], like stopj(), and stop adding the offset: the arm stays where it is."""
    if not a > 0:
        raise RuntimeFault(f"path_offset_disable: a must be greater than 0, not {a}")
    with host.motion_control() as motion:
        yield from host.until_ready(motion.disable_path_offset(a))


@LIBRARY.builtin(cb3=None, e=_SINCE, note="without effect before path_offset_enable()", work=60)
def path_offset_set(host: ProgramHost, offset: PoseOrJoints, type_: Int) -> None:
    """Set the offset [m, rotation vector]; each component is limited to path_offset_set_max_offset().

    `type`: 1 base axes, rotation about the TCP; 2 TCP; 3 motion (x along the path, y = x cross the tool's
    z, z = x cross y); 4 world (the offset is the pose of the base in the world, in which the path is given).
    An offset that jumps causes a protective stop.
    """
    given = as_six(numbers(offset, 6, "path_offset_set: offset"))
    host.motion.superposition.set_path_offset(given, _frame("path_offset_set", type_))


@LIBRARY.builtin(cb3=None, e=_SINCE, work=60)
def path_offset_get(host: ProgramHost, type_: Int) -> Pose:
    """The offset applied now, filtered and limited, expressed in this `type` (see path_offset_set)."""
    return Pose(host.motion.superposition.path_offset(_frame("path_offset_get", type_)))


@LIBRARY.builtin(cb3=None, e=_SINCE)
def path_offset_set_alpha_filter(host: ProgramHost, alpha: Num) -> None:
    """Smooth offsets: each period the applied one covers `alpha` (0 to 1) of the difference to the set one."""
    if not 0 <= alpha <= 1:
        raise RuntimeFault(f"path_offset_set_alpha_filter: alpha must be 0 to 1, not {alpha}")
    host.motion.superposition.settings.alpha = float(alpha)


@LIBRARY.builtin(cb3=None, e=_SINCE)
def path_offset_set_max_offset(host: ProgramHost, transLimit: Num, rotLimit: Num) -> None:
    """Limit each component of offsets set from now on to `transLimit` [m] and `rotLimit` [rad]."""
    if not (transLimit >= 0 and rotLimit >= 0):
        raise RuntimeFault(f"path_offset_set_max_offset: the limits must be 0 or more, not {transLimit} and {rotLimit}")
    settings = host.motion.superposition.settings
    settings.translation_limit, settings.rotation_limit = float(transLimit), float(rotLimit)


def _frame(name: str, type_: int) -> OffsetFrame:
    try:
        return OffsetFrame(type_)
    except ValueError:
        raise RuntimeFault(f"{name}: type must be 1 (base), 2 (TCP), 3 (motion) or 4 (world), not {type_}") from None
