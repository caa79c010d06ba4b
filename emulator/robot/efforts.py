"""Torques [Nm], currents [A] and momentum [kg m/s] of the arm in one control period.

own_torque: to move and hold the arm itself, as the controller expects it. control_output: the currents that the drives
demand. base_wrench: of arm and payload on the base [N, Nm].
"""

from typing import TYPE_CHECKING, Final

from emulator.on_demand import on_demand
from emulator.robot.chance import Chances
from urproto.robots import RobotModel
from urproto.robots.measured import drivetrain_of
from urproto.vectors import ZERO6, Vector6, as_six, sub
from urproto.versions import Series

if TYPE_CHECKING:
    from urproto.robots.dynamics import Dynamics

JointMotion = tuple[Vector6, Vector6, Vector6]
"""Angles [rad], speeds [rad/s] and accelerations [rad/s2] of the joints."""
# Fraction of Coulomb friction by which actual currents of joints at rest deviate from their targets, in the direction
# of the last movement. Measured: shamilmamedov/dynamic_calibration, a UR10e, 68 rests of six joints (quartiles -0.03,
# 0.37 and 0.55)
_MEAN: Final = 0.24
_SPREAD: Final = 0.41
_MAX_SHARE: Final = 0.8  # 95 of 100 are within
_MOVED_RAD_S: Final = 0.02  # a slower movement has no direction, as in the measurement of the fractions


class _Supported:
    """What its base feels of an arm whose targets are ``motion``."""

    def __init__(self, dynamics: "Dynamics", motion: JointMotion) -> None:
        self._dynamics, self._motion = dynamics, motion

    @on_demand
    def base_wrench(self) -> Vector6:
        return self._dynamics.base_wrench(*self._motion)


class Efforts(_Supported):
    """Those of an arm without power, until others are set: those that a dynamic arm measures."""

    def __init__(self, dynamics: "Dynamics", motion: JointMotion, momentum: float = 0.0) -> None:
        super().__init__(dynamics, motion)
        self.momentum = momentum
        self.own_torque = self.target_torque = self.actual_torque = ZERO6
        self.target_current = self.actual_current = self.control_output = ZERO6


class IdealEfforts(_Supported):
    """The model's efforts in this motion, without friction, and external loads on the joints [Nm].

    They are computed when they are read.
    """

    def __init__(
        self, dynamics: "Dynamics", motion: JointMotion, series: Series, torque_constants: Vector6, load: Vector6
    ) -> None:
        self._dynamics, self._motion = dynamics, motion
        self._series, self._torque_constants, self._load = series, torque_constants, load

    @on_demand
    def _torque_and_momentum(self) -> tuple[Vector6, float]:
        return self._dynamics.torques_and_momentum(*self._motion)

    @property
    def momentum(self) -> float:
        return self._torque_and_momentum[1]

    @property
    def own_torque(self) -> Vector6:
        return self._torque_and_momentum[0]

    target_torque = own_torque

    @on_demand
    def actual_torque(self) -> Vector6:
        return self.own_torque if self._load is ZERO6 else sub(self.own_torque, self._load)

    @on_demand
    def target_current(self) -> Vector6:
        return currents(self.target_torque, self._torque_constants)

    @on_demand
    def actual_current(self) -> Vector6:
        return self.target_current if self._load is ZERO6 else currents(self.actual_torque, self._torque_constants)

    @property
    def control_output(self) -> Vector6:
        return demanded(self._series, self.actual_current, self.target_current)


def demanded(series: Series, motors: Vector6, target: Vector6) -> Vector6:
    """The control currents that a robot reports, of those of its motors and those of the model.

    A UR10 at rest reports its motors' currents. Three e-Series arms report their target currents: two at rest, and
    a UR5e also in motion while a hand pushed it (philipmarschner/dmp_project, demonstrations of May 17).
    """
    return motors if series is Series.CB3 else target


def currents(torque: Vector6, torque_constants: Vector6) -> Vector6:
    """Currents [A] of these torques [Nm]; torque_constants [Nm/A]."""
    k = torque_constants
    return (
        torque[0] / k[0],
        torque[1] / k[1],
        torque[2] / k[2],
        torque[3] / k[3],
        torque[4] / k[4],
        torque[5] / k[5],
    )


class StaticFriction:
    """Static friction of one arm. A joint that has not moved yet is held in a random direction."""

    def __init__(self, model: RobotModel, chances: Chances) -> None:
        self._coulomb = drivetrain_of(model).coulomb_Nm
        self._chance = chances.stream("static friction")  # not the sensors' noise
        self._directions = [0.0] * 6
        self._held: Vector6 | None = None

    def torque(self, qd: Vector6) -> Vector6:
        """Motor torques beyond the load [Nm] in a period with these joint speeds; 0 unless all joints are at rest."""
        if qd != ZERO6:
            self._held = None
            for joint, speed in enumerate(qd):
                if abs(speed) > _MOVED_RAD_S:
                    self._directions[joint] = 1.0 if speed > 0.0 else -1.0
            return ZERO6
        if self._held is None:
            self._held = as_six(map(self._share, self._directions, self._coulomb))
        return self._held

    def forget(self) -> None:
        """No joint has moved yet."""
        self._directions = [0.0] * 6
        self._held = None

    def _share(self, way: float, coulomb: float) -> float:
        share = max(-_MAX_SHARE, min(_MAX_SHARE, self._chance.gauss(_MEAN, _SPREAD)))
        return coulomb * share * (way or self._chance.choice((-1.0, 1.0)))
