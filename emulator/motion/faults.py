"""Reasons why a movement ends in a protective stop, or deviates from its command."""

from dataclasses import dataclass
from enum import Enum

# Report codes and arguments. Their meaning is that of the vendor's error table (as copied in a public RTDE library);
# when a controller reports them is stated, with its source, at each fault below.
_CLOSE_TO_JOINT_LIMIT = 150  # "position close to joint limits"
_POSITION_DEVIATES = 153  # "position deviates from path"
_IN_SINGULARITY = 154  # "position in singularity"
_BLEND_ISSUE = 171
_CONVEYOR = 195  # "conveyor speed too high", for the limit that the argument names, as in the next two
_BLEND_OVERLAP = 197
_PATH_OFFSET = 219
_FRAME_TRACKING = 222
_JOINT_SPEED, _TOOL_SPEED = 1, 2  # arguments of these three
_PATH_SANITY = 204  # "path sanity check failed", with the following arguments
_SUDDEN_JUMP = 1  # "sudden change in target position"
_SUDDEN_STOP = 3
_INVALID_SETPOINT = 5  # "robot program resulted in invalid setpoint"


class Singularity(Enum):
    """Configurations in which the tool cannot move in every direction; the value describes the arm."""

    ELBOW = "the elbow is stretched or folded"
    SHOULDER = "the wrist is above or below the base joint's axis"
    WRIST = "the axes of joints 4 and 6 are parallel"


@dataclass(eq=False)
class MotionFault(Exception):  # noqa: N818 - the controller's term, whether it is raised or not
    """A movement cannot continue; the arm makes a protective stop.

    ``code`` and ``argument`` form the report code (C154A0), ``text`` says what happened and what to do next,
    ``joint`` is 0-5, or None if no single joint is the cause.
    """

    code: int
    argument: int
    text: str
    joint: int | None = None

    def __str__(self) -> str:
        return f"C{self.code}A{self.argument}: {self.text}"


@dataclass(frozen=True, slots=True)
class MotionWarning:
    """A remark about a movement that continues; ``code`` and ``argument`` as in a fault."""

    code: int
    argument: int
    text: str

    @property
    def skips(self) -> bool:
        """Whether the arm skips the waypoint."""
        return self.code == _BLEND_ISSUE


def waypoint_skipped(argument: int, radius_m: float, before_m: float, distance_m: float) -> MotionWarning:
    """Two blends overlap: the arm skips the second waypoint. The argument is the kind of move."""
    return MotionWarning(
        _BLEND_ISSUE,
        argument,
        f"overlapping blends, a waypoint is skipped: its blend radius of {radius_m:.4f} m and that of the one "
        f"before, {before_m:.4f} m, do not fit into the {distance_m:.4f} m between them; reduce them",
    )


def blend_cut(radius_m: float, distance_m: float) -> MotionWarning:
    """A blend would reach beyond the waypoint at the other end of a move. When controllers report this is a guess."""
    return MotionWarning(
        _BLEND_OVERLAP,
        0,
        f"a blend radius of {radius_m:.4f} m reaches beyond the waypoint at the other end of the move, "
        f"{distance_m:.4f} m away: the blend is cut to half of that distance; reduce the radius",
    )


def joint_limit(joint: int, position_rad: float, lower_rad: float, upper_rad: float) -> MotionFault:
    return MotionFault(
        _CLOSE_TO_JOINT_LIMIT,
        0,
        f"joint {joint} is at its position limit: {position_rad:.4f} rad is not within "
        f"{lower_rad:.4f} to {upper_rad:.4f} rad; move it the other way or choose another target",
        joint,
    )


def unreachable(pose_base_tcp: tuple[float, ...]) -> MotionFault:
    """No joint configuration puts the tool at this pose.

    One report of a UR5e (moveL of ur_rtde from an extended arm, further outwards) names C204A3. A pose that a program
    asks the inverse kinematics for is an error of the program instead.
    """
    place = ", ".join(f"{value:.4f}" for value in pose_base_tcp)
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_STOP,
        f"p[{place}] is out of reach for this arm and TCP; choose a pose inside the workspace",
    )


def path_out_of_reach(pose_base_tcp: tuple[float, ...], goal_base_tcp: tuple[float, ...] | None = None) -> MotionFault:
    """The path of the tool leaves the workspace on its way to a goal, or without one.

    The arm is singular at the edge of its workspace, stretched or above its base: the code is that of a singularity
    (guess).
    """
    place = ", ".join(f"{value:.4f}" for value in pose_base_tcp)
    way = ""
    if goal_base_tcp is not None:
        way = f" to p[{', '.join(f'{value:.4f}' for value in goal_base_tcp)}]"
    return MotionFault(
        _IN_SINGULARITY,
        0,
        f"the tool's path{way} leads through p[{place}], which is out of reach for this arm and TCP; "
        "use movej, or move the start or the goal",
    )


