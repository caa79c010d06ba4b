"""Static friction of an arm at rest: it carries part of the load, so that the motors exert less or more torque."""

from typing import Final

from emulator.robot.chance import Chances
from urproto.robots import RobotModel
from urproto.robots.measured import drivetrain_of
from urproto.vectors import ZERO6, Vector6, as_six

# Fraction of Coulomb friction by which actual currents of joints at rest deviate from their targets, in the direction
# of the last movement. Measured: shamilmamedov/dynamic_calibration, a UR10e, 68 rests of six joints (quartiles -0.03,
# 0.37 and 0.55)
_MEAN: Final = 0.24
_SPREAD: Final = 0.41
_MAX_SHARE: Final = 0.8  # 95 of 100 are within
_MOVED_RAD_S: Final = 0.02  # a slower movement has no direction, as in the measurement of the fractions


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
