"""Keeps movements along a path below the limits, as a controller does: they slow down, the safety system never acts.

A controller keeps a margin to each limit: 150 mm/s to speeds (CB3 manual, tolerances), 0.2 rad/s to joint speeds and
3 degrees to joint positions (what the factory's limits are over the nominal ones). That these hold on e-Series and
that the momentum's is its tolerance are guesses.
"""

from dataclasses import replace
from math import dist, hypot, radians, sqrt
from typing import Final

from emulator.robot.arm import Arm
from urproto.robots.model import Joints, RobotModel
from urproto.vectors import as_six, largest, lerp
from urscript.polyscope.safety_configuration import LimitSet

TRANSITION_S: Final = 0.5  # hardware manuals: for so long both sets of limits are accepted
MANUAL_SPEED_M_S: Final = 0.25  # user manual: manual mode, unless high speed is allowed
_SPEED_MARGIN_M_S: Final = 0.15
_JOINT_SPEED_MARGIN_RAD_S: Final = 0.2
_POSITION_MARGIN_RAD: Final = radians(3.0)
_MOMENTUM_MARGIN: Final = 3.0
_TURNING_M_S: Final = 0.02  # more than a period's turning of the links adds to the speed of any part
_LEAST_SHARE: Final = 0.2  # of a limit is left where the margin would take more (guess)


class Governor:
    """How much too fast a step of one period would be.

    ``excess`` is called by the motion's pacer, for steps along a path only: streamed targets set their own pace.
    """

    def __init__(self, model: RobotModel, arm: Arm, period_s: float, limits: LimitSet) -> None:
        self._arm = arm
        self._model = model
        self._period = period_s
        self._deceleration = min(model.qdd_max)
        self._mass = sum(link.mass_kg for link in model.links) + model.payload_max_kg
        self._levers = sum(_radii(model))
        self.use(limits)

    def watch(self, arm: Arm) -> None:
        """Another arm is the one that moves."""
        self._arm = arm

    def use(self, limits: LimitSet) -> None:
        """Other limits are in force; the pacer slows the path down to them as quickly as the joints may."""
        self._limits = operational(limits)
        self._slowest = min(self._limits.joint_speed)

    def excess(self, q: Joints, step: Joints) -> float:
        """The largest share of a limit that the step takes; 1 and less is allowed, and perhaps less than that."""
        limits, arm, period = self._limits, self._arm, self._period
        fastest = largest(step) / period
        time = fastest / self._deceleration  # that a stop takes
        share = time / limits.stopping_time
        if fastest > self._slowest:
            speeds = [abs(move) / period for move in step]
            share = max(share, *(speed / most for speed, most in zip(speeds, limits.joint_speed, strict=True)))
        x, y, z, *_ = arm.tcp_offset
        levers = self._levers + len(step) * sqrt(x * x + y * y + z * z)
        change = levers * largest(lerp(step, arm.qd, -period)) / period
        if self._near_a_limit(change, time):
            share = max(share, self._exact(q, step, time))
        return share

    def _near_a_limit(self, change: float, time: float) -> bool:
        """Whether looking closely is worth it: no part of the arm changes its speed by more than ``change`` [m/s]."""
        limits, arm = self._limits, self._arm
        u, v, w, *_ = arm.tcp_speed
        x, y, z = arm.elbow_velocity
        most = sqrt(max(u * u + v * v + w * w, x * x + y * y + z * z)) + change + _TURNING_M_S
        return (
            most > min(limits.tcp_speed, limits.elbow_speed)
            or arm.momentum + (change + _TURNING_M_S) * self._mass > limits.momentum
            or 0.5 * most * time > limits.stopping_distance
        )

    def _exact(self, q: Joints, step: Joints, time: float) -> float:
        limits, arm, period = self._limits, self._arm, self._period
        target = tuple(now + move for now, move in zip(q, step, strict=True))
        tool = dist(arm.kinematics.forward(q, arm.tcp_offset)[:3], arm.kinematics.forward(target, arm.tcp_offset)[:3])
        elbow = dist(arm.kinematics.elbow_position(q), arm.kinematics.elbow_position(target))
        qd = tuple(move / period for move in step)
        # a stop's length grows with the square of the speed
        length = sqrt(0.5 * max(tool, elbow) / period * time / limits.stopping_distance)
        momentum = arm.dynamics.linear_momentum(q, qd) / limits.momentum
        speeds = max(tool / period / limits.tcp_speed, elbow / period / limits.elbow_speed)
        return max(speeds, momentum, length)


def operational(limits: LimitSet) -> LimitSet:
    """What a controller aims at, given the limits of the safety system."""
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
    """Where joints may move: inside the limits by a margin; the arm's own range where that is no wider."""
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
    return max(limit - margin, _LEAST_SHARE * limit)


def _radii(model: RobotModel) -> Joints:
    """At most this far from the axis of each joint is any part of the arm behind it [m]."""
    dh = model.dh
    lengths = [hypot(a, d) for a, d in zip(dh.a, dh.d, strict=True)]
    return as_six(sum(lengths[max(joint, 1) :]) for joint in range(6))