def bad_setpoint(what: str) -> MotionFault:
    """The program commanded a value that is not a finite number. The code is the one whose meaning fits (guess)."""
    return MotionFault(_PATH_SANITY, _INVALID_SETPOINT, f"{what} is not finite; check the program's arithmetic")


def near_singularity() -> MotionFault:
    """The path cannot be followed within the joint speed limits at any speed.

    Users of URSim 5.12 and 5.26 name C154A0 for moves in and through a singularity. In force mode it is a guess.
    """
    return MotionFault(
        _IN_SINGULARITY,
        0,
        "the path runs through a singularity and cannot be followed; use movej or move the waypoint",
    )


def singular_start(singularity: Singularity) -> MotionFault:
    """A path of the tool begins in a singularity, in which a controller does not follow even the shortest one.

    C154A0: users of URSim 5.12 and 5.26, for a stretched arm. With the wrist singular alone, URSim's inverse kinematics
    continues with another wrist, which is a sudden change in target position, C204A1 (one public project).
    """
    code, argument = (_PATH_SANITY, _SUDDEN_JUMP) if singularity is Singularity.WRIST else (_IN_SINGULARITY, 0)
    return MotionFault(
        code, argument, f"the path of the tool begins in a singularity: {singularity.value}; use movej to leave it"
    )


def off_the_path(axis: int, deviation: float, limit: float) -> MotionFault:
    """In force mode, the arm deviates too far along, or about, an axis that is not compliant.

    Source of the protective stop: user manual, "Force". The code is that of other deviations (guess).
    """
    way, unit = ("along", "m") if axis < 3 else ("about", "rad")
    return MotionFault(
        _POSITION_DEVIATES,
        0,
        f"in force mode the tool is {deviation:.4f} {unit} off its path {way} the task frame's {'xyz'[axis % 3]} axis: "
        f"{limit:.4f} {unit} are allowed; raise force_mode's limit of that axis, make it compliant, or push less",
    )


def sudden_jump(joint: int, change_rad_s: float, speed_rad_s: float) -> MotionFault:
    """The displacement of the path demands too large a change of a joint's speed within one control period (guess)."""
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_JUMP,
        f"the path offset, conveyor or frame makes joint {joint} change its speed by {change_rad_s:.2f} rad/s to "
        f"{speed_rad_s:.2f} rad/s within one control period; make the added motion smoother, or filter it",
        joint,
    )


class Displacement(Enum):
    """What displaces a path; the value is the report code of one that is too fast for a safety limit."""

    PATH_OFFSET = _PATH_OFFSET
    CONVEYOR = _CONVEYOR
    FRAME = _FRAME_TRACKING


def displaced_too_fast(source: Displacement, joint: int, speed_rad_s: float, limit_rad_s: float) -> MotionFault:
    return MotionFault(
        source.value,
        _JOINT_SPEED,
        f"the path offset, conveyor or frame makes joint {joint} move at {speed_rad_s:.2f} rad/s, but at most "
        f"{limit_rad_s:.2f} rad/s are allowed; slow it down",
        joint,
    )


def slider_raised() -> MotionFault:
    """The speed slider was at 0 during a servoj and is raised again.

    Issues 58 of the official C++ library and 90 of the ROS 2 driver: with the speed slider at 0, the next higher value
    caused a protective stop. Since then, the drivers keep it at 1 % or more. The code is a guess.
    """
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_JUMP,
        "the speed slider was at 0 and was raised during a servoj; keep it at 0.01 or more, or pause the program",
    )


def conveyor_too_fast(speed_m_s: float, limit_m_s: float) -> MotionFault:
    return MotionFault(
        _CONVEYOR,
        _TOOL_SPEED,
        f"the conveyor runs at {abs(speed_m_s):.3f} m/s at the tool, but at most {limit_m_s:.3f} m/s can be tracked; "
        "slow it down, or check its ticks per metre or revolution",
    )


def frame_too_fast(name: str, speed_m_s: float, limit_m_s: float, turn_rad_s: float, limit_rad_s: float) -> MotionFault:
    return MotionFault(
        _FRAME_TRACKING,
        _TOOL_SPEED,
        f'the frame "{name}" moves the tool at {speed_m_s:.3f} m/s and {turn_rad_s:.3f} rad/s, but at most '
        f"{limit_m_s:.3f} m/s and {limit_rad_s:.3f} rad/s can be tracked; move it more slowly",
    )


def frame_lost(name: str, why: str) -> MotionFault:
    """A tracked frame has been lost. The code is a guess."""
    return MotionFault(
        _PATH_SANITY,
        _INVALID_SETPOINT,
        f'the frame "{name}" can no longer be tracked: {why}; call frame_tracking_disable() first',
    )
