"""Why a movement had to end in a protective stop, or went another way than it was told to."""

from dataclasses import dataclass

# Report codes and arguments of the controller's error list. Which of them a real controller gives for a pose out of
# reach is a guess; the others are named in that list.
_CLOSE_TO_JOINT_LIMIT = 150
_CONVEYOR_SPEED = 195
_TOOL_SPEED = 2
_POSITION_DEVIATES = 153
_BLEND_ISSUE = 171
_BLEND_OVERLAP = 197
_PATH_SANITY = 204
_SUDDEN_JUMP = 1
_INVALID_SETPOINT = 5
_SINGULARITY = 7


@dataclass(eq=False)
class MotionFault(Exception):  # noqa: N818 - it is what the controller calls a fault, raised or not
    """A movement cannot go on; the arm is being stopped protectively.

    ``code`` and ``argument`` form the report code (C204A7), ``text`` says what happened and what to do next,
    ``joint`` is 0-5 or None when no single joint is to blame.
    """

    code: int
    argument: int
    text: str
    joint: int | None = None

    def __str__(self) -> str:
        return f"C{self.code}A{self.argument}: {self.text}"


@dataclass(frozen=True, slots=True)
class MotionWarning:
    """Something that a program should know of a movement that goes on; ``code`` and ``argument`` as of a fault."""

    code: int
    argument: int
    text: str

    @property
    def skips(self) -> bool:
        """The arm does not go to the waypoint."""
        return self.code == _BLEND_ISSUE


def waypoint_skipped(argument: int, radius_m: float, before_m: float, distance_m: float) -> MotionWarning:
    """Two blends overlap: the arm does not go to the second waypoint. The argument tells the kind of move."""
    return MotionWarning(
        _BLEND_ISSUE,
        argument,
        f"overlapping blends, a waypoint is skipped: its blend radius of {radius_m:.4f} m and that of the waypoint "
        f"before, {before_m:.4f} m, do not fit into the {distance_m:.4f} m between them; make the radii smaller",
    )


def blend_cut(radius_m: float, distance_m: float) -> MotionWarning:
    """A blend would reach beyond the waypoint at the other end of a move. When a controller gives this code: guess."""
    return MotionWarning(
        _BLEND_OVERLAP,
        0,
        f"a blend radius of {radius_m:.4f} m reaches beyond the waypoint at the other end of the move, "
        f"{distance_m:.4f} m away: the blend is cut to half of that; make the radius smaller",
    )


def joint_limit(joint: int, position_rad: float, lower_rad: float, upper_rad: float) -> MotionFault:
    """The arm would leave the position range of a joint."""
    return MotionFault(
        _CLOSE_TO_JOINT_LIMIT,
        0,
        f"joint {joint} is at its position limit: {position_rad:.4f} rad is not within "
        f"{lower_rad:.4f} to {upper_rad:.4f} rad; move it the other way or choose another target",
        joint,
    )


def unreachable(pose_base_tcp: tuple[float, ...]) -> MotionFault:
    """No joint configuration puts the tool at this pose."""
    place = ", ".join(f"{value:.4f}" for value in pose_base_tcp)
    return MotionFault(
        _PATH_SANITY,
        _INVALID_SETPOINT,
        f"p[{place}] is out of reach for this arm and TCP; choose a pose inside the work space",
    )


def path_out_of_reach(pose_base_tcp: tuple[float, ...], goal_base_tcp: tuple[float, ...]) -> MotionFault:
    """The way of the tool leaves the work space before its goal."""
    place, goal = (", ".join(f"{value:.4f}" for value in pose) for pose in (pose_base_tcp, goal_base_tcp))
    return MotionFault(
        _PATH_SANITY,
        _INVALID_SETPOINT,
        f"the tool's path to p[{goal}] leads through p[{place}], which is out of reach for this arm and TCP; "
        "go there with movej, or move the start or the goal",
    )


def bad_setpoint(what: str) -> MotionFault:
    """The program asked for something that is not a finite number."""
    return MotionFault(_PATH_SANITY, _INVALID_SETPOINT, f"{what} is not finite; check the program's arithmetic")


def near_singularity() -> MotionFault:
    """The path cannot be followed within the joint speed limits, however slowly."""
    return MotionFault(
        _PATH_SANITY,
        _SINGULARITY,
        "the path runs through a singularity and cannot be followed; use movej or move the waypoint",
    )


def off_the_path(axis: int, deviation: float, limit: float) -> MotionFault:
    """In force mode the arm is not where it should be along, or about, an axis that does not comply.

    That it stops protectively: user manual, "Force". The code is that of other deviations (guess).
    """
    way, unit = ("along", "m") if axis < 3 else ("about", "rad")
    return MotionFault(
        _POSITION_DEVIATES,
        0,
        f"in force mode the tool is {deviation:.4f} {unit} off its path {way} the task frame's {'xyz'[axis % 3]} axis, "
        f"and {limit:.4f} {unit} are allowed; raise force_mode's limit of that axis, make it compliant, or push less",
    )


def sudden_jump(joint: int, change_rad_s: float, speed_rad_s: float) -> MotionFault:
    """What is added to the path asks too much of a joint within one control period."""
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_JUMP,
        f"the path offset, conveyor or frame asks joint {joint} to change its speed by {change_rad_s:.2f} rad/s to "
        f"{speed_rad_s:.2f} rad/s within one control period; make what is added to the path smoother, or filter it",
        joint,
    )


def slider_raised() -> MotionFault:
    """The time of a servoj goes on after it has stood still.

    Issues 58 of the official C++ library and 90 of the ROS 2 driver: with the speed slider at 0, the next higher value
    stopped the arm protectively. The drivers keep it at 1 % or more since. The code is a guess.
    """
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_JUMP,
        "the speed slider was at 0 and was raised during a servoj; keep it at 0.01 or more, or pause the program",
    )


def conveyor_too_fast(speed_m_s: float, limit_m_s: float) -> MotionFault:
    """The conveyor moves the tool faster than it may go."""
    return MotionFault(
        _CONVEYOR_SPEED,
        _TOOL_SPEED,
        f"the conveyor runs at {abs(speed_m_s):.3f} m/s at the tool and at most {limit_m_s:.3f} m/s can be tracked; "
        "slow it down, or check its ticks per metre or revolution",
    )


def frame_too_fast(name: str, speed_m_s: float, limit_m_s: float, turn_rad_s: float, limit_rad_s: float) -> MotionFault:
    """A tracked frame moves the tool faster than it may go. The code is a guess."""
    return MotionFault(
        _PATH_SANITY,
        _SUDDEN_JUMP,
        f'the frame "{name}" moves the tool at {speed_m_s:.3f} m/s and {turn_rad_s:.3f} rad/s, and at most '
        f"{limit_m_s:.3f} m/s and {limit_rad_s:.3f} rad/s can be tracked; move it more slowly",
    )


def frame_lost(name: str, why: str) -> MotionFault:
    """A tracked frame cannot be tracked any more. The code is a guess."""
    return MotionFault(
        _PATH_SANITY,
        _INVALID_SETPOINT,
        f'the frame "{name}" cannot be tracked any more: {why}; call frame_tracking_disable() before',
    )
