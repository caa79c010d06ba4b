"""Speeds of an arm while a button is held: ramps, and lower speeds near a joint limit or a singularity.

Nothing here waits or communicates with a robot. The mover calls `Ramp.next` once per period to get the speeds of the
next period.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf, sqrt
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from urproto.joints import JOINT_TITLES
from urproto.robots import Joints, Kinematics

_JOINT_RAMP: Final = (1.4, 4.0)  # rad/s2, up and down: URScript's default, and the control program's own when it ends
_LINE_RAMP: Final = (1.2, 2.5)  # m/s2: URScript's default for tools; guess for the way down
_TURN_RAMP: Final = (1.4, 4.0)  # rad/s2
_LIMIT_DECELERATION: Final = 1.0  # rad/s2 towards a limit: gentler than the ramp down, which then keeps up with it
_MARGIN_RAD: Final = 0.004  # kept from a limit
_REACTION_S: Final = 0.08  # guess: between a measured state and the arm's reaction to it, under load
_TOOL_SPEED_SHARE: Final = 0.5  # of a joint's maximum speed, for tool motions (guess)
_MAX_ERROR: Final = 0.04  # share of a tool's motion that joints cannot follow; above it the arm rests (guess)
_MAX_DECAY: Final = 3.0  # 1/s: of the Jacobian's determinant, so that a singularity is never reached (guess)
_LOOKAHEAD_S: Final = 0.01
_SINGULAR: Final = 1e-9  # m3
_DAMPING: Final = 1e-3  # m or 1: singular values of the Jacobian below this count as zero
_SLOWED_SHARE: Final = 0.98  # a lower share of the requested speed counts as slowed


@dataclass(frozen=True, slots=True)
class Velocity:
    """Speeds of the joints (6,) [rad/s], or of the TCP in the base frame (6,) [m/s, rad/s]."""

    space: Literal["joints", "tool"]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Bounds:
    """The limits of an arm: joint angles (6,) [rad], infinite for a joint without limits, and top speeds [rad/s].

    kinematics: None for an arm with unknown geometry; then speeds are reduced only near joint limits.
    """

    q_min: Joints
    q_max: Joints
    qd_max: Joints
    kinematics: Kinematics | None = None


class Ramp:
    """Ramps speeds up from rest and down to rest. speeds: the present ones. slowed: why they are below the request."""

    def __init__(self, space: Literal["joints", "tool"], bounds: Bounds) -> None:
        self._space = space
        self._bounds = bounds
        self.speeds: tuple[float, ...] = (0.0,) * 6
        self.slowed = ""

    @property
    def at_rest(self) -> bool:
        return not any(self.speeds)

    def next(
        self, target: Sequence[float] | None, q_rad: Sequence[float], pose_base_tcp: Sequence[float], period_s: float
    ) -> tuple[float, ...]:
        """The speeds for the next period. target: None to come to rest."""
        self.slowed = ""
        goal = tuple(target or (0.0,) * 6)
        if self._space == "joints":
            self.speeds = tuple(
                self._allowed_speed(
                    i, _ramp_speed(now, self._allowed_speed(i, goal_speed, q_rad), _JOINT_RAMP, period_s), q_rad
                )
                for i, (now, goal_speed) in enumerate(zip(self.speeds, goal, strict=True))
            )
        else:
            self.speeds = self._feasible_twist(_ramp_twist(self.speeds, goal, period_s), q_rad, pose_base_tcp)
        return self.speeds

    def _allowed_speed(self, joint: int, speed: float, q_rad: Sequence[float]) -> float:
        """Limit a speed to the joint's maximum and to the speed from which it can brake before its limit."""
        bounds = self._bounds
        max_speed = min(self._braking_speed(joint, speed, q_rad), bounds.qd_max[joint])
        if max_speed < _SLOWED_SHARE * abs(speed):
            self.slowed = f"{JOINT_TITLES[joint]} nears its limit"
        return max(-max_speed, min(max_speed, speed))

    def _braking_speed(self, joint: int, speed: float, q_rad: Sequence[float]) -> float:
        bounds = self._bounds
        left = bounds.q_max[joint] - q_rad[joint] if speed > 0 else q_rad[joint] - bounds.q_min[joint]
        distance = max(0.0, left - _MARGIN_RAD)
        if distance == inf:
            return inf
        # v with way = v delay + v^2 / 2a
        reaction_speed = _LIMIT_DECELERATION * _REACTION_S
        return sqrt(reaction_speed * reaction_speed + 2.0 * _LIMIT_DECELERATION * distance) - reaction_speed

    def _feasible_twist(
        self, twist: Sequence[float], q_rad: Sequence[float], pose: Sequence[float]
    ) -> tuple[float, ...]:
        """Scale a twist of the tool down to what the joints can follow."""
        kinematics = self._bounds.kinematics
        if kinematics is None or not any(twist):
            return tuple(twist)
        jacobian = np.array(kinematics.jacobian_at(q_rad, pose))
        qd, error = _joint_speeds(jacobian, twist)
        scale = max(0.0, 1.0 - error / _MAX_ERROR)
        ahead = [angle + _LOOKAHEAD_S * speed for angle, speed in zip(q_rad, qd, strict=True)]
        later = kinematics.jacobian_at(ahead, [a + _LOOKAHEAD_S * b for a, b in zip(pose, twist, strict=True)])
        now = float(np.linalg.det(jacobian))
        decay = (1.0 - float(np.linalg.det(later)) / now) / _LOOKAHEAD_S if abs(now) > _SINGULAR else 0.0
        scale = min(scale, _MAX_DECAY / max(decay, _MAX_DECAY))
        if scale < _SLOWED_SHARE:
            self.slowed = "Near a singularity: the joints cannot follow this direction"
        for joint, speed in enumerate(qd):
            max_speed = min(self._braking_speed(joint, speed, q_rad), _TOOL_SPEED_SHARE * self._bounds.qd_max[joint])
            if abs(speed) * scale > max_speed:
                scale = max_speed / abs(speed)
                at_limit = max_speed < _TOOL_SPEED_SHARE * self._bounds.qd_max[joint]
                self.slowed = (
                    f"{JOINT_TITLES[joint]} nears its limit" if at_limit else f"{JOINT_TITLES[joint]} turns fast here"
                )
        return tuple(scale * value for value in twist)


