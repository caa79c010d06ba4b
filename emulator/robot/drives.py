"""The drives of a dynamic arm: per joint a position loop around a speed loop, with feed-forward, around the body.

    commanded speed = target speed + stiffness / damping * (target - angle)
    torque          = feed-forward + damping * (commanded speed - speed) + integral, within the joint's torque limit
    integral        = integral gain * sum of (target - angle)

The feed-forward is the torque of the target motion according to the controller's model: rigid-body torques with the
payload set by the program, the rotors, and the controller's friction model, which can be seen in a real controller's
target currents (``urproto.robots.measured``). Anything else (a wrong payload, a push, different friction) first causes
a deviation, until the integral part compensates it. The loops run every millisecond; within a control period, the
target moves with constant acceleration.

Anti-windup: far from its target, a joint is commanded no more speed than it can lose on the way, and does not
integrate, so that an overload ends without oscillation. The integral is also frozen while the torque is saturated, and
it is bounded. It is reset as soon as something else moves the arm: brakes, direct torque, or a jump to another place.

The gains are those of a real arm's drives (``urproto.robots.measured.loops``).
"""

from dataclasses import dataclass
from math import copysign, sqrt
from typing import Final

from emulator.robot.body import STEP_S, Body
from urproto.robots import RobotModel
from urproto.robots.measured import drivetrain_of, loops
from urproto.vectors import ZERO6, Vector6, add, as_six, rate, sub

# fractions of friction that direct torque compensates: defaults of the official drivers' friction model parameters
VISCOUS_SHARE: Final[Vector6] = (0.9, 0.9, 0.8, 0.9, 0.9, 0.9)
COULOMB_SHARE: Final[Vector6] = (0.8, 0.8, 0.7, 0.8, 0.8, 0.8)
# Bound of an integral part. Measured on a UR5 (below): currents of base and shoulder stay within 4 A of their targets,
# however large the deviation or the push. Elbow: the same; wrists: guess
_MAX_HELD_A: Final[Vector6] = (4.0, 4.0, 4.0, 2.0, 2.0, 2.0)
# An arm that is (almost) at rest and whose target is at rest has an integral gain as high as friction allows. Measured
# on a UR5 that is pushed at rest: 2 MNm/(rad s) in base, shoulder and elbow, ten times the gain in motion, and 0.3 to
# 0.9 in the wrists; here 0.7, 0.6, 1.2 and 0.8 to 1.4
_STILL_RAD_S: Final = 0.005  # guess
_SLIGHT_RAD: Final = 3e-4  # beyond this deviation, the usual gains apply (guess)
_STIFFEST: Final = 0.35  # of the integral gain at which a joint with its largest inertia would oscillate (guess)
_SPARE: Final = 0.25  # of the torque limit is a reserve for braking, for a joint with its largest inertia (guess)
_PLACED: Final = 2.0  # times the highest speed: a faster target means that the arm has been placed elsewhere
_FULL_PAYLOAD_COG: Final = (0.0, 0.0, 0.1)  # m, for the gains (guess)
# configurations with the largest inertia of each joint: stretched out, and with the wrists bent either way
_STRETCHED: Final = (
    ZERO6,
    (0.0, 0.0, 0.0, 1.57, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 1.57, 0.0),
    (0.0, 0.0, 0.0, 1.57, 1.57, 0.0),
)


@dataclass(frozen=True, slots=True)
class TorqueCommand:
    """Torques [Nm] in addition to gravity compensation, and the fraction of each kind of friction to compensate."""

    torque: Vector6
    viscous_scale: Vector6 = ZERO6
    coulomb_scale: Vector6 = ZERO6


