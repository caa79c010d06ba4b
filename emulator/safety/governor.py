"""Keeps movements along a path below the safety limits by slowing them down, so that the safety system need not act.

A controller keeps a margin from each limit: 150 mm/s for speeds (CB3 manual, tolerances), 0.2 rad/s for joint speeds
and 3 degrees for joint positions (the difference between the factory's limits and the nominal ones). That the same
applies to e-Series, and that the margin of momentum is its tolerance, are guesses.
"""

from dataclasses import replace
from math import dist, hypot, inf, radians, sqrt
from typing import Final

from emulator.robot.arm import Arm
from emulator.robot.motion_bounds import radii
from urproto.robots.model import Joints, RobotModel
from urproto.robots.pose import Pose
from urproto.vectors import as_six, largest, lerp
from urscript.polyscope.safety_configuration import LimitSet

TRANSITION_S: Final = 0.5  # hardware manuals: both sets of limits are accepted for this time
MANUAL_SPEED_M_S: Final = 0.25  # user manual: manual mode, unless high speed is allowed
_SPEED_MARGIN_M_S: Final = 0.15
_JOINT_SPEED_MARGIN_RAD_S: Final = 0.2
_POSITION_MARGIN_RAD: Final = radians(3.0)
_MOMENTUM_MARGIN: Final = 3.0
_TURNING_M_S: Final = 0.02  # upper bound for the change of any part's speed by the links' rotation within a period
_MIN_SHARE: Final = 0.2  # of a limit remains even if the margin is larger (guess)


class Governor:
    """Calculates by how much a step of one period would exceed the limits.

    ``excess`` is called by the motion's pacer, for steps along a path only: streamed targets set their own pace.
    """

    def __init__(self, model: RobotModel, arm: Arm, period_s: float, limits: LimitSet) -> None:
        self._arm = arm
        self._model = model
        self._period = period_s
        self._deceleration = min(model.qdd_max)
        self._mass = sum(link.mass_kg for link in model.links) + model.payload_max_kg
        self._own_levers = sum(radii(model))
        self._tcp_offset: Pose | None = None
        self._levers = 0.0  # of all joints to the TCP
        self.use(limits)

    def watch(self, arm: Arm) -> None:
        self._arm = arm

    def use(self, limits: LimitSet) -> None:
        """Set other limits; the pacer slows the path down to them as quickly as the joints can."""
        self._limits = operational(limits)
        self._slowest = min(self._limits.joint_speed)

    def excess(self, q: Joints, step: Joints) -> float:
        """The largest ratio of a value to its limit in this step; up to 1 is permitted, and such values may be low."""
        limits, arm, period = self._limits, self._arm, self._period
        fastest = largest(step) / period
        time = fastest / self._deceleration  # duration of a stop
        share = time / limits.stopping_time
        if fastest > self._slowest:
            speeds = [abs(move) / period for move in step]
            share = max(share, *(speed / most for speed, most in zip(speeds, limits.joint_speed, strict=True)))
        if arm.tcp_offset is not self._tcp_offset:
            self._tcp_offset = arm.tcp_offset
            self._levers = self._own_levers + len(step) * hypot(*arm.tcp_offset[:3])
        change = self._levers * largest(lerp(step, arm.qd, -period)) / period
        if self._near_a_limit(change, time):
            share = max(share, self._exact(q, step, time))
        return share

    def _near_a_limit(self, change: float, time: float) -> bool:
        """Whether an exact check is needed: no part of the arm changes its speed by more than ``change`` [m/s]."""
        limits, arm = self._limits, self._arm
        speed = min(limits.tcp_speed, limits.elbow_speed, 2.0 * limits.stopping_distance / time if time else inf)
        change += _TURNING_M_S
        if arm.certainly_below(speed - change, limits.momentum - change * self._mass):
            return False
        u, v, w, *_ = arm.tcp_speed
        x, y, z = arm.elbow_velocity
        most = sqrt(max(u * u + v * v + w * w, x * x + y * y + z * z)) + change
        return (
            most > min(limits.tcp_speed, limits.elbow_speed)
            or arm.efforts.momentum + change * self._mass > limits.momentum
            or 0.5 * most * time > limits.stopping_distance
        )

    def _exact(self, q: Joints, step: Joints, time: float) -> float:
        limits, arm, period = self._limits, self._arm, self._period
        target = tuple(now + move for now, move in zip(q, step, strict=True))
        tool = dist(arm.kinematics.forward(q, arm.tcp_offset)[:3], arm.kinematics.forward(target, arm.tcp_offset)[:3])
        elbow = dist(*(arm.kinematics.elbow_position(place, arm.model.elbow_offset) for place in (q, target)))
        qd = tuple(move / period for move in step)
        # the stopping distance grows with the square of the speed
        length = sqrt(0.5 * max(tool, elbow) / period * time / limits.stopping_distance)
        momentum = arm.dynamics.linear_momentum(q, qd) / limits.momentum
        speeds = max(tool / period / limits.tcp_speed, elbow / period / limits.elbow_speed)
        return max(speeds, momentum, length)


def operational(limits: LimitSet) -> LimitSet:
    """The limits that a controller itself keeps, given those of the safety system."""
    return replace(
        limits,
        tcp_speed=_less(limits.tcp_speed, _SPEED_MARGIN_M_S),
        elbow_speed=_less(limits.elbow_speed, _SPEED_MARGIN_M_S),
        momentum=_less(limits.momentum, _MOMENTUM_MARGIN),
        joint_speed=as_six(_less(speed, _JOINT_SPEED_MARGIN_RAD_S) for speed in limits.joint_speed),
    )


def manual_limits(limits: LimitSet) -> LimitSet:
    """Limits under which a controller moves the tool and the elbow at 250 mm/s at most."""
    speed = MANUAL_SPEED_M_S + _SPEED_MARGIN_M_S
    return replace(limits, tcp_speed=min(limits.tcp_speed, speed), elbow_speed=min(limits.elbow_speed, speed))


def operational_positions(limits: LimitSet, model: RobotModel) -> tuple[Joints, Joints]:
    """Permitted joint positions: the limits with a margin, or the arm's own range where that is not wider."""
    low, high = model.position_limits
    return (
        as_six(
            own if limit <= own + 1e-6 else limit + _POSITION_MARGIN_RAD
            for limit, own in zip(limits.joint_min, low, strict=True)
        ),
        as_six(
            own if limit >= own - 1e-6 else limit - _POSITION_MARGIN_RAD
            for limit, own in zip(limits.joint_max, high, strict=True)
        ),
    )


def _less(limit: float, margin: float) -> float:
    return max(limit - margin, _MIN_SHARE * limit)