def _ramp_speed(now: float, goal: float, ramp: tuple[float, float], period_s: float) -> float:
    """The next speed: up or down a ramp, and through zero when the direction changes."""
    if now * goal < 0:
        goal = 0.0
    step = ramp[0 if abs(goal) > abs(now) else 1] * period_s
    return now + max(-step, min(step, goal - now))


def _ramp_twist(now: Sequence[float], goal: Sequence[float], period_s: float) -> tuple[float, ...]:
    """Ramp a twist; its linear and angular parts each keep their direction."""
    return (
        *_ramp_vector(now[:3], goal[:3], _LINE_RAMP, period_s),
        *_ramp_vector(now[3:], goal[3:], _TURN_RAMP, period_s),
    )


def _ramp_vector(
    now: Sequence[float], goal: Sequence[float], ramp: tuple[float, float], period_s: float
) -> tuple[float, ...]:
    difference = [end - start for start, end in zip(now, goal, strict=True)]
    step = ramp[0 if hypot(*goal) > hypot(*now) else 1] * period_s
    length = hypot(*difference)
    return (
        tuple(goal)
        if length <= step
        else tuple(start + step / length * part for start, part in zip(now, difference, strict=True))
    )


def _joint_speeds(jacobian: npt.NDArray[np.float64], twist: Sequence[float]) -> tuple[tuple[float, ...], float]:
    """Joint speeds that come closest to a twist of the tool, and the relative error that remains.

    Damped least squares: qd = Jt (J Jt + d^2)^-1 v, so speeds stay finite in singularities.
    """
    damped = jacobian @ jacobian.T + _DAMPING * _DAMPING * np.eye(6)
    qd = jacobian.T @ np.linalg.solve(damped, twist)
    return tuple(qd.tolist()), float(np.linalg.norm(twist - jacobian @ qd)) / hypot(*twist)
