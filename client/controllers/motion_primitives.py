"""Controller whose motion primitives the robot executes itself: moves in joint space, along lines and along arcs.

The controller sets one primitive at a time on the command interfaces, and the hardware takes it. A single primitive is
executed immediately. A sequence is enclosed in two markers, and is executed as a whole, including blends, when the
second marker is taken. Source of interfaces, states and numbers: motion_primitives_controllers and ur_robot_driver.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from client.controllers.controller import NO_COMMAND, controller_type
from client.controllers.goals import GoalController, GoalHandle, MotionPrimitive, PrimitiveType
from client.controllers.parameters import PrefixParameters
from client.driver import points
from urproto.compat import IntEnum
from urproto.external_control import TrajectoryPoint
from urproto.robots.pose import quaternion_to_rotvec, rotvec_to_quaternion

PRIMITIVE: Final = "motion_primitive"
_XYZ: Final = ("x", "y", "z")
_POSE: Final = (*_XYZ, "qx", "qy", "qz", "qw")
PRIMITIVE_COMMANDS: Final = tuple(
    f"{PRIMITIVE}/{name}"
    for name in (
        "motion_type",
        *(f"q{joint}" for joint in range(1, 7)),
        *(f"pos_{part}" for part in _POSE),
        *(f"pos_via_{part}" for part in _POSE),
        *("blend_radius", "velocity", "acceleration", "move_time"),
    )
)
"""Interfaces of one primitive; NaN for values that it does not have."""
STATUS: Final = f"{PRIMITIVE}/execution_status"
READY: Final = f"{PRIMITIVE}/ready_for_new_primitive"
_TYPE: Final = PRIMITIVE_COMMANDS[0]
_JOINTS: Final = 6


class Marker(IntEnum):
    """Values of ``motion_type`` that are not a primitive's type."""

    STOP_MOTION = 66
    RESET_STOP = 67
    SEQUENCE_START = 100
    SEQUENCE_END = 101


class ExecutionStatus(IntEnum):
    """Status of the primitive or sequence that the hardware took last."""

    IDLE = 0
    EXECUTING = 1
    SUCCESS = 2
    ERROR = 3
    STOPPING = 4
    STOPPED = 5


def commands_of(primitive: MotionPrimitive) -> list[float]:
    q_rad = primitive.q_rad or (NO_COMMAND,) * _JOINTS
    poses = (_numbers(pose) for pose in (primitive.pose_base_tcp, primitive.via_base_tcp))
    rest = (primitive.blend_radius_m, primitive.velocity, primitive.acceleration, primitive.move_time_s)
    return [float(primitive.type), *q_rad, *(number for pose in poses for number in pose), *rest]


def _numbers(pose: Sequence[float]) -> tuple[float, ...]:
    return (*pose[:3], *rotvec_to_quaternion(*pose[3:])) if pose else (NO_COMMAND,) * len(_POSE)


def primitive_of(values: Sequence[float]) -> MotionPrimitive:
    """The primitive that these values of `PRIMITIVE_COMMANDS` describe."""
    return MotionPrimitive(
        PrimitiveType(int(values[0])),
        _without_nan(values[1:7]),
        _pose(values[7:14]),
        _pose(values[14:21]),
        *values[21:],
    )


def _without_nan(values: Sequence[float]) -> tuple[float, ...]:
    return () if any(value != value for value in values) else tuple(values)


def _pose(values: Sequence[float]) -> tuple[float, ...]:
    return (*values[:3], *quaternion_to_rotvec(*values[3:])) if _without_nan(values) else ()


def point_of(primitive: MotionPrimitive) -> TrajectoryPoint:
    """The trajectory point for a primitive. Raises LocalProtocolError."""
    blend_m, v, a = primitive.blend_radius_m, primitive.velocity, primitive.acceleration
    if primitive.type is PrimitiveType.CIRCULAR_CARTESIAN:
        return points.movec(primitive.via_base_tcp, primitive.pose_base_tcp, v=v, a=a, blend_radius_m=blend_m)
    time_s = 0.0
    if primitive.move_time_s > 0.0:
        time_s, v, a = primitive.move_time_s, 1.0, 1.0  # v and a must be above 0, but have no effect
    if primitive.type is PrimitiveType.LINEAR_JOINT:
        return points.movej(primitive.q_rad, v=v, a=a, duration_s=time_s, blend_radius_m=blend_m)
    return points.movel(primitive.pose_base_tcp, v=v, a=a, duration_s=time_s, blend_radius_m=blend_m)


