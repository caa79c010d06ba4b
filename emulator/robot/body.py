"""The arm as a rigid-body system: torques in, motion out, in steps much shorter than a control period.

Friction is Coulomb and viscous. Coulomb friction rises over a narrow band of speeds instead of jumping at zero; the
band is as wide as explicit integration requires. A loaded joint without brake therefore creeps, by less than a degree
or so per second. The brakes slow each joint by its friction disc until all are slow; then the arm is locked.
"""

from collections.abc import Sequence
from typing import Final

from urproto.robots import RobotModel
from urproto.robots.measured import drivetrain_of
from urproto.vectors import ZERO6, Vector6, as_six

STEP_S: Final = 0.001  # well within the stability limit of explicit integration for every arm
_BAND: Final = 2.0  # width for Coulomb friction, in steps that it takes to stop a rotor
_NARROWEST: Final = 1e-6  # rad/s; a joint may have no Coulomb friction
# Torque of a brake as a fraction of the joint's torque limit. Fitted to the user manuals of UR5 and UR3, category 0
# stops from 183 degrees/s, stretched out with full payload (appendix A); base, shoulder and elbow: UR5 0.31, 0.70,
# 0.22 rad, here 0.30, 0.65, 0.12; UR3 0.18, 0.20, 0.15 rad, here 0.17, 0.34, 0.11
_BRAKE_SHARE: Final = 0.8
_LOCKED_RAD_S: Final = 0.2  # once all joints are slower than this, the brakes' pins hold (guess)
_QUIET_RAD_S: Final = 1e-7  # slower than this for two periods counts as rest


class Body:
    """True joint angles and speeds [rad, rad/s] of one arm with its true payload.

    ``dynamics``: of the true payload and gravity. ``smooth``: without friction.
    """

    def __init__(self, model: RobotModel, *, smooth: bool = False) -> None:
        from urproto.robots.dynamics import Dynamics  # Pinocchio: only dynamic arms need it here

        drives = drivetrain_of(model)
        self.dynamics = Dynamics(model)
        self.dynamics.set_rotor_inertia(drives.rotor_kg_m2)
        self.rotors: Vector6 = drives.rotor_kg_m2
        self.coulomb: Vector6 = ZERO6 if smooth else drives.coulomb_Nm
        self.viscous: Vector6 = ZERO6 if smooth else drives.viscous_Nm_s
        self.q: Vector6 = ZERO6
        self.qd: Vector6 = ZERO6
        self.brakeless: set[int] = set()  # joints whose brake does not hold
        slowing = zip(drives.coulomb_Nm, drives.rotor_kg_m2, strict=True)
        self._bands = as_six([max(_NARROWEST, _BAND * STEP_S * torque / rotor) for torque, rotor in slowing])
        self._brakes = as_six([_BRAKE_SHARE * torque for torque in model.torque_max])
        self._brake_gain = as_six([rotor / STEP_S for rotor in drives.rotor_kg_m2])

    @property
    def creep_damping(self) -> Vector6:
        """Damping added by Coulomb friction in joints that hardly move [Nm s/rad]."""
        return as_six([dry / band for dry, band in zip(self.coulomb, self._bands, strict=True)])

    @property
    def standing(self) -> bool:
        return self.qd == ZERO6

    def place(self, q: Vector6) -> None:
        """Place the arm at q, at rest."""
        self.q, self.qd = q, ZERO6

    def friction_parts(self, qd: Sequence[float]) -> tuple[list[float], list[float]]:
        """Viscous and Coulomb friction torques [Nm] at these speeds, which they oppose."""
        slow = zip(qd, self.coulomb, self._bands, strict=True)
        return (
            [viscous * speed for speed, viscous in zip(qd, self.viscous, strict=True)],
            [coulomb * (1.0 if v > band else -1.0 if v < -band else v / band) for v, coulomb, band in slow],
        )

    @property
    def friction_power(self) -> Vector6:
        """Heat of friction in each joint [W]."""
        viscous, coulomb = self.friction_parts(self.qd)
        return as_six([(a + b) * speed for a, b, speed in zip(viscous, coulomb, self.qd, strict=True)])

    def step(self, torque: Sequence[float], external: Sequence[float], h: float) -> None:
        """Advance by ``h`` [s] with motor torques and the torques that external forces exert on the joints [Nm]."""
        # friction_parts() inlined, because this is the innermost loop
        total = [
            motor + outside - viscous * v - (dry if v > band else -dry if v < -band else dry * v / band)
            for motor, outside, v, viscous, dry, band in zip(
                torque, external, self.qd, self.viscous, self.coulomb, self._bands, strict=True
            )
        ]
        qdd = self.dynamics.forward_dynamics(self.q, self.qd, total)
        self.qd = qd = _onwards(self.qd, qdd, h)
        self.q = _onwards(self.q, qd, h)

    def brake(self, external: Sequence[float], h: float) -> None:
        """Advance by ``h`` with the brakes engaged. An arm at rest stays there, unless a brake does not hold."""
        if not self.brakeless:
            if self.standing:
                return
            if max(map(abs, self.qd)) < _LOCKED_RAD_S:
                self.qd = ZERO6
                return
        held = [
            0.0 if joint in self.brakeless else -min(most, max(-most, gain * speed))
            for joint, (speed, most, gain) in enumerate(zip(self.qd, self._brakes, self._brake_gain, strict=True))
        ]
        self.step(held, external, h)

    def settle(self, before: Vector6) -> None:
        """Set the speeds to 0 if they are negligible and were so a period ago (``before``)."""
        if max(map(abs, self.qd)) < _QUIET_RAD_S and max(map(abs, before)) < _QUIET_RAD_S:
            self.qd = ZERO6


def _onwards(now: Vector6, rate: Vector6, h: float) -> Vector6:
    a, b, c, d, e, f = now
    u, v, w, x, y, z = rate
    return (a + h * u, b + h * v, c + h * w, d + h * x, e + h * y, f + h * z)
