"""The world model: named frames for poses, which move with the arm or with each other."""

from emulator.builtins.geometry import OUT_OF_RANGE, arm_pose, numbers, three
from emulator.builtins.host import Frames, ProgramHost
from emulator.builtins.setup import checked_inertia, checked_mass, use_payload
from emulator.motion.tracking import FrameTracking
from emulator.robot.worldmodel import MassProperties, WorldModel
from urproto.vectors import as_six
from urscript.builtins import Library
from urscript.values import ListArg, Num, Pose, PoseArg, Str

LIBRARY = Library("worldmodel", host=True, physical=True, faults=OUT_OF_RANGE)

_STOP_RAD_S2 = 20.0  # the default of stop_conveyor_tracking (guess)


def _world(host: ProgramHost) -> WorldModel:
    return host.machine.world_model


@LIBRARY.builtin(cb3=None, e="5.10")
def add_frame(host: ProgramHost, name: Str, pose: PoseArg, ref_name: Str = "base") -> None:
    """Add a frame at `pose`, given in the frame `ref_name`. It is fixed in the world until attach_frame()."""
    _world(host).add(name, as_six(numbers(pose, 6, "add_frame: pose")), ref_name, arm_pose(host))


@LIBRARY.builtin(cb3=None, e="5.10")
def attach_frame(host: ProgramHost, child: Str, parent: Str) -> None:
    """Let the frame `child` move along with `parent`. Attaching does not change its present pose.

    `child` cannot be "world", "flange", "tcp", or a frame that `parent` moves along with.
    """
    _world(host).attach(child, parent, arm_pose(host))


@LIBRARY.builtin(cb3=None, e="5.10")
def delete_frame(host: ProgramHost, name: Str) -> None:
    """Delete a frame. Frames attached to it stay where they are, attached to the world."""
    _world(host).delete(name, arm_pose(host))


@LIBRARY.builtin(cb3=None, e="5.10", work=200)
def delete_all_frames(host: ProgramHost) -> None:
    """Delete every frame but "world", "base", "flange" and "tcp", as delete_frame() would."""
    _world(host).delete_all(arm_pose(host))


@LIBRARY.builtin(cb3=None, e="5.10")
def move_frame(host: ProgramHost, name: Str, pose: PoseArg, ref_name: Str = "base") -> None:
    """Move a frame to `pose`, given in the frame `ref_name`. Frames attached to it move along."""
    _world(host).move(name, as_six(numbers(pose, 6, "move_frame: pose")), ref_name, arm_pose(host))


@LIBRARY.builtin(cb3=None, e="5.10")
def get_pose(host: ProgramHost, name: Str, rel_name: Str, ref_name: Str | None = None) -> Pose:
    """Pose of the frame `name` relative to `rel_name`, in coordinates of `ref_name` (default: `rel_name`)."""
    return Pose(_world(host).pose(name, rel_name, rel_name if ref_name is None else ref_name, arm_pose(host)))


@LIBRARY.builtin(cb3=None, e="5.10")
def convert_pose(host: ProgramHost, pose: PoseArg, from_frame: Str, to_frame: Str) -> Pose:
    """Convert a pose given in `from_frame` to the coordinates of `to_frame`."""
    given = as_six(numbers(pose, 6, "convert_pose: pose"))
    return Pose(_world(host).convert(given, from_frame, to_frame, arm_pose(host)))


@LIBRARY.builtin(cb3=None, e="5.10")
def reset_world_model(host: ProgramHost) -> None:
    """Delete every added frame and return the base to the world's origin."""
    _world(host).reset()


@LIBRARY.builtin(cb3=None, e="5.10")
def is_frame(host: ProgramHost, name: Str) -> bool:
    """Whether a frame of that name exists."""
    return name in _world(host)


@LIBRARY.builtin(cb3=None, e="5.10")
def get_frame_parent(host: ProgramHost, name: Str) -> str:
    """Name of the frame that `name` is attached to."""
    return _world(host).parent(name)


@LIBRARY.builtin(cb3=None, e="5.10")
def get_children(host: ProgramHost, name: Str) -> list[str]:
    """Names of the frames attached directly to `name`."""
    return _world(host).children(name)


@LIBRARY.builtin(cb3=None, e="5.20")
def set_mass_properties(host: ProgramHost, frame: Str, m: Num, cog: ListArg, inertia: ListArg) -> None:
    """Set the mass [kg] a frame carries, its centre of gravity in the frame [m], and the inertia about that.

    `inertia`: Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2] in the frame's axes. It counts as payload once
    set_payload_from_attached_frames() has been called.
    """
    name = "set_mass_properties"
    properties = MassProperties(checked_mass(m), three(cog, f"{name}: cog"), checked_inertia(inertia, name))
    _world(host).set_mass(frame, properties)


@LIBRARY.builtin(cb3=None, e="5.20", work=300)
def set_payload_from_attached_frames(host: ProgramHost) -> None:
    """Set the payload to the masses of all frames attached, directly or indirectly, to TCP or flange."""
    use_payload(host, _world(host).payload(arm_pose(host)))


@LIBRARY.builtin(cb3=None, e="5.10")
def frame_tracking_enable(host: ProgramHost, frame_name: Str) -> None:
    """Move the arm, and all following movements, along with a frame that moves in the base frame.

    Poses refer to the time when tracking began. A frame that the arm itself carries cannot be tracked. Stays
    active until frame_tracking_disable() or the program's end.
    """
    host.check_main("frame_tracking_enable")
    world = _world(host)
    host.motion.superposition.track_frame(FrameTracking(frame_name, lambda: world.in_base(frame_name)))


@LIBRARY.builtin(cb3=None, e="5.10")
def frame_tracking_disable(host: ProgramHost) -> Frames[None]:
    """Stop all joints and end frame tracking: the arm stays, and poses refer to the base frame again."""
    with host.motion_control() as motion:
        yield from host.until_ready(motion.stop_tracking_frame(_STOP_RAD_S2))