def problem_of(primitive: MotionPrimitive) -> str | None:
    """Why a primitive cannot be executed by any arm; None if it can."""
    targets = {"joint_positions": primitive.q_rad}
    if primitive.type is not PrimitiveType.LINEAR_JOINT:
        targets = {"a pose": primitive.pose_base_tcp}
    if primitive.type is PrimitiveType.CIRCULAR_CARTESIAN:
        targets["a second pose, the via pose,"] = primitive.via_base_tcp
    for name, target in targets.items():
        if len(target) != _JOINTS or not all(map(math.isfinite, target)):
            return f"{primitive.type.name} needs {name} of {_JOINTS} numbers"
    if not 0.0 <= primitive.blend_radius_m < math.inf:
        return f"blend_radius must be 0 m or more, not {primitive.blend_radius_m}"
    if 0.0 < primitive.move_time_s < math.inf and primitive.type is not PrimitiveType.CIRCULAR_CARTESIAN:
        return None
    if 0.0 < primitive.velocity < math.inf and 0.0 < primitive.acceleration < math.inf:
        return None
    circular = primitive.type is PrimitiveType.CIRCULAR_CARTESIAN
    return f"it needs {'' if circular else 'move_time, or '}velocity and acceleration, above 0"


@controller_type("motion_primitives_controllers/MotionPrimitivesForwardController")
class MotionPrimitivesForwardController(GoalController[PrefixParameters]):
    """Lets the robot itself execute moves in joint space, lines and arcs; also during force mode.

    It takes one goal at a time, with one or more primitives. The goal succeeds when the last one has been executed.
    """

    def __init__(self, name: str, parameters: PrefixParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self._queue: deque[list[float]] = deque()
        self._stop_wanted = self._stopping = False

    @property
    def command_interfaces(self) -> tuple[str, ...]:
        return tuple(map(self._name, PRIMITIVE_COMMANDS))

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        return (self._name(STATUS), self._name(READY))

    def _name(self, interface: str) -> str:
        return f"{self.parameters.tf_prefix}{interface}"

    def on_activate(self, time_s: float) -> None:
        self._queue.clear()
        self._stop_wanted = self._stopping = False
        self.commands.fill(NO_COMMAND)

    def on_deactivate(self) -> None:
        self.commands.fill(NO_COMMAND)
        self._abort("Aborting current goal, since the controller is being deactivated.")

    def on_halt(self, reason: str) -> None:
        self._abort(reason)
        self._stop_wanted = True

    def send_goal(self, primitives: Sequence[MotionPrimitive]) -> GoalHandle:
        """Execute primitives, one after the other.

        Raises GoalRejectedError, also while others are under way or are being stopped, and ControllerError.
        """
        self.check_active()
        if self.goal is not None:
            raise self._rejected("motion primitives are under way: wait for their end, or cancel them")
        if self._stop_wanted or self._stopping:
            raise self._rejected("the arm is being stopped: send the goal again when it is at rest")
        self.check(primitives)
        self._queue.extend(_as_commands(primitives))
        return self._accept(tuple(primitives))

    def check(self, primitives: Sequence[MotionPrimitive]) -> None:
        """Check that primitives would be accepted if the controller were active and idle. Raises GoalRejectedError."""
        if not primitives:
            raise self._rejected("it has no motion primitives")
        for number, primitive in enumerate(primitives):
            if problem := problem_of(primitive):
                raise self._rejected(f"primitive {number}: {problem}")

    def cancel(self) -> None:
        """Stop the arm; the goal under way is canceled once the robot has accepted it. Raises ControllerError."""
        self.check_active()
        if self.goal is not None:
            self._stop_wanted = True

    def update(self, time_s: float, period_s: float) -> None:
        status = self.states[self._name(STATUS)]
        if self._stop_wanted:
            self._stop_wanted, self._stopping = False, True
            self._queue.clear()
            self._send_marker(Marker.STOP_MOTION)
        elif not self._is_accepted():
            pass  # the hardware first has to take the values that were set before
        elif self._stopping:
            if status == ExecutionStatus.STOPPED:
                self._send_marker(Marker.RESET_STOP)
                self._stopping = False
                self._cancel_goal()
        elif self._queue:
            if self.states[self._name(READY)] == 1.0:
                self.commands.put(self._queue.popleft())
        elif self.goal is not None:
            self._conclude(status)

    def _is_accepted(self) -> bool:
        kind = self.commands[self._name(_TYPE)]
        return kind != kind

    def _send_marker(self, marker: Marker) -> None:
        self.commands.put(_marker(marker))

    def _conclude(self, status: float) -> None:
        """Handle the status once the hardware has taken the whole goal, which the status then refers to."""
        if status == ExecutionStatus.SUCCESS and self.goal is not None:
            self.goal.succeed("Motion primitives executed successfully")
        elif status == ExecutionStatus.ERROR:
            self._abort("The robot did not execute all of the motion primitives: the log says why.")

    def _abort(self, reason: str) -> None:
        self._queue.clear()
        self._abort_goal(reason)


def _as_commands(primitives: Sequence[MotionPrimitive]) -> Iterator[list[float]]:
    if len(primitives) == 1:
        yield commands_of(primitives[0])
        return
    yield _marker(Marker.SEQUENCE_START)
    yield from map(commands_of, primitives)
    yield _marker(Marker.SEQUENCE_END)


def _marker(marker: Marker) -> list[float]:
    return [float(marker), *(NO_COMMAND,) * (len(PRIMITIVE_COMMANDS) - 1)]