class Drives:
    """The drives of one arm. ``body``: the rigid-body system they move; it stands where it was placed until driven.

    ``torque``: of the motors, mean of the last period [Nm, at the joint]. ``feedforward``: the part of it that the
    controller expected. ``asleep``: nothing moved in the last period.
    """

    def __init__(self, model: RobotModel) -> None:
        self.body = Body(model)
        drivetrain = drivetrain_of(model)
        self._known_friction = drivetrain.known_friction
        self.torque: Vector6 = ZERO6
        self.feedforward: Vector6 = ZERO6
        self.asleep = False
        self._limits = model.torque_max
        heaviest = _largest_inertia(model)
        gains = loops()
        position = [k / d for k, d in zip(gains.stiffness_1_s2, gains.damping_1_s, strict=True)]
        damping = [gain * inertia for gain, inertia in zip(gains.damping_1_s, heaviest, strict=True)]
        self._integral = [STEP_S * gain * inertia for gain, inertia in zip(gains.integral_1_s3, heaviest, strict=True)]
        self._integral_at_rest = [
            STEP_S * max(usual * inertia, _STIFFEST * (damping + friction) * stiffness)
            for usual, inertia, damping, friction, stiffness in zip(
                gains.integral_1_s3, heaviest, damping, self.body.creep_damping, gains.stiffness_1_s2, strict=True
            )
        ]
        spare = [_SPARE * torque / inertia for torque, inertia in zip(model.torque_max, heaviest, strict=True)]
        near = [rate / gain**2 for rate, gain in zip(spare, position, strict=True)]
        most_held = [a * k for a, k in zip(_MAX_HELD_A, drivetrain.torque_constants_Nm_A, strict=True)]
        self._gains = (position, damping, near, model.qd_max, model.torque_max, most_held)
        self._integral_torque = [0.0] * 6  # torques of the integral parts
        self._placed = False  # the arm was placed, so the integral parts have yet to be initialised
        self._placed_rad_s = _PLACED * max(model.qd_max)
        self._target: Vector6 = ZERO6
        self._speed: Vector6 = ZERO6  # of the target
        self._last_inputs: tuple[object, ...] = ()

    def place(self, q: Vector6) -> None:
        """Place the arm and its target at q, as if it had been at rest there for a long time."""
        self.body.place(q)
        self._target, self._speed = q, ZERO6
        self._placed = True

    def set_brake(self, joint: int, *, holds: bool) -> None:
        """Set whether the brake of a joint (0-5) holds."""
        if holds:
            self.body.brakeless.discard(joint)
        else:
            self.body.brakeless.add(joint)
        self.asleep = False

    def wake(self) -> None:
        """Something about the body has changed: check again whether it is in equilibrium."""
        self._last_inputs = ()

    def follow(self, target: Vector6, known_torque: Vector6, external: Vector6, period_s: float) -> None:
        """Advance one control period towards ``target``. ``known_torque``: rigid-body torques of the target motion.

        ``external``: joint torques of external forces [Nm].
        """
        start, before = self._target, self._speed
        speed = self._retarget(target, period_s)
        if speed is None:
            start, before, speed = target, ZERO6, ZERO6
        change = sub(speed, before)
        self.feedforward = expected = self._expected(known_torque, speed, change, period_s)
        if self._unchanged(target, expected, external) and self.body.standing and speed == before == ZERO6:
            self.asleep = True
            return
        self.asleep = False
        if self._placed:
            self._placed = False
            self._integral_torque = list(sub(sub(self.body.dynamics.gravity_torques(target), known_torque), external))
        self._servo(start, before, change, expected, external, period_s)

    def apply_torque(
        self, target: Vector6, command: TorqueCommand, gravity: Vector6, external: Vector6, period_s: float
    ) -> None:
        """Advance one control period of direct torque plus ``gravity``. ``target``: the reported target angles."""
        self._retarget(target, period_s)
        self._reset_loops()
        body, torques = self.body, []
        self.asleep = False
        self.feedforward = wanted = add(command.torque, gravity)
        for _ in range(_steps(period_s)):
            viscous, coulomb = body.friction_parts(body.qd)
            torque = [
                max(-limit, min(limit, base + share * v + part * c))
                for base, share, v, part, c, limit in zip(
                    wanted, command.viscous_scale, viscous, command.coulomb_scale, coulomb, self._limits, strict=True
                )
            ]
            body.step(torque, external, STEP_S)
            torques.append(torque)
        self.torque = _mean(torques)

    def hold(self, target: Vector6, external: Vector6, period_s: float) -> None:
        """Advance one control period without power: the brakes bring the arm to rest and hold it."""
        self._retarget(target, period_s)
        self._reset_loops()
        self.torque = self.feedforward = ZERO6
        self.asleep = self.body.standing and not self.body.brakeless
        for _ in range(0 if self.asleep else _steps(period_s)):
            self.body.brake(external, STEP_S)

    def _reset_loops(self) -> None:
        """Reset the loops: something else moves the arm now."""
        self._integral_torque, self._placed = [0.0] * 6, False

    def _retarget(self, target: Vector6, period_s: float) -> Vector6 | None:
        """Speed of the target in this period; None if target and arm have been placed elsewhere."""
        if target == self._target:
            self._speed = ZERO6
            return ZERO6
        speed = rate(target, self._target, period_s)
        if max(map(abs, speed)) > self._placed_rad_s:
            self.place(target)
            return None
        self._target, self._speed = target, speed
        return speed

    def _expected(self, rigid: Vector6, speed: Vector6, change: Vector6, period_s: float) -> Vector6:
        friction = self._known_friction(speed)
        a, b, c, d, e, f = [
            torque + rotor * gain / period_s + loss
            for torque, rotor, gain, loss in zip(rigid, self.body.rotors, change, friction, strict=True)
        ]
        return (a, b, c, d, e, f)

    def _unchanged(self, *inputs: object) -> bool:
        before, self._last_inputs = self._last_inputs, inputs
        return inputs == before

    def _servo(
        self, start: Vector6, before: Vector6, change: Vector6, expected: Vector6, external: Vector6, period_s: float
    ) -> None:
        """Run the loops: the target moves from ``start`` at speed ``before + change * (1/2 + u)``, u: 0 to 1."""
        body, steps, at_rest, torques = self.body, _steps(period_s), self.body.qd, []
        standing = change == before == ZERO6
        held_still = standing and max(map(abs, at_rest)) < _STILL_RAD_S
        usual = self._integral
        integrals = (usual, self._integral_at_rest if held_still else usual)
        joints = list(zip(start, before, change, expected, *self._gains, *integrals, strict=True))
        for k in range(steps):
            t, u = k * STEP_S, k / steps
            torque, held = [], []
            for (p, w, dw, known, gain, damping, near, most, limit, bound, growth, hold), q, qd, sum_ in zip(
                joints, body.q, body.qd, self._integral_torque, strict=True
            ):
                speed, grown = w + (u + 0.5) * dw, sum_
                error = p + t * (w + 0.5 * (u + 1.0) * dw) - q
                if -near < error < near:
                    speed += gain * error
                    grown += (hold if -_SLIGHT_RAD < error < _SLIGHT_RAD else growth) * error
                else:
                    speed = _approach_speed(error, speed, gain, near, most)
                    if held_still:
                        grown += copysign(growth * near, error)
                if not -bound < grown < bound:
                    grown = copysign(bound, grown)
                force = known + grown + damping * (speed - qd)
                if -limit < force < limit:
                    torque.append(force)
                    held.append(grown)
                else:
                    torque.append(limit if force > 0.0 else -limit)
                    held.append(sum_)
            self._integral_torque = held
            body.step(torque, external, STEP_S)
            torques.append(torque)
        self.torque = _mean(torques)
        if standing:
            body.settle(at_rest)


def _steps(period_s: float) -> int:
    return round(period_s / STEP_S)


def _mean(torques: list[list[float]]) -> Vector6:
    a, b, c, d, e, f = (sum(torque) / len(torques) for torque in zip(*torques, strict=True))
    return (a, b, c, d, e, f)


def _approach_speed(error: float, speed: float, gain: float, near: float, most: float) -> float:
    """Commanded speed, within the joint's limit, if the target, moving at ``speed``, is farther than ``near``."""
    more = gain * sqrt(2.0 * near * (abs(error) - 0.5 * near))
    return max(-most, min(most, speed + copysign(more, error)))


def _largest_inertia(model: RobotModel) -> Vector6:
    """Largest inertia [kg m2] of each joint."""
    body = Body(model)
    body.dynamics.set_payload(model.payload_max_kg, _FULL_PAYLOAD_COG)
    diagonals = [[row[i] for i, row in enumerate(body.dynamics.mass_matrix(q))] for q in _STRETCHED]
    return as_six(max(inertia) for inertia in zip(*diagonals, strict=True))
